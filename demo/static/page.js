/* The panels of the page: progress, viewer, videos, take-away. Each is a function that Gradio's
 * gr.HTML calls once with its element; `watch` tells when Python sends a new value. */
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
  const size = (bytes) => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

  const calm = () => matchMedia('(prefers-reduced-motion: reduce)').matches;

  /** A picture that moves; where people ask for little motion, its first frame. */
  function moving(src, attributes) {
    const img = h('img', { alt: '', loading: calm() ? 'eager' : 'lazy', ...attributes });
    if (!calm()) { img.src = src; return img; }
    const whole = new Image();
    whole.onload = () => {
      const canvas = h('canvas', { width: whole.naturalWidth, height: whole.naturalHeight });
      canvas.getContext('2d').drawImage(whole, 0, 0);
      img.src = canvas.toDataURL();
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

  /* ---- the forecast, and its button that measures the error of the scene ------------------- */

  function forecast(element, trigger) {
    element.addEventListener('click', (event) => {
      // While something runs it does nothing, as Generate.
      if (event.target.closest('[data-measure]') && !document.querySelector('#go').disabled) trigger('measure');
    });
  }

  /* ---- progress: stages with bars, and the run so far as a flip-book ----------------------- */

  function progress(element, props, watch, trigger) {
    const panel = new ProgressPanel(element, trigger);
    watch('value', () => panel.show(props.value));
    panel.show(props.value);
    document.addEventListener('phy124-asked', () => panel.settle());
    document.addEventListener('phy124-forgotten', () => { if (document.querySelector('#viewer .viewer-host')) trigger('finished', {}); });
  }

  class ProgressPanel {
    constructor(element, trigger) {
      Object.assign(this, { element, trigger, job: null, frames: [], shown: 0 });
      this.picture = h('img', { alt: 'The motion so far', class: 'glimpse' });
    }

    show(value) {
      clearTimeout(this.retry);
      if (!value || !value.state) return this.element.replaceChildren();
      if (!value.job) { this.job = null; return this.end(value); }
      if (value.job === this.job) return;
      Object.assign(this, { job: value.job, frames: [], shown: 0 });
      this.draw(value);
      this.element.scrollIntoView({ block: 'nearest', behavior: calm() ? 'auto' : 'smooth' });
      if (value.kind !== 'measure') globalThis.Phy124.live.begin();
      follow(value.job, (told) => this.take(value.job, told), (told) => this.end(told));
    }

    take(job, told) {
      if (this.job !== job) return false;
      if (told.state === 'lost') { this.say('lost', 'The connection was lost. Your run goes on; trying again …'); return true; }
      for (const glimpse of told.glimpses || []) this.frames.push(`data:image/jpeg;base64,${glimpse}`);
      for (const file of told.live || []) globalThis.Phy124.live.add(`gradio_api/file=${file}`);
      if (told.state === 'waiting' || told.state === 'running') this.draw(told);
      return true;
    }

    draw(told) {
      if (this.frames.length && !this.timer && !calm()) this.timer = setInterval(() => this.flip(), 70);
      const left = Math.max(0, told.expected - told.elapsed);
      const clock = told.state === 'waiting' ? this.waiting(told.place, told.wait)
        : left > 0.5 ? `${seconds(told.elapsed)} so far, about ${seconds(left)} to go` : `${seconds(told.elapsed)} so far, nearly there`;
      this.element.replaceChildren(h('section', { class: `progress ${told.state}`, 'aria-label': 'Progress' },
        this.frames.length ? h('figure', {}, this.picture, h('figcaption', {}, 'Preview, growing')) : null,
        h('div', { class: 'progress-body' }, h('p', { class: 'clock' }, clock), h('ol', { class: 'stages' }, ...(told.stages || []).map(bar)))));
      this.flip();
    }

    waiting(place, wait) {
      if (!(place > 0)) return 'Waiting for the device';
      const time = wait > 0 ? `, about ${seconds(wait)}` : '';
      return `Waiting: ${place} ${place === 1 ? 'run' : 'runs'} before yours${time}`;
    }

    flip() {
      if (!this.frames.length) return;
      const frame = this.frames[calm() ? this.frames.length - 1 : this.shown++ % this.frames.length];
      if (this.picture.src !== frame) this.picture.src = frame;
    }

    end(told) {
      clearInterval(this.timer);
      const job = this.job, long = told.elapsed > 3;
      Object.assign(this, { timer: null, frames: [], shown: 0 });
      if (told.state === 'gone') told = { state: 'failed', message: 'The server no longer knows this run. Generate it again.' };
      if (told.state === 'done') {
        this.element.replaceChildren();
        announce('The result is there.');
        if (long) chime();
      } else { this.say(told.state, told.message); globalThis.Phy124.live.drop(); }
      if (job) this.trigger('finished', { job });
    }

    /** Something else is asked for by now: why the last one was refused no longer matters. */
    settle() { if (this.element.querySelector('.progress.refused')) this.element.replaceChildren(); }

    say(state, message) {
      if (state === 'refused') server.look();
      const again = state === 'full' ? h('button', { type: 'button', class: 'quiet', onclick: () => this.trigger('again') }, 'Try again now') : null;
      if (again) this.retry = setTimeout(() => this.trigger('again'), 10e3);
      this.element.replaceChildren(h('section', { class: `progress ${state}`, 'aria-label': 'Progress' },
        h('div', { class: 'progress-body' }, h('p', { class: 'message', role: 'status' }, message), again)));
    }
  }

  const bar = (row) => {
    const fraction = row.reused ? 1 : row.total ? row.done / row.total : 0;
    return h('li', { class: row.reused ? 'stage reused' : fraction >= 1 ? 'stage full' : fraction ? 'stage going' : 'stage' },
      h('span', { class: 'stage-name' }, row.name),
      h('span', { class: 'stage-note' }, row.note || (row.total > 1 && row.done ? `${row.done} of ${row.total}` : '')),
      h('progress', { max: 1, value: fraction, 'aria-label': row.name }));
  };

  /* ---- the 4D viewer ----------------------------------------------------------------------- */

  /** Frames of a run that is not finished yet, shown as they come. */
  const live = { begin() {}, add() {}, drop() {} };

  function viewer(element, props, watch) {
    const panel = new ViewerPanel(element);
    Object.assign(live, { begin: () => panel.begin(), add: (url) => panel.add(url), drop: () => panel.drop() });
    Object.assign(globalThis.Phy124, { compare: (url, title) => panel.compare(url, title) });
    watch('value', () => panel.show(props.value?.pack?.url, props.value?.invented));
    panel.show(props.value?.pack?.url, props.value?.invented);
  }

  class ViewerPanel {
    constructor(element) { Object.assign(this, { element, player: null, url: false, growing: null, other: null }); }

    async show(url, invented) {
      if (url === this.url && !this.growing) return;
      Object.assign(this, { url, invented });
      const stance = this.player && this.growing ? this.player.stance : null;
      this.growing = null;
      if (!url) { this.clear(); return this.element.replaceChildren(welcome()); }
      const bytes = await read(url);
      if (this.url !== url) return;
      this.clear();
      const host = h('div', { class: 'viewer-host' });
      this.element.replaceChildren(h('div', { class: 'viewer-row' }, host),
        ...(invented ? [h('p', { class: 'invented' }, 'The front is your picture; the back is invented from the outline.')] : []));
      if (!bytes) { host.textContent = 'The result is no longer on the server. Generate it again.'; return; }
      this.player = await this.mount(host, bytes, stance);
      this.element.player = this.player;
      this.element.scrollIntoView({ block: 'nearest', behavior: calm() ? 'auto' : 'smooth' });
    }

    async mount(host, bytes, stance) {
      const player = await Phy124Player.mount(host, bytes);
      if (player && stance) player.stand(stance);
      return player;
    }

    clear() {
      for (const each of [this.player, this.other]) if (each) each.dispose();
      Object.assign(this, { player: null, other: null });
    }

    begin() { this.growing = { waiting: [], drawn: false, busy: false }; }

    /** A frame that was just computed: the first one makes a player, the others lengthen its clip. */
    async add(url) {
      const growing = this.growing;
      if (!growing) return;
      growing.waiting.push(url);
      if (growing.busy) return;
      growing.busy = true;
      while (growing.waiting.length) await this.grow(growing, growing.waiting.shift());
      growing.busy = false;
    }

    async grow(growing, url) {
      const bytes = await read(url);
      if (!bytes || this.growing !== growing) return;
      if (growing.drawn) { await this.player?.extend(bytes); return; }
      growing.drawn = true;
      const stance = this.player?.stance;
      this.clear();
      const host = h('div', { class: 'viewer-host growing' });
      this.element.replaceChildren(h('div', { class: 'viewer-row' }, host));
      this.player = await Phy124Player.mount(host, bytes, { growing: true });
      if (this.player && stance) this.player.stand(stance);
    }

    /** The run failed: the previous result is shown again. */
    drop() {
      if (!this.growing) return;
      this.show(this.url, this.invented);
    }

    /** Another result beside this one, seen from the same place at the same time. */
    async compare(url, title) {
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
    document.addEventListener('phy124-failed', () => questions.pending && questions.answered());
    const show = () => {
      questions.answered();
      const runs = (props.value && props.value.runs) || [];
      if (runs.length < 2) return element.replaceChildren();
      const item = ({ job, title, detail, picture, pack, current }) => h('li', { class: current ? 'current' : '' },
        h('button', { type: 'button', 'aria-pressed': current ? 'true' : 'false', onclick: () => questions.ask('show', { job, earlier: true }) },
          moving(picture.url, { width: 72, height: 72 }), h('strong', {}, title), h('span', {}, detail)),
        current ? null : h('button', { type: 'button', class: 'quiet', onclick: () => globalThis.Phy124.compare(pack.url, `${title}, ${detail}`) }, 'Beside'));
      element.replaceChildren(h('section', { class: 'history', 'aria-label': 'Earlier results' }, h('h3', {}, 'Your results'), h('ul', {}, ...runs.map(item))));
    };
    watch('value', show);
    show();
  }

  const welcome = () => h('div', { class: 'welcome' },
    moving('phy124/previews/press.webp', { width: 210, height: 210 }),
    h('h2', {}, 'See it move'),
    h('p', {}, 'Choose a picture of one object and what should happen to it. Here it will turn, bend and bounce in 3D, as its material would.'));

  /* ---- videos ------------------------------------------------------------------------------ */

  const RATES = [0.1, 0.25, 0.5, 1];

  function videos(element, props, watch) {
    let rate = 1;
    const show = () => {
      const { films = [], length = 1 } = props.value || {};
      if (!films.length) return element.replaceChildren(h('p', { class: 'empty' }, 'The videos of each view appear here.'));
      rate = length < 1 ? 0.5 : 1;
      const made = films.map(film);
      const pick = h('select', { 'aria-label': 'Speed of the videos', onchange: () => { rate = Number(pick.value); for (const video of element.querySelectorAll('video')) video.playbackRate = rate; } },
        ...RATES.map((r) => h('option', { value: r, selected: r === rate }, r === 1 ? 'Real time' : `Slowed to ${r}×`)));
      element.replaceChildren(h('div', { class: 'films-head' }, pick), h('div', { class: 'films' }, ...made));
    };
    const film = ({ name, file }) => {
      const video = h('video', { src: file.url, loop: true, playsinline: true, preload: 'auto', tabindex: 0, 'aria-label': `Video, ${name}` });
      video.muted = true;
      video.addEventListener('loadedmetadata', () => { video.playbackRate = rate; });
      for (const [event, on] of [['pointerenter', true], ['focus', true], ['pointerleave', false]]) {
        video.addEventListener(event, () => { video.controls = on; });
      }
      if (!calm()) video.autoplay = true;
      return h('figure', { class: 'film' }, video, h('figcaption', {}, name));
    };
    watch('value', show);
    show();
  }

  /* ---- take-away --------------------------------------------------------------------------- */

  function takeaway(element, props, watch, trigger) {
    const making = new Set();
    let shown = {}, last = null;
    const show = (value) => {
      if (value.asked && value.result && value.result !== shown.result) return; // of another result
      if (value.result !== shown.result) making.clear();
      making.delete(value.asked);
      shown = value;
      const link = ({ label, hint, file }) => h('a', { class: 'file', href: file.url, download: file.orig_name, 'data-name': file.orig_name },
        h('strong', {}, label), h('span', {}, hint), h('em', {}, size(file.size || 0)));
      const button = ({ kind, label, hint, about }) => h('button', { type: 'button', class: 'file', 'data-kind': kind, 'aria-busy': making.has(kind) && 'true',
        onclick: (event) => { making.add(last = kind); event.currentTarget.setAttribute('aria-busy', 'true'); trigger('prepare', { kind }); } },
      h('strong', {}, label), h('span', {}, hint), h('em', {}, about ? `Make, ~${size(about)}` : 'Make'));
      const shared = ({ link, lasts }) => {
        const url = new URL(link, document.baseURI).href;
        const copy = h('button', { type: 'button', onclick: () => navigator.clipboard?.writeText(url).then(() => { copy.textContent = 'Copied'; }) }, 'Copy');
        return h('p', { class: 'shared', role: 'status' }, h('a', { href: url, target: '_blank', rel: 'noopener' }, url), copy, h('span', {}, lasts));
      };
      element.replaceChildren(value.files ? h('div', { class: 'files' }, ...value.files.map(link), ...value.offers.map(button))
        : h('p', { class: 'empty' }, 'Videos, the moving Gaussians and the scene can be taken away from here.'));
      if (value.message) element.append(h('p', { class: 'message', role: 'alert' }, value.message));
      if (value.share) element.append(shared(value.share));
      const made = value.asked === last && value.file ? element.querySelector(`[data-name="${value.file}"]`) : null;
      // Not opened by itself: browsers may block downloads that no click has asked for.
      if (made) { last = null; made.classList.add('new'); made.focus(); }
    };
    watch('value', () => show(props.value || {}));
    show(props.value || {});
    document.addEventListener('phy124-failed', () => {
      if (!making.size) return;
      making.clear();
      show({ ...shown, asked: null, message: 'The server could not make this. Try again.' });
    });
  }

  globalThis.Phy124 = Object.assign(globalThis.Phy124 || {}, { h, calm, moving, announce, sounds, live, forecast, progress, viewer, history, videos, takeaway });
})();
