/* The scene editor: preset cards, *Adjust* with the few most important controls, and a dialog with every setting
 * (form.js). The editor's value is the whole scene as plain data. */
'use strict';
(() => {
  const { h, moving, announce, sounds, places, asLink, shared, Form, clone, words } = globalThis.Phy124;
  const nice = (x, digits = 3) => Number(Number(x).toPrecision(digits)).toString();
  const SOFT = [[1.5e4, 'very soft'], [1.5e5, 'soft'], [2e6, 'firm'], [1e8, 'stiff'], [Infinity, 'rigid']];
  const pressure = (pa) => `${SOFT.find(([most]) => pa < most)[1]}, ` + (pa < 1e6 ? `${nice(pa / 1e3)} kPa` : pa < 1e9 ? `${nice(pa / 1e6)} MPa` : `${nice(pa / 1e9)} GPa`);

  const BACKGROUNDS = { white: [[1, 1, 1]], grey: [[0.86, 0.87, 0.88]], gradient: [[0.78, 0.82, 0.86], [0.96, 0.96, 0.95]], dark: [[0.09, 0.106, 0.133]] };
  const STORED = 'phy124-scene';

  async function scene(element, props, watch, trigger) {
    const offer = await (await fetch('phy124/catalogue.json')).json();
    const editor = new Editor(element, offer, (value) => { props.value = value; trigger('change'); });
    watch('value', () => { if (props.value && props.value !== editor.sent) editor.load(props.value); });
    editor.begin(await shared() || stored());
  }

  function stored() {
    try { return JSON.parse(sessionStorage.getItem(STORED)); } catch { return null; }
  }

  /** Return the further objects of a scene that are made from pictures. */
  const pictured = (data) => ((data && data.objects) || []).filter((object) => !object.shape && !object.file);

  class Editor {
    constructor(element, offer, send) {
      Object.assign(this, { element, offer, send, past: [], future: [] });
      this.cards = h('div', { class: 'cards', role: 'radiogroup', 'aria-label': 'What happens' });
      this.chips = h('div', { class: 'chips', role: 'radiogroup', 'aria-label': 'Made of' });
      this.knobs = h('div', { class: 'knobs' });
      this.special = h('div', { class: 'knobs' });
      this.brief = h('span', {});
      this.form = new Form(offer.schema, (sections) => { if (sections) this.redraw(); else { this.drawKnobs(); this.tell(); } }, this.special, this.tools());
      this.all = h('button', { type: 'button', class: 'link', 'aria-expanded': 'false', onclick: () => this.unfold() }, `All ${offer.presets.length}`);
      element.replaceChildren(h('h2', {}, 'What happens', this.all), this.cards, h('details', { class: 'fold', id: 'adjust' }, h('summary', {}, 'Adjust', this.brief),
        h('h3', {}, 'Made of'), this.chips, this.knobs, h('details', { class: 'fold' }, h('summary', {}, 'More pictures', h('span', {}, 'side, back, depth')), places.pictures),
        h('div', { class: 'every' }, h('span', {}, 'Every setting'), h('button', { type: 'button', onclick: () => this.form.open() }, 'More'))), this.form.element);
      element.addEventListener('keydown', (event) => this.shortcut(event));
      document.addEventListener('phy124-material', (event) => { this.data.material = clone(event.detail); this.drawKnobs(); this.turned(); });
      document.addEventListener('phy124-object', (event) => this.picture(event.detail));
    }

    tools() {
      const button = (label, act) => h('button', { type: 'button', class: 'quiet', onclick: act }, label);
      this.undoing = button('Undo', () => this.step(this.past, this.future));
      this.redoing = button('Redo', () => this.step(this.future, this.past));
      return h('div', { class: 'scene-tools' }, this.undoing, this.redoing, button('Copy a link to this scene', () => this.share()),
        h('a', { href: '?view=api' }, 'Use it from a program'), h('label', { class: 'check' }, h('input', { type: 'checkbox', checked: sounds.on, onchange: (event) => { sounds.on = event.target.checked; } }), 'Chime when a run is finished'), places.film);
    }

    begin(given) {
      this.drawCards();
      this.drawChips();
      document.addEventListener('phy124-ready', (event) => this.choose(event.detail.preset, event.detail.material));
      this.choose(this.offer.presets[0].name);
      try { if (given && given.material && given.time) this.load(given); } catch { this.choose(this.offer.presets[0].name); }
    }

    /** Choose a card: the first run has draft accuracy, and the report offers a finer run. */
    choose(name, material = null) {
      const data = clone(this.offer.presets.find((p) => p.name === name).scene);
      data.accuracy = 'draft';
      if (material) data.material = clone(this.offer.substances.find((s) => s.name === material).material);
      // On a dark page, white videos would be too bright.
      if (document.body.classList.contains('dark')) [data.view.background] = clone(BACKGROUNDS.dark);
      // Objects keep the pictures that were sent, in the same order.
      const sent = pictured(this.data).map((one) => one.picture);
      pictured(data).forEach((one, i) => { if (sent[i]) one.picture = sent[i]; });
      this.load(data);
    }

    load(data) { this.show(data); this.tell(); }

    /** Show these data in all controls; the control that has the focus keeps the focus. */
    show(data) {
      this.data = clone(data);
      const controls = () => [...this.element.querySelectorAll('input, select, textarea, button, .pad')];
      const place = controls().indexOf(document.activeElement);
      if (place >= 0) document.activeElement.blur();
      this.markCards(); this.markChips(); this.drawKnobs(); this.drawForm();
      controls()[place]?.focus({ preventScroll: true });
    }

    tell() {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.settle(), 120);
    }

    /** Store all changes since the last message as one step of the history. */
    settle() {
      clearTimeout(this.timer);
      if (this.sent && JSON.stringify(this.sent) !== JSON.stringify(this.data)) { this.past.push(this.sent); this.future.splice(0); }
      this.say();
    }

    say() {
      this.sent = clone(this.data);
      globalThis.Phy124.objects = pictured(this.sent).map(({ name, picture }) => ({ name, picture }));
      document.dispatchEvent(new Event('phy124-asked'));
      document.dispatchEvent(new CustomEvent('phy124-objects', { detail: globalThis.Phy124.objects }));
      try { sessionStorage.setItem(STORED, JSON.stringify(this.sent)); } catch { /* storage is not available */ }
      [this.undoing.disabled, this.redoing.disabled] = [!this.past.length, !this.future.length];
      this.send(this.sent);
    }

    /** Return to an earlier scene (undo), or to a later scene (redo). */
    step(from, to) {
      this.settle();
      if (!from.length) return;
      to.push(this.sent);
      this.show(from.pop());
      this.say();
      announce('The earlier scene is restored.');
    }

    shortcut(event) {
      if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== 'z' || event.target.matches('input[type=text], input[type=number], textarea')) return;
      event.preventDefault();
      if (event.shiftKey) this.step(this.future, this.past); else this.step(this.past, this.future);
    }

    async share() {
      const data = clone(this.data);
      for (const one of data.objects || []) delete one.picture;
      if (data.parts) data.parts = data.parts.filter((part) => !part.mask);
      if (data.stiffness && data.stiffness.file) delete data.stiffness;
      const link = await asLink(data);
      try { await navigator.clipboard.writeText(link); announce('The link is copied.'); } catch { location.hash = link.split('#')[1]; announce('The link is in the address bar.'); }
    }

    /** Handle the choice or the removal of a picture of a further object. */
    picture({ name, picture }) {
      const one = pictured(this.data).find((each) => each.name === name);
      if (!one) return;
      if (picture) one.picture = picture; else delete one.picture;
      this.turned();
    }

    /** Update the form after a control has changed the data. */
    turned() { this.markChips(); this.drawForm(); this.summarise(); this.tell(); }

    /** Mark the card of the preset from which the scene was made. */
    markCards() {
      [...this.cards.querySelectorAll('input')].forEach((input, i) => { input.checked = this.offer.presets[i].scene.description === this.data.description; });
    }

    /** Mark the chip of the scene's material. The elements of the chips are not replaced, so that the focus is kept. */
    markChips() {
      const same = (material) => Object.entries(material).every(([name, value]) => JSON.stringify(this.data.material[name]) === JSON.stringify(value));
      const preset = this.preset, inputs = [...this.chips.querySelectorAll('input')];
      const materials = [preset ? preset.scene.material : { law: null }, ...this.offer.substances.map(({ material }) => material)];
      const chosen = materials.findIndex(same);
      inputs.forEach((input, i) => { input.checked = i === chosen; });
      const picture = preset?.picture, first = this.chips.querySelector('i');
      if (first && picture && first.dataset.of !== picture) { first.dataset.of = picture; first.replaceChildren(moving(`phy124/${picture}`, {}, true)); }
    }

    /** Return the preset from which the scene was made. */
    get preset() { return this.offer.presets.find(({ scene }) => scene.description === this.data?.description); }

    drawChips() {
      const chip = (name, title, picture, act) => h('label', { class: 'chip' }, h('input', { type: 'radio', name: 'substance', value: name, onchange: act }),
        h('i', {}, picture ? moving(`phy124/${picture}`, {}, true) : null), h('b', {}, title));
      const use = (material) => { this.data.material = clone(material); this.drawKnobs(); this.turned(); };
      this.chips.replaceChildren(chip('as_is', 'As is', null, () => use((this.preset || this.offer.presets[0]).scene.material)),
        ...this.offer.substances.map(({ name, title, material, picture }) => chip(name, title, picture, () => use(material))));
    }

    /** Load the pictures of cards only when the cards are shown. */
    drawCards() {
      this.cards.replaceChildren(...this.offer.presets.map((preset) => h('label', { class: 'card', title: preset.text },
        h('input', { type: 'radio', name: 'preset', value: preset.name, onchange: () => this.choose(preset.name) }),
        h('i', {}), h('b', {}, preset.title))));
      this.drawPictures();
    }

    drawPictures() {
      [...this.cards.children].forEach((card, i) => {
        const at = card.querySelector('i'), { picture } = this.offer.presets[i];
        if (picture && !at.firstChild && (card.offsetParent || i < 6)) at.append(moving(`phy124/${picture}`, {}, true));
      });
    }

    unfold() {
      this.all.setAttribute('aria-expanded', this.cards.classList.toggle('all'));
      this.drawPictures();
    }

    /* ---- knobs ----------------------------------------------------------------------------- */

    drawKnobs() {
      const softness = this.log('Softness', ['material', 'E'], 1e3, 1e10, null, pressure);
      const rows = [softness, this.log('Weight', ['material', 'density'], 20, 10000, this.offer.weights, (value) => `${nice(value)} kg/m³`), this.count(), this.push()];
      this.knobs.replaceChildren(...rows.filter(Boolean));
      this.special.replaceChildren(this.accuracy(), this.held(), this.background());
      this.summarise();
    }

    /** Describe the settings in a few words. */
    summarise() {
      const softness = this.knobs.querySelector('[aria-label=Softness]');
      const length = `${nice(this.data.time.frames / this.data.time.fps, 2)} s`, chip = [...this.chips.querySelectorAll('input')].findIndex((input) => input.checked);
      this.brief.textContent = [chip > 0 ? this.offer.substances[chip - 1].title : softness?.getAttribute('aria-valuetext').split(',')[0], length].filter(Boolean).join(', ');
    }

    knob(label, output, ...children) {
      return h('div', { class: 'knob' }, h('div', { class: 'knob-head' }, h('span', { class: 'knob-name' }, label), output), ...children);
    }

    log(label, [section, field], least, most, anchors, spell) {
      if (!(field in this.data[section])) return null;
      const steps = 200, ratio = Math.log(most / least);
      const at = (value) => Math.round(steps * Math.log(value / least) / ratio);
      const output = h('output', {}), slider = h('input', { type: 'range', min: 0, max: steps, value: at(this.data[section][field]), 'aria-label': label,
        oninput: (event) => { this.data[section][field] = Number(nice(least * Math.exp(ratio * event.target.value / steps))); say(); this.turned(); } });
      const say = () => {
        const value = this.data[section][field];
        const near = anchors && Object.keys(anchors).reduce((a, b) => (Math.abs(Math.log(value / anchors[b])) < Math.abs(Math.log(value / anchors[a])) ? b : a));
        output.textContent = `${near && Math.abs(Math.log(value / anchors[near])) < 0.8 ? `like ${near}, ` : ''}${spell(value)}`;
        slider.setAttribute('aria-valuetext', output.textContent);
      };
      say();
      return this.knob(label, output, slider);
    }

    /** Return the acceleration that the pad sets; a zero vector if the scene has none. */
    get pushed() { return this.data.forces.find((force) => force.kind === 'acceleration'); }

    push() {
      const output = h('output', {}), a = this.pushed ? this.pushed.a : [0, 0, 0];
      const start = Math.hypot(...a);
      const state = { right: a[1] / (start || 1), away: -a[0] / (start || 1), up: a[2] / (start || 1), strength: start };
      const pad = svg(`<svg viewBox="0 0 100 100" class="pad" tabindex="0" role="slider" aria-label="Direction of the push, seen from above"
        aria-valuemin="0" aria-valuemax="360"><circle class="pad-floor" cx="50" cy="50" r="46"/><circle class="pad-ring" cx="50" cy="50" r="23"/>
        <path class="pad-cross" d="M50 4V96M4 50H96"/><line class="pad-line" x1="50" y1="50" x2="50" y2="50"/><circle class="pad-dot" cx="50" cy="50" r="6"/></svg>`);
      const strength = h('input', { type: 'range', min: 0, max: 30, step: 0.1, value: state.strength, 'aria-label': 'Strength of the push' });
      const up = h('input', { type: 'range', min: -1, max: 1, step: 0.05, value: state.up, 'aria-label': 'Push up or down' });
      const say = () => {
        const [x, y] = [50 + 42 * state.right, 50 - 42 * state.away];
        pad.querySelector('.pad-dot').setAttribute('cx', x); pad.querySelector('.pad-dot').setAttribute('cy', y);
        pad.querySelector('.pad-line').setAttribute('x2', x); pad.querySelector('.pad-line').setAttribute('y2', y);
        const reach = Math.hypot(state.right, state.away, state.up) || 1, [r, w, u] = [state.right, state.away, state.up].map((v) => v / reach);
        const side = [r > 0.3 && 'right', r < -0.3 && 'left', w > 0.3 && 'away', w < -0.3 && 'forward', u > 0.3 && 'up', u < -0.3 && 'down'].filter(Boolean).join(', ');
        output.textContent = state.strength ? `${side || 'nowhere'}, ${nice(state.strength, 2)} m/s²` : 'none';
        pad.setAttribute('aria-valuetext', output.textContent);
        pad.setAttribute('aria-valuenow', Math.round((Math.atan2(state.right, state.away) * 180 / Math.PI + 360) % 360));
      };
      const set = () => { this.setPush(state); say(); this.turned(); };
      const aim = (event) => {
        const box = pad.getBoundingClientRect();
        const x = ((event.clientX - box.left) / box.width - 0.5) / 0.42, y = ((event.clientY - box.top) / box.height - 0.5) / 0.42;
        const reach = Math.max(1, Math.hypot(x, y));
        Object.assign(state, { right: x / reach, away: -y / reach });
        if (!state.strength) { state.strength = 3; strength.value = 3; }
        set();
      };
      pad.addEventListener('pointerdown', (event) => { pad.setPointerCapture(event.pointerId); aim(event); });
      pad.addEventListener('pointermove', (event) => { if (event.buttons) aim(event); });
      pad.addEventListener('keydown', (event) => {
        const move = { ArrowLeft: [-0.2, 0], ArrowRight: [0.2, 0], ArrowUp: [0, 0.2], ArrowDown: [0, -0.2] }[event.key];
        if (!move) return;
        event.preventDefault();
        const x = state.right + move[0], y = state.away + move[1], reach = Math.max(1, Math.hypot(x, y));
        Object.assign(state, { right: x / reach, away: y / reach });
        if (!state.strength) { state.strength = 3; strength.value = 3; }
        set();
      });
      strength.addEventListener('input', () => { state.strength = Number(strength.value); if (!state.right && !state.away && !state.up) state.right = 1; set(); });
      up.addEventListener('input', () => { state.up = Number(up.value); set(); });
      say();
      return this.knob('Push', output, h('div', { class: 'push' }, pad, h('div', { class: 'push-sliders' },
        h('label', {}, 'How hard', strength), h('label', {}, 'Down or up', up))));
    }

    setPush({ right, away, up, strength }) {
      const length = Math.hypot(right, away, up) || 1;
      const a = [-away, right, up].map((v) => Number(nice(strength * v / length)) + 0);
      if (!strength) this.data.forces = this.data.forces.filter((force) => force !== this.pushed);
      else if (this.pushed) this.pushed.a = a;
      else this.data.forces.push({ kind: 'acceleration', a, start: 0 });
    }

    held() {
      const foot = () => this.data.boundaries.find((b) => b.kind === 'foot'), output = h('output', {});
      const say = () => { output.textContent = foot() ? `lowest ${Math.round(100 * foot().fraction)} %` : 'nothing'; };
      const slider = h('input', { type: 'range', min: 0, max: 60, step: 1, value: foot() ? Math.round(100 * foot().fraction) : 0, 'aria-label': 'Part held at the foot, in percent of the height',
        oninput: (event) => {
          const fraction = Number(event.target.value) / 100;
          if (!fraction) this.data.boundaries = this.data.boundaries.filter((b) => b !== foot());
          else if (foot()) foot().fraction = fraction;
          else this.data.boundaries.push({ kind: 'foot', fraction });
          say(); this.turned();
        } });
      say();
      return this.knob('Held at the foot', output, slider);
    }

    count() {
      const output = h('output', {}), time = this.data.time, slider = h('input', { type: 'range', min: 2, max: this.offer.limits.frames, step: 1, value: time.frames, 'aria-label': 'Length',
        oninput: (event) => { time.frames = Number(event.target.value); say(); this.turned(); } });
      const say = () => { output.textContent = `${nice(time.frames / time.fps, 2)} s`; slider.setAttribute('aria-valuetext', `${output.textContent}, ${time.frames} frames`); };
      say();
      return this.knob('Length', output, slider);
    }

    accuracy() {
      const pick = (name) => { this.data.accuracy = name; this.turned(); };
      return this.knob('Accuracy', h('output', {}), h('div', { class: 'segments', role: 'radiogroup', 'aria-label': 'Accuracy' },
        ...this.offer.accuracies.map(({ name, cells, why }) => h('label', { title: why },
          h('input', { type: 'radio', name: 'accuracy', value: name, checked: this.data.accuracy === name, onchange: () => pick(name) }),
          h('span', {}, words(name), h('small', {}, `${cells} grid cells`))))));
    }

    background() {
      const { view } = this.data, now = JSON.stringify([view.background, ...(view.gradient ? [view.gradient] : [])]);
      return this.knob('Background', h('output', {}), h('div', { class: 'segments', role: 'radiogroup', 'aria-label': 'Background' },
        ...Object.entries(BACKGROUNDS).map(([name, [top, bottom]]) => h('label', {},
          h('input', { type: 'radio', name: 'background', value: name, checked: JSON.stringify(BACKGROUNDS[name]) === now, onchange: () => { [view.background, view.gradient] = clone([top, bottom || null]); this.turned(); } }),
          h('span', {}, words(name))))));
    }

    /** Handle the addition or the removal of sections in the form. */
    redraw() { document.activeElement.blur(); this.markChips(); this.drawKnobs(); this.drawForm(); this.tell(); }

    drawForm() { this.form.draw(this.data); }
  }

  function svg(text) {
    const box = document.createElement('div');
    box.innerHTML = text;
    return box.firstElementChild;
  }

  Object.assign(globalThis.Phy124, { scene });
})();
