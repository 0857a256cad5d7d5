/* Fit to a video: estimates the softness of the object in a video. */
'use strict';
(() => {
  const { h, follow, places, announce } = globalThis.Phy124;
  const ACCEPT = 'video/mp4,video/webm,video/quicktime,video/x-matroska,image/gif,.mp4,.mov,.webm,.mkv,.avi,.gif';
  const SPEEDS = [1, 0.5, 0.25, 0.1];
  const HINT = 'Film the same object in the same motion: at rest in the first frame, in front of a plain background.';

  const clock = (s) => (s < 90 ? `${Math.round(s)} s` : `${(s / 60).toFixed(1)} min`);

  function fit(element, props, watch, trigger) {
    const panel = new FitPanel(places.fit, trigger);
    watch('value', () => panel.show(props.value));
    panel.show(props.value);
    document.addEventListener('phy124-failed', () => panel.fail());
  }

  class FitPanel {
    constructor(element, trigger) {
      Object.assign(this, { element, trigger, job: null, file: null });
      this.status = h('p', { class: 'fit-status', role: 'status' });
      this.result = h('div', { class: 'fit-result' });
    }

    show(value) {
      const { offer, refusal, job, message, found } = value || {};
      if (!offer) { this.file = null; return this.element.replaceChildren(h('p', { class: 'empty' }, refusal || 'Generate a result first.')); }
      this.value = value;
      if (!this.form || this.offered !== JSON.stringify(offer)) { this.offered = JSON.stringify(offer); this.form = this.draw(value); this.choose(this.file); }
      if (this.element.firstChild !== this.form) this.element.replaceChildren(this.form, this.status, this.result);
      this.result.replaceChildren(...(found ? this.found(found) : []));
      if (job) return this.await(job);
      if (this.job) return; // the panel already shows the progress of another fit
      this.busy(false);
      this.say(message || '', Boolean(message));
    }

    draw({ offer, fields }) {
      const input = this.input = h('input', { type: 'file', accept: ACCEPT, 'aria-label': 'Choose a video', onchange: () => this.choose(input.files[0]) });
      this.name = h('span', { class: 'fit-hint' }, h('strong', {}, 'Find the softness from a video'), HINT);
      this.preview = h('video', { hidden: true, playsinline: true, loop: true, 'aria-label': 'Your video' });
      this.preview.muted = true;
      const slot = h('label', { class: 'fit-slot' }, input, this.preview, this.name);
      for (const name of ['dragover', 'dragleave', 'drop']) {
        slot.addEventListener(name, (event) => { event.preventDefault(); slot.classList.toggle('over', name === 'dragover'); });
      }
      slot.addEventListener('drop', (event) => this.choose(event.dataTransfer.files[0]));
      const { least, most, value } = offer.budget, told = h('output', {}, clock(value));
      this.budget = h('input', { type: 'range', min: least, max: most, step: 1, value, 'aria-label': 'Time limit of the fit', oninput: () => {
        told.textContent = clock(Number(this.budget.value));
        this.forecast.textContent = `A fit takes at most ${clock(Number(this.budget.value))}.`;
      } });
      this.forecast = h('p', { class: 'fit-forecast' }, offer.sentence);
      this.side = h('select', { 'aria-label': 'Side' }, ...fields.side.enum.map((side) => h('option', { value: side }, side)));
      this.speed = h('select', { 'aria-label': 'Speed of the video' }, ...SPEEDS.map((speed) => h('option', { value: speed }, speed === 1 ? 'real time' : `slowed to ${speed}×`)));
      this.go = h('button', { type: 'button', class: 'filled fit-go', disabled: true, onclick: () => this.begin() }, 'Fit');
      this.cancel = h('button', { type: 'button', class: 'quiet fit-cancel', hidden: true, onclick: () => this.stop() }, 'Cancel');
      const row = (label, field, control, ...more) => h('label', { title: field.description }, h('span', {}, label), control, ...more);
      return h('div', { class: 'fit' }, slot, h('div', { class: 'fit-form' },
        row('Filmed from the', fields.side, this.side), row('Video speed', fields.speed, this.speed),
        row('Time limit', fields.seconds, this.budget, told),
        this.forecast, h('div', { class: 'fit-buttons' }, this.go, this.cancel)));
    }

    choose(file) {
      if (!file || this.job) return;
      this.input.value = '';
      if (file.size > this.value.largest * 1e6) return this.say(`The video is larger than ${this.value.largest} MB, the limit of this page. Send a shorter or smaller one.`, true);
      this.file = file;
      if (this.address) URL.revokeObjectURL(this.address);
      this.address = URL.createObjectURL(file);
      this.preview.src = this.address;
      this.preview.hidden = false;
      this.name.replaceChildren(h('strong', {}, file.name));
      this.go.disabled = false;
      this.say('');
    }

    async begin() {
      this.stopping = false;
      this.busy(true);
      this.say('Sending the video …');
      const { path, message } = await globalThis.Phy124.sent(this.file, { too_large: 'The video is larger than the limit of this page. Send a shorter one.' });
      if (message || this.stopping) { this.busy(false); return this.say(message || '', Boolean(message)); }
      this.trigger('begin', { upload: path, side: this.side.value, speed: Number(this.speed.value), seconds: Number(this.budget.value) });
    }

    /** Stop the fit; a fit that has not begun is stopped when it begins. */
    stop() {
      this.stopping = true;
      this.trigger('stop');
    }

    /** Handle an error that the server answered; a fit that has begun continues. */
    fail() {
      if (this.job || !this.go?.hidden) return;
      this.busy(false);
      this.say('The server could not start the fit. Try again.', true);
    }

    busy(now) {
      this.go.disabled = now || !this.file;
      this.go.hidden = now;
      this.cancel.hidden = !now;
      for (const field of [this.input, this.budget, this.side, this.speed]) field.disabled = now;
    }

    say(text, bad = false) {
      this.status.replaceChildren(text);
      this.status.classList.toggle('bad', bad);
    }

    await(job) {
      if (this.job === job) return;
      this.job = job;
      this.busy(true);
      if (this.stopping) this.trigger('stop');
      follow(job, (told) => this.take(job, told), (told) => {
        Object.assign(this, { job: null, stopping: false });
        this.busy(false);
        this.say(told.state === 'done' ? '' : told.message || 'The server no longer has this fit.', told.state !== 'done');
        announce(told.state === 'done' ? 'The fit is finished.' : told.message || '');
        this.trigger('ended', { job });
      });
    }

    take(job, told) {
      if (this.job !== job) return false;
      if (told.state === 'lost') this.say('The connection was lost. Reconnecting …');
      else if (told.state === 'waiting') this.say(told.place ? `Waiting: ${told.place} before you` : 'Waiting');
      else if (told.state === 'running') this.progress(told);
      return true;
    }

    progress({ elapsed, expected, stages }) {
      const left = expected - elapsed, text = left > 0.5 ? `about ${clock(left)} to go` : 'nearly there';
      const bar = ({ name, done, total, note }) => h('li', { class: 'stage going' }, h('span', {}, name), h('span', { class: 'stage-note' }, note),
        h('progress', { max: 1, value: total ? done / total : 0, 'aria-label': name }));
      this.status.classList.remove('bad');
      this.status.replaceChildren(h('span', { class: 'fit-clock' }, text), h('ol', { class: 'stages' }, ...stages.map(bar)));
    }

    found({ sentences, figure, film, material }) {
      const shown = h('div', {});
      shown.innerHTML = figure; // made by phy124/studies/fit/page.py, which escapes all text
      shown.querySelector('video').src = film.url;
      globalThis.Phy124Compare(shown.firstChild);
      const [first, ...rest] = sentences;
      const use = h('button', { type: 'button', class: 'quiet fit-use', onclick: () => {
        document.dispatchEvent(new CustomEvent('phy124-material', { detail: material }));
        use.textContent = 'The next run uses this softness';
      } }, 'Use this softness');
      return [h('p', { class: 'fit-found' }, h('strong', {}, first), use), ...rest.map((text) => h('p', { class: 'fit-more' }, text)), shown];
    }
  }

  Object.assign(globalThis.Phy124, { fit });
})();
