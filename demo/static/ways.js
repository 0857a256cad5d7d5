/* The orientations of a file of Gaussians, as pictures to choose from: six up axes, and four fronts for the
 * chosen up axis. */
'use strict';
(() => {
  const { h } = globalThis.Phy124;
  const STORED = 'phy124-way';

  /** Return the orientation chosen for a file before a reload, if the file still has the same pictures. */
  function kept(pictures) {
    try {
      const { of, chosen } = JSON.parse(sessionStorage.getItem(STORED));
      return of === nameOf(pictures) && `${chosen.up}_${chosen.front}` in pictures ? chosen : {};
    } catch { return {}; }
  }

  /** Return the folder of a file's pictures; each file has a separate folder. */
  function nameOf(pictures) { return Object.values(pictures)[0].path; }

  class Ways {
    /** `tell` receives the chosen axes; an earlier choice for the same file is kept. */
    constructor(given, tell) {
      const told = { ...given, ...kept(given.pictures) };
      Object.assign(this, { told, tell, up: told.up, front: told.front });
      this.fronts = h('div', { class: 'ways fronts', role: 'radiogroup', 'aria-label': 'Front' });
      const ups = told.ups.map(({ up, front }) => this.tile('up', up, up === told.up ? told.front : front, up === told.up, `${up} up`));
      this.element = h('details', { class: 'fold', open: !told.said }, h('summary', {}, told.said ? 'Wrong orientation?' : 'Which way is up?'),
        h('p', { class: 'ways-said' }, this.hint()), h('div', { class: 'ways', role: 'radiogroup', 'aria-label': 'Up' }, ...ups),
        h('p', { class: 'ways-said' }, 'Then choose the picture in which it faces you.'), this.fronts);
      this.turn();
    }

    hint() {
      const { said, program } = this.told;
      const why = said ? 'The file says which way is up.' : program ? `${program.split(':')[0]} may have written this file.` : 'The file does not say which way is up.';
      return `${why} Choose the picture in which the object stands upright.`;
    }

    tile(axis, value, front, checked, caption) {
      const choose = () => { this.front = front; if (axis === 'up') { this.up = value; this.turn(); } this.choose(); };
      return h('label', { class: 'way' }, h('input', { type: 'radio', name: `way-${axis}`, value, checked, 'aria-label': `${axis === 'up' ? 'Up' : 'Front'}: ${value}`, onchange: choose }),
        h('img', { src: this.picture(axis === 'up' ? value : this.up, front), alt: '', width: 96, height: 96 }), h('span', {}, caption));
    }

    picture(up, front) { return this.told.pictures[`${up}_${front}`].url; }

    /** Draw the fronts for the chosen up axis. */
    turn() {
      const fronts = Object.keys(this.told.pictures).map((name) => name.split('_')).filter(([up]) => up === this.up).map(([, front]) => front);
      this.fronts.replaceChildren(...fronts.map((front) => this.tile('front', front, front, front === this.front, `faces ${front}`)));
    }

    choose() {
      document.dispatchEvent(new CustomEvent('phy124-way', { detail: this.picture(this.up, this.front) }));
      const chosen = { up: this.up, front: this.front };
      try { sessionStorage.setItem(STORED, JSON.stringify({ of: nameOf(this.told.pictures), chosen })); } catch { /* storage is not available */ }
      this.tell(chosen);
    }
  }

  Object.assign(globalThis.Phy124, { Ways });
})();
