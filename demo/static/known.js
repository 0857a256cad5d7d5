/* Optional inputs: pictures from the side and from behind, a depth map, the thickness, and whether the
 * object is filmed in its photograph; or the orientation of a file of Gaussians. Names, ranges and choices
 * are those of the command line. The panel's value contains the inputs by option. The server's answers replace
 * the value, which is then sent again. */
'use strict';
(() => {
  const { h, follow, places } = globalThis.Phy124;
  const PICTURES = { side: 'facing', back: null, depth: 'near' }; // options, each with the choice that belongs to it
  const ACCEPT = 'image/png,image/jpeg,image/webp,image/avif,.avif';
  const HEIC = ',image/heic,image/heif,.heic,.heif';
  const words = (name) => name.replace(/^./, (c) => c.toUpperCase());

  async function known(element, props, watch, trigger) {
    const offer = await (await fetch('phy124/catalogue.json')).json();
    const panel = new Known(element, offer, trigger, (value) => { props.value = value; trigger('change'); });
    watch('value', () => panel.take(props.value));
    listen(panel);
  }

  /** Handle the server's events without a value: a failed request, and files that no longer exist. */
  function listen(panel) {
    document.addEventListener('phy124-failed', () => panel.each((view) => view.fail()));
    document.addEventListener('phy124-forgotten', () => panel.each((view) => view.restore()));
  }

  class Known {
    constructor(element, offer, trigger, send) {
      Object.assign(this, { element, options: offer.known, limits: offer.limits, trigger, send, told: {}, views: {} });
      for (const option of Object.keys(PICTURES)) this.views[option] = new View(option, this);
      this.thickness();
      this.highlights = h('input', { type: 'checkbox', onchange: (event) => this.tell({ highlights: event.target.checked ? 'remove' : null }) });
      const { generator } = this.options; // offered if the server has weights
      this.generator = generator && h('select', { 'aria-label': 'Generator', title: generator.description, onchange: (event) => this.tell({ generator: event.target.value === generator.default ? null : event.target.value }) },
        ...generator.enum.map((value) => h('option', { value, selected: value === generator.default }, value)));
      places.pictures.replaceChildren(h('div', { class: 'views' }, ...Object.values(this.views).map((view) => view.element)),
        ...Object.values(this.views).map((view) => view.status),
        h('div', { class: 'knob', title: this.options.thickness.description }, h('div', { class: 'knob-head' }, h('span', { class: 'knob-name' }, 'Thickness'), this.deep), this.slider),
        h('label', { class: 'check', title: this.options.highlights.description }, this.highlights, 'Remove highlights'),
        ...(this.generator ? [h('div', { class: 'view' }, h('span', { class: 'knob-name' }, 'Generator'), this.generator)] : []));
      this.compose = h('input', { type: 'checkbox', onchange: (event) => this.tell({ compose: event.target.checked || null }) });
      places.film.replaceChildren(h('label', { class: 'check', title: this.options.compose.description }, this.compose, 'Also film it in the photograph'));
    }

    thickness() {
      const { minimum, maximum } = this.options.thickness.anyOf.find((s) => s.type === 'number');
      this.deep = h('output', {});
      this.slider = h('input', { type: 'range', min: minimum, max: maximum, step: minimum, value: 1, 'aria-label': 'Thickness, relative to the estimate',
        oninput: (event) => this.tell({ thickness: Number(event.target.value) === 1 ? null : Number(event.target.value) }) });
      this.say();
    }

    say() {
      // A picture from the side determines the depth.
      this.slider.disabled = Boolean(this.told.side);
      this.deep.textContent = this.told.side ? 'from the side picture' : this.told.thickness ? `${this.told.thickness} × the estimate` : 'estimated';
    }

    tell(changes) {
      Object.assign(this.told, changes);
      if (this.told.side) { this.told.thickness = null; this.slider.value = 1; }
      this.say();
      this.send({ ...this.told });
    }

    each(act) { Object.values(this.views).forEach(act); }

    /** Handle the server's value: an answer about one picture, a file's orientations, or nothing for a new
     * object. The value replaces the inputs that were sent, so they are sent again. */
    take(value) {
      if (value?.ways) return this.turn(value.ways);
      if (value?.answer) this.views[value.answer.option]?.take(value.answer);
      else this.clear();
      this.send({ ...this.told });
    }

    turn(ways) {
      const chosen = new globalThis.Phy124.Ways(ways, (axes) => { this.told = axes; this.send(axes); });
      this.element.replaceChildren(chosen.element);
      for (const place of [places.pictures, places.film]) place.hidden = true;
      chosen.choose();
    }

    clear() {
      this.told = {};
      this.element.replaceChildren();
      for (const place of [places.pictures, places.film]) place.hidden = false;
      [this.slider.value, this.highlights.checked, this.compose.checked] = [1, false, false];
      if (this.generator) this.generator.value = 'relief';
      for (const view of Object.values(this.views)) view.clear();
      this.say();
    }
  }

  /** A picture in addition to the front picture, and its choice, such as the side that it shows. */
  class View {
    constructor(option, panel) {
      Object.assign(this, { option, panel, asked: 0, following: null });
      const hint = panel.options[option].description;
      this.input = h('input', { type: 'file', accept: option === 'depth' ? ACCEPT : ACCEPT + HEIC, 'aria-label': words(option), onchange: () => this.choose(this.input.files[0]) });
      this.shown = h('img', { alt: `Your picture: ${option}`, hidden: true });
      this.remove = h('button', { type: 'button', class: 'quiet', hidden: true, 'aria-label': `Remove: ${option}`, onclick: () => { this.clear(); this.tell(null); } }, 'Remove');
      this.status = h('div', { class: 'picture-status', role: 'status' }); // too long for its narrow column
      this.element = h('div', { class: 'view', title: hint }, h('span', { class: 'knob-name' }, words(option)),
        h('label', {}, this.input, this.shown, h('span', { class: 'view-hint' }, 'Choose')), this.choice(PICTURES[option]), this.remove);
    }

    choice(name) {
      if (!name) return null;
      const schema = this.panel.options[name];
      this.chosen = h('select', { 'aria-label': words(name), title: schema.description, onchange: (event) => this.panel.tell({ [name]: event.target.value }) },
        ...schema.enum.map((value) => h('option', { value, selected: value === schema.default }, `${name}: ${value}`)));
      return this.chosen;
    }

    tell(path) { this.panel.tell({ [this.option]: path }); }

    clear() {
      this.asked++; // ignore answers that have not arrived yet
      Object.assign(this, { following: null, pending: false, file: null });
      this.show(null);
      this.say('');
      if (!this.chosen) return;
      this.chosen.value = this.panel.options[PICTURES[this.option]].default;
      this.panel.told[PICTURES[this.option]] = null;
    }

    say(text, bad = false, details = '') {
      this.status.replaceChildren(text && `${words(this.option)}: ${text}`, details ? h('details', {}, h('summary', {}, 'Details'), details) : '');
      this.status.classList.toggle('bad', bad);
    }

    show(url) {
      this.shown.hidden = this.remove.hidden = !url;
      if (url) this.shown.src = url; else this.shown.removeAttribute('src');
    }

    /** Remove the earlier picture, so that it is not used even if the new file is refused. */
    async choose(file) {
      if (!file) return;
      this.clear();
      this.tell(null);
      this.file = file;
      this.say('Sending …');
      this.input.value = '';
      const { reduced, sent } = globalThis.Phy124;
      // A depth map's 16 bits would not survive the browser.
      const answer = await sent(this.option === 'depth' ? file : await reduced(file, this.panel.limits), this.panel.limits);
      if (this.file !== file) return; // meanwhile, another file was chosen, or the file was removed
      if (answer.path) this.look(answer.path); else this.say(answer.message, true);
    }

    /** Ask the server to cut out a picture that was sent. */
    look(path) {
      this.say('Checking the picture …');
      this.ask('choose', { upload: path });
    }

    ask(event, what) {
      this.pending = true;
      this.panel.trigger(event, { option: this.option, ask: ++this.asked, ...what });
    }

    /** Handle a request that failed, for which no answer arrives. */
    fail() {
      if (!this.pending) return;
      this.pending = false;
      this.say('The server could not process the picture. Try again.', true);
    }

    /** Send the picture again if this page still has it, because the server no longer has the picture. */
    restore() {
      const { file } = this, had = !this.shown.hidden || this.following;
      if (file) return this.choose(file);
      if (!had) return;
      this.clear();
      this.tell(null);
      this.say('The server no longer has this picture. Choose it again.', true);
    }

    take({ ask, job, message, picture, cutout, warning, doubts }) {
      if (ask !== this.asked) return;
      this.pending = false;
      if (message) return this.say(message, true);
      if (job) return this.await(job);
      this.show((cutout || picture).url);
      this.say(warning || (cutout ? 'The object is cut out.' : ''), Boolean(warning), doubts);
      this.tell(picture.path);
    }

    await(job) {
      this.following = job;
      this.say('Cutting out the object …');
      follow(job, () => this.following === job, (told) => {
        if (this.following !== job) return;
        if (told.state === 'gone') { this.following = null; this.say('The server no longer has this picture. Choose it again.', true); return; }
        this.ask('view', { job });
      });
    }
  }

  Object.assign(globalThis.Phy124, { known, listen, View });
})();
