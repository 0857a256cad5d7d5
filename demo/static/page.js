/* The panels of the page: progress, stage, results, report. Each panel is a function that Gradio's
 * gr.HTML calls once with its element; `watch` calls back when Python sends a new value. */
'use strict';
(() => {
  const { follow, server, Questions } = globalThis.Phy124;

  const h = (tag, attributes = {}, ...children) => {
    const node = document.createElement(tag);
    for (const [name, value] of Object.entries(attributes)) {
      if (name.startsWith('on')) node.addEventListener(name.slice(2), value);
      else if (value === true) node.setAttribute(name, '');
      else if (value !== false && value != null) node.setAttribute(name, value);
    }
    node.append(...children.filter((child) => child != null));
    return node;
  };

  const seconds = (s) => (s < 90 ? `${s.toFixed(s < 9.95 ? 1 : 0)} s` : `${(s / 60).toFixed(1)} min`);

  const calm = () => matchMedia('(prefers-reduced-motion: reduce)').matches;

  /** A picture that moves, either always or (if `rests` is set) only under the pointer and in
   * focus. If the visitor's system asks for less motion, only the first frame is shown. */
  function moving(src, attributes, rests = false) {
    const img = h('img', { alt: '', loading: calm() || rests ? 'eager' : 'lazy', ...attributes });
    if (!calm() && !rests) { img.src = src; return img; }
    const whole = new Image();
    whole.onload = () => {
      const canvas = h('canvas', { width: whole.naturalWidth, height: whole.naturalHeight });
      canvas.getContext('2d').drawImage(whole, 0, 0);
      const still = img.src = canvas.toDataURL(), around = img.closest('label, button');
      if (calm() || !around) return;
      for (const [event, on] of [['pointerenter', true], ['focusin', true], ['pointerleave', false], ['focusout', false]]) around.addEventListener(event, () => { img.src = on ? src : still; });
    };
    whole.src = src;
    return img;
  }

  /* ---- notices and sounds -------------------------------------------------------------- */

  const voice = h('div', { class: 'unseen', role: 'status', 'aria-live': 'polite' });
  document.addEventListener('DOMContentLoaded', () => document.querySelector('main')?.append(voice));
  function announce(text) {
    if (!voice.isConnected) (document.querySelector('main') || document.body).append(voice);
    voice.textContent = '';
    setTimeout(() => { voice.textContent = text; }, 50);
  }

  const sounds = { get on() { return localStorage.getItem('phy124-sound') !== 'off'; }, set on(value) { localStorage.setItem('phy124-sound', value ? 'on' : 'off'); } };

  /** Two soft notes when a long run has finished. */
  function chime() {
    if (!sounds.on || !globalThis.AudioContext) return;
    const context = new AudioContext();
    [[659, 0], [988, 0.14]].forEach(([pitch, at]) => {
      const [note, loudness] = [context.createOscillator(), context.createGain()], start = context.currentTime + at;
      note.frequency.value = pitch;
      loudness.gain.setValueAtTime(0.0001, start);
      loudness.gain.exponentialRampToValueAtTime(0.08, start + 0.02);
      loudness.gain.exponentialRampToValueAtTime(0.0001, start + 0.7);
      note.connect(loudness).connect(context.destination);
      note.start(start);
      note.stop(start + 0.75);
    });
    setTimeout(() => context.close(), 1500);
  }

  /* ---- the state of the page, for its style: first, chosen, running, result or touch ---------- */

  /** Text that is shown while there is no forecast. */
  const unforecast = () => state.opening || (state.picture ? 'the time is being estimated' : 'no picture yet');
  /** `opening`: text about the work on a picture or file that was chosen; empty when the work is done. */
  const state = { picture: false, opening: '', running: false, result: false, touching: false };
  /** Make elements that only show information, or are covered, unreachable for the pointer and the keyboard. */
  const still = (part, on) => { for (const node of document.querySelectorAll(part)) node.inert = on; };
  function mark(changes) {
    Object.assign(state, changes);
    // Scroll to the top, where a phone also shows the report that follows.
    if (changes.running || changes.touching) for (const part of document.querySelectorAll('html, #side, #scroll')) part.scrollTo(0, 0);
    for (const none of document.querySelectorAll('#forecast .none')) none.textContent = unforecast();
    if (!state.running) document.body.classList.remove('kept');
    document.body.dataset.state = state.touching ? 'touch' : state.running ? 'running' : state.result ? 'result' : state.picture ? 'chosen' : 'first';
    document.body.dataset.picture = state.picture;
    still('#side', state.touching);
    still('#viewer', state.touching);
    for (const button of document.querySelectorAll('#go, #begin-touch')) button.setAttribute('aria-disabled', !state.picture);
  }

  /** Elements of one panel that contain parts of other panels. */
  const places = { pictures: h('div', { id: 'more-pictures' }), film: h('div', {}), fit: h('div', { id: 'fit-place' }) };

  /** If there is no picture, let Generate and Touch show where to choose a picture. */
  function guard(event) {
    if (state.picture || !event.target.closest?.('#go, #begin-touch')) return;
    event.stopPropagation();
    event.preventDefault();
    if (state.opening) return announce(`Wait: ${state.opening}.`);
    announce('Choose a picture first.');
    const field = document.querySelector('#photo');
    field?.querySelector('input').focus();
    field?.animate?.([{ boxShadow: '0 0 0 3px var(--accent)' }, { boxShadow: '0 0 0 3px transparent' }], calm() ? 0 : 900);
  }
  document.addEventListener('click', guard, true);
  document.addEventListener('DOMContentLoaded', () => mark({}));

  /** Close small panels by Escape and by a click elsewhere. */
  function closing(event) {
    for (const open of document.querySelectorAll('details.pop[open]')) {
      if (event.type === 'keydown' ? event.key === 'Escape' : !open.contains(event.target)) open.open = false;
    }
  }
  for (const name of ['click', 'keydown']) document.addEventListener(name, closing);

  /* ---- the forecast, and its button that measures the error of the scene ------------------- */

  function forecast(element, props, watch, trigger) {
    const show = () => {
      const { change, html } = props.value || {};
      if ((change ?? 0) < (globalThis.Phy124.change ?? 0)) return; // this is the answer to an earlier scene
      if (html) element.innerHTML = html; // made by demo/handlers/run.py, which escapes all text
      else element.replaceChildren(h('p', { class: 'none' }, unforecast()));
    };
    watch('value', show);
    show();
    // A new forecast closes the details that the visitor or the server has opened. Setting `open` again where it
    // is set would call the observer for ever.
    let open = false;
    const reopen = () => { const details = element.querySelector('details'); if (open && details && !details.open) details.open = true; };
    new MutationObserver(reopen).observe(element, { childList: true, subtree: true, attributeFilter: ['open'] });
    element.addEventListener('toggle', ({ target }) => { open ||= target.open; }, true);
    document.addEventListener('click', ({ target }) => {
      if (!element.contains(target)) open = false;
      else if (target.closest('summary')) open = !target.closest('details').open;
    }, true);
    document.addEventListener('keydown', ({ key }) => { if (key === 'Escape') open = false; }, true);
    element.addEventListener('click', (event) => {
      // While a job runs, this button does nothing, like Generate.
      if (event.target.closest('[data-measure]') && !document.querySelector('#go').disabled) trigger('measure');
    });
  }

  /* ---- progress: one line with the remaining time ------------------------------------------------ */

  function progress(element, props, watch, trigger) {
    const panel = new ProgressPanel(element, trigger);
    watch('value', () => panel.show(props.value));
    panel.show(props.value);
    document.addEventListener('phy124-asked', () => panel.settle());
    document.addEventListener('phy124-forgotten', () => { if (document.querySelector('#viewer .viewer-host')) trigger('finished', {}); });
  }

  class ProgressPanel {
    constructor(element, trigger) { Object.assign(this, { element, trigger, job: null }); }

    show(value) {
      clearTimeout(this.retry);
      if (!value || !value.state) return this.element.replaceChildren();
      if (!value.job) { this.job = null; return this.end(value); }
      if (value.job === this.job) return;
      this.job = value.job;
      mark({ running: true });
      this.draw(value);
      globalThis.Phy124.live.begin(value.kind !== 'run' || value.finer);
      follow(value.job, (told) => this.take(value.job, told), (told) => this.end(told));
    }

    take(job, told) {
      if (this.job !== job) return false;
      if (told.state === 'lost') { this.say('lost', 'The connection was lost. Reconnecting …'); return true; }
      if (told.glimpses?.length) globalThis.Phy124.live.glimpse(told.glimpses.at(-1));
      for (const file of told.live || []) globalThis.Phy124.live.add(`gradio_api/file=${file}`);
      if (told.state === 'waiting' || told.state === 'running') this.draw(told);
      return true;
    }

    draw({ state, place, wait, elapsed, expected, warning }) {
      const left = Math.max(0, expected - elapsed), part = state === 'waiting' ? 0 : Math.min(0.98, elapsed / Math.max(expected, elapsed + 0.3));
      const text = state === 'waiting' ? place > 0 ? `${place} before you${wait > 0 ? `, about ${seconds(wait)}` : ''}` : 'Starting soon' : left > 0.5 ? `about ${seconds(left)} to go` : elapsed < 2 * expected + 5 ? 'nearly there' : `longer than expected: ${seconds(elapsed)} so far`;
      const dot = part * globalThis.Phy124.live.played();
      this.element.replaceChildren(h('section', { class: `progress ${state}`, 'aria-label': 'Progress' },
        h('div', { class: 'line', role: 'progressbar', 'aria-label': 'Progress', 'aria-valuenow': Math.round(100 * part), 'aria-valuetext': text },
          h('i', { style: `width:${100 * part}%` }), dot ? h('em', { style: `left:${100 * dot}%` }) : null),
        h('p', { class: 'clock' }, text), warning ? h('p', { class: 'ends' }, warning) : null));
    }

    end(told) {
      const job = this.job, long = told.elapsed > 3;
      mark({ running: false });
      if (told.state === 'gone') told = { state: 'failed', message: 'The server no longer has this run. Generate it again.' };
      if (told.state === 'done') {
        this.element.replaceChildren();
        announce('The result is ready.');
        if (long) chime();
      } else { this.say(told.state, told.message); globalThis.Phy124.live.drop(); }
      if (job) this.trigger('finished', { job });
    }

    /** Remove the last refusal when another request is made. */
    settle() { if (this.element.querySelector('.progress.refused')) this.element.replaceChildren(); }

    say(state, message) {
      if (state === 'refused') server.look();
      const again = state === 'full' ? h('button', { type: 'button', class: 'quiet', onclick: () => this.trigger('again') }, 'Try again now') : null;
      if (again) this.retry = setTimeout(() => this.trigger('again'), 10e3);
      this.element.replaceChildren(h('section', { class: `progress ${state}`, 'aria-label': 'Progress' },
        h('p', { class: 'message', role: 'status' }, message), again));
    }
  }

  /* ---- the stage: ready results, the cut-out, the growing clip, the result --------------------- */

  /** The functions of the viewer that other panels call. */
  const live = { begin() {}, add() {}, glimpse() {}, drop() {}, played: () => 0 };

  async function viewer(element, props, watch) {
    const panel = new ViewerPanel(element);
    Object.assign(live, { begin: (keep) => panel.begin(keep), add: (url) => panel.add(url), drop: () => panel.drop(),
      glimpse: (picture) => panel.glimpse(picture), played: () => panel.played });
    Object.assign(globalThis.Phy124, { compare: (url, title) => panel.compare(url, title) });
    document.addEventListener('phy124-cut', ({ detail }) => panel.own(detail));
    const show = () => { panel.showing = panel.show(props.value?.pack?.url, props.value?.invented); };
    watch('value', show);
    show();
    try { panel.offer(await (await fetch('phy124/catalogue.json')).json()); } catch { /* without ready results */ }
  }

  class ViewerPanel {
    constructor(element) {
      Object.assign(this, { element, player: null, url: null, showing: null, growing: null, other: null, cut: null, ready: h('section', { id: 'ready', 'aria-label': 'Ready to see' }) });
      const narrow = matchMedia('(max-width: 719px)'), place = () => (narrow.matches && document.querySelector('#side') || element).append(this.ready);
      narrow.addEventListener('change', place);
      this.place = place;
    }

    /* -- before the first run -- */

    offer({ ready }) {
      if (!ready?.length) return;
      const tile = (item) => h('button', { type: 'button', class: 'tile', 'data-ready': item.name, onclick: () => this.play(item, true) },
        h('i', {}, moving(`phy124/${item.picture}`, {}, true)), h('b', {}, item.title));
      this.ready.replaceChildren(h('h2', {}, 'Ready to see'), h('div', { class: 'tiles' }, ...ready.map(tile)));
      this.place();
      this.first = ready[0];
      this.greet();
    }

    /** Show the first finished result if the visitor has no object yet. */
    greet() { if (this.first && !this.url && !this.cut && !this.growing) this.play(this.first, false); }

    /** Show a finished result; when clicked, its picture and card are chosen as well. */
    async play(item, chosen) {
      this.clear();
      this.shown = item;
      for (const tile of this.ready.querySelectorAll('.tile')) tile.classList.toggle('on', tile.dataset.ready === item.name);
      const film = moving(`phy124/${item.film}`, { class: 'hero', alt: item.title }), host = h('div', { class: 'viewer-host' }, film);
      this.fill(h('p', { class: 'from' }, h('img', { src: `phy124/examples/${item.example}.png`, alt: '' }), h('span', {}, 'made from this picture', h('br'), `${Math.round(item.seconds)} s of computing, without videos`)), host);
      if (!chosen) return;
      document.dispatchEvent(new CustomEvent('phy124-ready', { detail: item }));
      const bytes = item.pack && await read(`phy124/${item.pack}`);
      if (bytes && this.shown === item) this.player = await Phy124Player.mount(host, bytes, { clear: true });
    }

    fill(...children) { this.element.replaceChildren(...children); this.place(); }

    /** Show the visitor's cut-out in the viewer, unless an example or an earlier result is shown. */
    own({ url, fresh }) {
      const gone = this.cut && !url && !this.shown;
      this.cut = url;
      if (gone) this.greet();
      if (this.growing || !url || (!fresh && (this.url || this.shown))) return;
      if (fresh) this.url = null;
      if (!this.url) this.standing();
    }

    standing() {
      this.clear();
      mark({ result: false });
      this.fill(h('figure', { class: 'own' }, h('img', { src: this.cut, alt: 'Your object, cut out' })));
    }

    /* -- a run -- */

    /** `keep`: whether the displayed result stays until the end of the run. */
    begin(keep) {
      this.growing = { waiting: [], drawn: false, busy: false, keep };
      document.body.classList.toggle('kept', Boolean(keep && this.url));
      if (!keep && this.cut) this.standing();
    }

    /** Add a frame that was just computed: the first frame creates a player, later frames lengthen its clip. */
    async add(url) {
      const growing = this.growing;
      if (!growing || growing.keep) return;
      growing.waiting.push(url);
      if (growing.busy) return;
      growing.busy = true;
      while (this.growing === growing && growing.waiting.length) await this.grow(growing, growing.waiting.shift());
      growing.busy = false;
    }

    async grow(growing, url) {
      const bytes = await read(url);
      if (!bytes || this.growing !== growing) return;
      if (growing.drawn) { await this.player?.extend(bytes); return; }
      growing.drawn = true;
      const stance = this.stance;
      this.clear();
      const host = h('div', { class: 'viewer-host growing' });
      this.fill(h('div', { class: 'viewer-row' }, host));
      this.player = await this.mount(host, bytes, stance, { growing: true });
    }

    /** Show a small picture of the newest frame, for browsers without WebGL. */
    glimpse(picture) {
      if (this.growing?.drawn && !this.player) this.element.querySelector('.viewer-host')?.replaceChildren(h('img', { class: 'hero', alt: 'The motion so far', src: `data:image/jpeg;base64,${picture}` }));
    }

    /** Return the fraction of the computed clip that has been played, from 0 to 1. */
    get played() { const { player } = this; return this.growing?.drawn && player?.length ? player.time / player.length : 0; }

    /** Show the previous result or the cut-out again, because the run failed. */
    drop() {
      const { growing, url } = this;
      if (!growing) return;
      Object.assign(this, { growing: null, url: growing.keep ? url : null });
      if (growing.keep) return;
      if (url) this.show(url, this.invented); else if (this.cut) this.standing();
    }

    /* -- a result -- */

    async show(url, invented) {
      if (url === this.url && !this.growing) return;
      if (!url) { this.url = null; return; }
      const { growing, player } = this, kept = growing && player ? [this.stance, player.time] : [];
      Object.assign(this, { url, invented, growing: null });
      const bytes = await read(url);
      if (this.url !== url) return;
      this.clear();
      const host = h('div', { class: 'viewer-host' });
      mark({ result: true });
      this.fill(h('div', { class: 'viewer-row' }, host),
        ...(invented ? [h('p', { class: 'invented' }, 'The front is your picture; the back is a guess from its outline.')] : []));
      if (!bytes) { host.textContent = 'The server no longer has this result. Generate it again.'; return; }
      this.player = await this.mount(host, bytes, kept[0]);
      if (growing?.keep && kept[1]) this.player?.seek(kept[1]);
      this.player?.find('bar').append(globalThis.Phy124.sharing());
      this.element.player = this.player;
    }

    get stance() { return this.player && !this.shown ? this.player.stance : null; }

    async mount(host, bytes, stance, options) {
      const player = await Phy124Player.mount(host, bytes, { clear: true, ...options });
      if (player && stance) player.stand(stance);
      return player;
    }

    clear() {
      for (const each of [this.player, this.other]) if (each) each.dispose();
      Object.assign(this, { player: null, other: null, shown: null });
      for (const tile of this.ready.querySelectorAll('.on')) tile.classList.remove('on');
    }

    /** Show another result next to this one, from the same direction at the same time. */
    async compare(url, title) {
      await this.showing; // the result may still be loading
      if (!this.player) return;
      if (this.other) { this.other.dispose(); this.other.host.parentNode.remove(); this.other = null; if (this.beside === url) { this.beside = null; return; } }
      this.beside = url;
      const bytes = await read(url), host = h('div', { class: 'viewer-host' });
      if (!bytes || this.beside !== url) return;
      this.element.querySelector('.viewer-row').append(h('figure', { class: 'beside' }, h('figcaption', {}, title), host));
      this.other = await this.mount(host, bytes, null);
      this.player.lead(this.other);
    }
  }

  async function read(url) {
    try { const answer = await fetch(url); return answer.ok ? new Uint8Array(await answer.arrayBuffer()) : null; } catch { return null; }
  }

  /* ---- earlier results --------------------------------------------------------------------- */

  function history(element, props, watch, trigger) {
    const questions = new Questions(trigger);
    let open = false;
    document.addEventListener('phy124-failed', () => questions.pending && questions.answered());
    const show = () => {
      questions.answered();
      const runs = (props.value && props.value.runs) || [];
      if (runs.length < 2) return element.replaceChildren();
      const item = ({ job, title, detail, picture, pack, current }) => h('li', { class: current ? 'current' : '' },
        h('button', { type: 'button', class: 'tile', 'aria-pressed': current ? 'true' : 'false', onclick: () => questions.ask('show', { job, earlier: true }) },
          h('i', {}, moving(picture.url, {}, true)), h('b', {}, title), h('small', {}, detail)),
        current ? null : h('button', { type: 'button', class: 'quiet', onclick: () => globalThis.Phy124.compare(pack.url, `${title}, ${detail}`) }, 'Compare'));
      element.replaceChildren(h('details', { class: 'fold', open, ontoggle: (event) => { open = event.target.open; } },
        h('summary', {}, 'Your results', h('span', {}, String(runs.length))), h('ul', {}, ...runs.map(item))));
    };
    watch('value', show);
    show();
  }

  /* ---- the report: three sentences, a finer run, and the tables ------------------------------- */

  function report(element, props, watch, trigger) {
    let open = false;
    const show = () => {
      const { sentences, finer, tables } = props.value || {};
      if (!sentences) return element.replaceChildren();
      const text = ({ text: words, warn }) => h('p', { class: warn ? 'warn' : '' }, words), experts = h('div', { class: 'tables' });
      experts.innerHTML = tables; // made by demo/report.py, which escapes all text
      element.replaceChildren(h('h2', {}, 'Report'), ...sentences.map(text),
        finer ? h('div', { class: 'finer' }, h('button', { type: 'button', onclick: () => { if (!state.running) trigger('finer'); } }, 'Make it finer'), h('small', {}, finer)) : h('div', { class: 'finer' }, h('small', {}, 'This is the finest accuracy.')),
        h('details', { class: 'fold', id: 'experts', open, ontoggle: (event) => { open = event.target.open; } }, h('summary', {}, 'For experts', h('span', {}, 'tables, curves, fit')), experts, places.fit));
    };
    watch('value', show);
    show();
  }

  globalThis.Phy124 = Object.assign(globalThis.Phy124 || {}, { h, calm, moving, announce, sounds, live, mark, state, places, forecast, progress, viewer, history, report });
})();
