/* The orientations that a file of Gaussians may have, as pictures of which one is chosen: six ways up,
 * and four fronts of the way up that is chosen. */
'use strict';
(() => {
  const { h } = globalThis.Phy124;
  const STORED = 'phy124-way';

  /** What the page was told of a file before it was loaded again, if it still has these pictures. */
  function kept(pictures) {
    try {
      const { of, chosen } = JSON.parse(sessionStorage.getItem(STORED));
      return of === nameOf(pictures) && `${chosen.up}_${chosen.front}` in pictures ? chosen : {};
    } catch { return {}; }
  }

  /** A file's pictures are in a folder of their own. */
  function nameOf(pictures) { return Object.values(pictures)[0].path; }

  class Ways {
    /** `tell` gets the axes that are chosen; those that were chosen of the same file before are kept. */
    constructor(given, tell) {
      const told = { ...given, ...kept(given.pictures) };
      Object.assign(this, { told, tell, up: told.up, front: told.front });
      this.fronts = h('div', { class: 'ways fronts', role: 'radiogroup', 'aria-label': 'Front' });
      const ups = told.ups.map(({ up, front }) => this.tile('up', up, up === told.up ? told.front : front, up === told.up, `${up} up`));
      this.element = h('details', { class: 'more', open: !told.said }, h('summary', {}, told.said ? 'Lies down or looks away?' : 'Which way is up?'),
        h('p', { class: 'ways-said' }, this.hint()), h('div', { class: 'ways', role: 'radiogroup', 'aria-label': 'Up' }, ...ups),
        h('p', { class: 'ways-said' }, 'Then the one in which it faces you.'), this.fronts);
      this.turn();
    }

    hint() {
      const { said, program } = this.told;
      const why = said ? 'The file says which way is up.' : program ? `This may be a file of ${program.split(':')[0]}.` : 'The file does not say which way is up.';
      return `${why} Choose the picture in which the object stands upright.`;
    }

    tile(axis, value, front, checked, caption) {
      const choose = () => { this.front = front; if (axis === 'up') { this.up = value; this.turn(); } this.choose(); };
      return h('label', { class: 'way' }, h('input', { type: 'radio', name: `way-${axis}`, value, checked, 'aria-label': `${axis === 'up' ? 'Up' : 'Front'}: ${value}`, onchange: choose }),
        h('img', { src: this.picture(axis === 'up' ? value : this.up, front), alt: '', width: 96, height: 96 }), h('span', {}, caption));
    }

    picture(up, front) { return this.told.pictures[`${up}_${front}`].url; }

    /** Draw the fronts of the way up that is chosen. */
    turn() {
      const fronts = Object.keys(this.told.pictures).map((name) => name.split('_')).filter(([up]) => up === this.up).map(([, front]) => front);
      this.fronts.replaceChildren(...fronts.map((front) => this.tile('front', front, front, front === this.front, `faces ${front}`)));
    }

    choose() {
      document.dispatchEvent(new CustomEvent('phy124-way', { detail: this.picture(this.up, this.front) }));
      const chosen = { up: this.up, front: this.front };
      try { sessionStorage.setItem(STORED, JSON.stringify({ of: nameOf(this.told.pictures), chosen })); } catch { /* not kept, then */ }
      this.tell(chosen);
    }
  }

  Object.assign(globalThis.Phy124, { Ways });
})();
