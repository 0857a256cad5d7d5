/* Optional inputs: pictures from the side and from behind, a depth map, the thickness, the shape, and whether the
 * object is filmed in its photograph; or the orientation of a file of Gaussians. Names, ranges and choices
 * are those of the command line. The panel's value contains the inputs by option. The server's answers replace
 * the value, which is then sent again. */
'use strict';
(() => {
  const { h, follow, places } = globalThis.Phy124;
  const PICTURES = { side: 'facing', back: null, depth: 'near' }; // options, each with the choice that belongs to it
  const ACCEPT = 'image/png,image/jpeg,image/webp,image/avif,.avif';
  const HEIC = ',image/heic,image/heif,.heic,.heif';
  const STORED = 'phy124-known';
  const words = (name) => name.replace(/^./, (c) => c.toUpperCase());

  async function known(element, props, watch, trigger) {
    let panel = null, shown = {};
    document.addEventListener('phy124-cut', ({ detail }) => { shown = detail; panel?.recall(detail); });
    const offer = await (await fetch('phy124/catalogue.json')).json();
    panel = new Known(element, offer, trigger, (value) => { props.value = value; trigger('change'); });
    panel.recall(shown);
    watch('value', () => panel.take(props.value));
    if (props.value?.ways) panel.take(props.value); // the server's answer to a reload came first
    listen(panel);
  }

  /** Return the inputs that were stored before a reload, and the photograph to which they belong. */
  function stored() { try { return JSON.parse(sessionStorage.getItem(STORED)); } catch { return null; } }

  /** Handle a failed request, for which the server sends no value. */
  function listen(panel) {
    document.addEventListener('phy124-failed', () => panel.each((view) => view.fail()));
  }

  class Known {
    constructor(element, offer, trigger, send) {
      Object.assign(this, { element, options: offer.known, limits: offer.limits, trigger, send, told: {}, views: {}, kept: stored() });
      for (const option of Object.keys(PICTURES)) this.views[option] = new View(option, this);
      this.highlights = h('input', { type: 'checkbox', onchange: (event) => this.tell({ highlights: event.target.checked ? 'remove' : null }) });
      this.shape = this.choice('shape');
      this.elevation = h('input', { type: 'number', ...this.limited('photo_elevation'), step: 'any', placeholder: 'estimated', 'aria-label': 'Elevation of the camera in degrees', title: this.options.photo_elevation.description,
        onchange: ({ target }) => { if (target.reportValidity()) this.tell({ photo_elevation: target.value === '' ? null : Number(target.value) }); } });
      this.thickness();
      this.generator = this.options.generator && this.choice('generator'); // offered if the server has weights
      places.pictures.replaceChildren(h('div', { class: 'views' }, ...Object.values(this.views).map((view) => view.element)),
        ...Object.values(this.views).map((view) => view.status),
        h('div', { class: 'knob', title: this.options.thickness.description }, h('div', { class: 'knob-head' }, h('span', { class: 'knob-name' }, 'Thickness'), this.deep), this.slider),
        this.row('Shape', this.shape),
        h('div', { class: 'knob' }, h('span', { class: 'knob-name' }, 'Elevation of the camera [degrees]'), this.elevation),
        h('label', { class: 'check', title: this.options.highlights.description }, this.highlights, 'Remove highlights'),
        ...(this.generator ? [this.row('Generator', this.generator)] : []));
      this.compose = h('input', { type: 'checkbox', onchange: (event) => this.tell({ compose: event.target.checked || null }) });
      places.film.replaceChildren(h('label', { class: 'check', title: this.options.compose.description }, this.compose, 'Also film it in the photograph'));
    }

    /** A menu of an option's values; the default value is not sent. */
    choice(option) {
      const { description, enum: values, default: usual } = this.options[option];
      return h('select', { 'aria-label': words(option), title: description, onchange: ({ target }) => this.tell({ [option]: target.value === usual ? null : target.value }) },
        ...values.map((value) => h('option', { value, selected: value === usual }, value)));
    }

    limited(option) {
      const { minimum, maximum } = this.options[option].anyOf.find((s) => s.type === 'number');
      return { min: minimum, max: maximum };
    }

    row(name, input) {
      return h('div', { class: 'view' }, h('span', { class: 'knob-name' }, name), input);
    }

    thickness() {
      const limits = this.limited('thickness');
      this.deep = h('output', {});
      this.slider = h('input', { type: 'range', ...limits, step: limits.min, value: 1, 'aria-label': 'Thickness, relative to the estimate',
        oninput: (event) => this.tell({ thickness: Number(event.target.value) === 1 ? null : Number(event.target.value) }) });
      this.say();
    }

    say() {
      // A picture from the side determines the depth.
      for (const input of [this.slider, this.shape, this.elevation]) input.disabled = Boolean(this.told.side);
      this.deep.textContent = this.told.side ? 'from the side picture' : this.told.thickness ? `${this.told.thickness} × the estimate` : 'estimated';
    }

    tell(changes) {
      Object.assign(this.told, changes);
      if (this.told.side) this.forget();
      this.say();
      this.send({ ...this.told });
      try { sessionStorage.setItem(STORED, JSON.stringify({ of: this.photo, told: this.told })); } catch { /* storage is not available */ }
    }

    /** Set the inputs again if the photograph is the same after a reload, or was sent again to a server that no longer had it. */
    recall({ url, photo, restored }) {
      if (!url) return;
      const { kept } = this;
      Object.assign(this, { photo, kept: null });
      if (!kept || !(restored || kept.of === photo)) return;
      const { told, files } = kept;
      [this.slider.value, this.shape.value, this.elevation.value] = [told.thickness ?? 1, told.shape ?? 'auto', told.photo_elevation ?? ''];
      [this.highlights.checked, this.compose.checked] = [Boolean(told.highlights), Boolean(told.compose)];
      if (this.generator) this.generator.value = told.generator ?? 'relief';
      this.tell(told);
      this.each((view) => view.recall(told, files?.[view.option]));
    }

    /** Set the options of the guessed shape to their defaults. */
    forget() {
      Object.assign(this.told, { thickness: null, shape: null, photo_elevation: null });
      [this.slider.value, this.shape.value, this.elevation.value] = [1, 'auto', ''];
    }

    each(act) { Object.values(this.views).forEach(act); }

    /** Handle the server's value: an answer about one picture, a file's orientations, or nothing if the
     * object is new. The value replaces the inputs that were sent, so they are sent again. */
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
      this.kept ||= { told: this.told, files: Object.fromEntries(Object.values(this.views).map(({ option, file }) => [option, file])) };
      sessionStorage.removeItem(STORED);
      this.forget();
      this.told = {};
      this.element.replaceChildren();
      for (const place of [places.pictures, places.film]) place.hidden = false;
      [this.highlights.checked, this.compose.checked] = [false, false];
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

    /** Send a file; the earlier picture remains until the server has accepted the new one. */
    async choose(file) {
      if (!file) return;
      this.asked++;
      Object.assign(this, { following: null, pending: false, file });
      this.say('Sending …');
      this.input.value = '';
      const { reduced, sent } = globalThis.Phy124;
      // A depth map is not reduced, because a browser would keep only 8 of its 16 bits.
      const answer = await sent(this.option === 'depth' ? file : await reduced(file, this.panel.limits), this.panel.limits);
      if (this.file !== file) return; // meanwhile, another file was chosen, or the file was removed
      if (answer.path) this.look(answer.path); else this.refuse(answer.message);
    }

    refuse(message) {
      const { hidden } = this.shown;
      if (hidden) this.tell(null);
      this.say(hidden ? message : `${message} The earlier picture is still used.`, true);
    }

    /** Use the picture and the choice of earlier inputs again; the picture is sent if this page still has it. */
    recall(told, file) {
      if (this.chosen) this.chosen.value = told[PICTURES[this.option]] ?? this.chosen.value;
      if (!told[this.option]) return;
      if (file) this.choose(file); else this.look(told[this.option]);
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

    take({ ask, job, message, picture, cutout, warning, doubts }) {
      if (ask !== this.asked) return;
      this.pending = false;
      if (message) return this.refuse(message);
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
