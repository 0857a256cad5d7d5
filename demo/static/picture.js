/* The picture panel: choose a picture (file, drop, paste, camera, ready result), see its cut-out, click
 * another object, or correct the cut-out by brush. Large photographs are reduced before they are sent. A
 * file of Gaussians may replace the picture. */
'use strict';
(() => {
  const { h, follow, mark, state, server, Questions } = globalThis.Phy124;
  const KEPT = 'phy124-picture', LARGEST = 3e6; // a browser tab can store a few MB of text
  const SIDE = 2048; // the server uses no larger picture
  const UNREAD = 'The file cannot be read: it was changed, moved or removed after it was chosen. Choose it again.';
  const ACCEPT = 'image/png,image/jpeg,image/webp,image/heic,image/heif,image/avif,.heic,.heif,.avif';

  async function picture(element, props, watch, trigger) {
    const offer = await (await fetch('phy124/catalogue.json')).json();
    new PicturePanel(element, props, watch, trigger, offer);
  }

  class PicturePanel {
    constructor(element, props, watch, trigger, offer) {
      Object.assign(this, { element, props, offer, following: null });
      // Another picture ends the work on the earlier one.
      this.questions = new Questions((event, what) => trigger(event, event === 'choose' ? { ...what, job: this.props.value?.job } : what));
      this.status = h('div', { class: 'picture-status', role: 'status' });
      this.again = h('button', { type: 'button', class: 'quiet', hidden: true, onclick: () => this.retry() }, 'Try again');
      this.brush = new globalThis.Phy124.Brush((strokes) => this.correct({ strokes }), (pick) => this.correct({ pick }));
      this.preview = h('figure', { id: 'cutout', hidden: true }, h('img', { alt: 'The object, cut out' }));
      this.drop = this.dropzone();
      this.another = h('button', { type: 'button', class: 'link another', 'aria-label': 'Another picture', onclick: () => this.input.click() }, 'Another');
      element.replaceChildren(h('h2', { class: 'picture-head' }, 'Picture', this.another), this.drop, this.status, this.again, this.brush.opener, this.brush.element);
      document.addEventListener('phy124-ready', (event) => this.take({ example: event.detail.example }, true));
      document.addEventListener('paste', (event) => this.paste(event));
      document.addEventListener('phy124-way', (event) => { if (this.props.value?.file) this.shown.src = event.detail; });
      document.addEventListener('phy124-failed', () => this.fail());
      document.addEventListener('phy124-forgotten', () => this.restore());
      watch('value', () => this.show());
      this.show();
      if (server.forgot) this.restore();
    }

    dropzone() {
      const endings = this.offer.limits.file_endings, camera = '<svg viewBox="0 0 20 20" aria-hidden="true"><path d="M3 6.5h3l1.3-2h5.4l1.3 2h3v9.5H3z"/><circle cx="10" cy="11" r="3"/></svg>';
      const input = this.input = h('input', { type: 'file', accept: [ACCEPT, ...endings].join(), 'aria-label': 'Choose a picture or a file of Gaussians', onchange: () => this.take({ file: input.files[0] }) });
      this.shown = h('img', { alt: 'Your picture', title: 'Click the object', hidden: true, onclick: (event) => this.pick(event) });
      this.hint = h('span', { class: 'photo-hint', title: `or a file of Gaussians: ${endings.join(' ')}` }, h('strong', { class: 'filled' }, 'Choose a picture'), h('small', {}, 'or drop it here'));
      const shoot = h('button', { type: 'button', class: 'camera icon', 'aria-label': 'Camera', title: 'Camera', onclick: () => this.photograph() });
      shoot.innerHTML = camera;
      const zone = h('div', { id: 'photo' }, h('label', {}, input, this.shown, this.preview, this.hint), shoot);
      for (const name of ['dragover', 'dragleave', 'drop']) {
        zone.addEventListener(name, (event) => { event.preventDefault(); zone.classList.toggle('over', name === 'dragover'); });
      }
      zone.addEventListener('drop', ({ dataTransfer: { files } }) => {
        if (files.length === 1) this.take({ file: files[0] });
        else this.say(files.length ? 'Choose one picture at a time.' : 'This is not a file.', true);
      });
      return zone;
    }

    /** Choose the object at a click; the picture may have blank margins. */
    pick(event) {
      event.preventDefault(); // otherwise the label would open the file dialog
      if (this.props.value?.file) return;
      const box = this.shown.getBoundingClientRect(), { naturalWidth, naturalHeight } = this.shown;
      const scale = Math.min(box.width / naturalWidth, box.height / naturalHeight);
      const x = 0.5 + (event.clientX - box.left - box.width / 2) / (scale * naturalWidth);
      const y = 0.5 + (event.clientY - box.top - box.height / 2) / (scale * naturalHeight);
      if (Math.min(x, y) >= 0 && Math.max(x, y) <= 1) this.brush.pick([x, y]);
    }

    paste(event) {
      const file = [...(event.clipboardData?.files || [])].find((f) => f.type.startsWith('image/'));
      if (file) { event.preventDefault(); this.take({ file }); }
    }

    async photograph() {
      let stream;
      try { stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: 'environment', width: { ideal: SIDE } } }); }
      catch { return this.say('This device has no camera, or the browser does not allow its use.', true); }
      const video = h('video', { autoplay: true, playsinline: true, 'aria-label': 'Camera' });
      video.muted = true;
      video.srcObject = stream;
      const close = () => { stream.getTracks().forEach((track) => track.stop()); dialog.remove(); };
      const take = async () => {
        const canvas = h('canvas', { width: video.videoWidth, height: video.videoHeight });
        canvas.getContext('2d').drawImage(video, 0, 0);
        close();
        this.take({ file: await new Promise((done) => canvas.toBlob(done, 'image/jpeg', 0.92)) });
      };
      const dialog = h('dialog', { class: 'camera-dialog', 'aria-label': 'Take a photograph', onclose: close }, video,
        h('button', { type: 'button', onclick: take }, 'Take the photograph'), h('button', { type: 'button', onclick: close }, 'Close'));
      document.body.append(dialog);
      dialog.showModal();
    }

    /** Choose an example or a file, and store it to send it again; `ready`: its result is already on the stage. */
    take(chosen, ready = false) {
      if (state.running || state.touching) return this.say('The picture was not changed, because a run is going on.', true);
      Object.assign(this, { chosen, fresh: !ready, corrected: null });
      this.begin(chosen);
    }

    begin({ example, file }) {
      if (file) this.send(file);
      else if (example) { this.choose({ example }); keep({ example }); }
    }

    /** Send the picture again, with the same corrections, because the server no longer has it. */
    restore() {
      this.following = null;
      const chosen = this.chosen || kept();
      if (chosen) {
        Object.assign(this, { chosen, restoring: true });
        this.begin(chosen);
      } else if (this.props.value?.picture) this.refuse('The server no longer has your picture. Choose it again.');
    }

    /** Send a file, reduced if it is large, and ask the server to cut it out. */
    async send(file) {
      const { limits } = this.offer, gaussians = isOfGaussians(file, limits);
      if (gaussians && file.size > limits.file_bytes) return this.refuse(limits.too_large);
      this.say(`Sending the ${gaussians ? 'file' : 'picture'} …`);
      mark({ opening: `the ${gaussians ? 'file' : 'picture'} is being sent` });
      const small = gaussians ? file : await reduced(file, limits);
      this.input.value = '';
      if (this.chosen?.file !== file) return; // another file was chosen meanwhile
      const { path, message, lost } = await sent(small, limits);
      if (this.chosen?.file !== file) return;
      if (message) return this.refuse(message, lost && (() => this.send(file)));
      keep({ file: small });
      this.choose({ upload: path }, gaussians);
    }

    choose(what, reads = false) {
      this.local = null;
      this.say(reads ? 'Reading the file …' : 'Cutting out the object …');
      mark({ opening: opening(reads) });
      this.ask('choose', what);
    }

    /** Send brush strokes, or a click on another object. */
    correct(how) {
      this.corrected = how.pick ? how : { ...this.corrected, ...how };
      this.ask('correct', how);
    }

    ask(event, what) {
      // A request about this picture has no meaning once another picture has been chosen.
      if (event !== 'choose' && this.questions.holds('choose')) return;
      this.last = () => this.questions.ask(event, what);
      this.last();
    }

    /** Handle a request that failed, for which no new value arrives. */
    fail() {
      if (!this.questions.pending || this.questions.answered()) return;
      mark({ opening: '' });
      this.say('The server could not process the picture.', true);
      this.again.hidden = false;
    }

    retry() { this.again.hidden = true; this.last(); }

    /** Ask the server to forget the earlier picture, which must not be used after a refusal. */
    refuse(message, again = null) {
      this.restoring = false;
      mark({ opening: '' });
      this.questions.ask('choose', {});
      this.local = message;
      this.say(message, true);
      if (again) { this.last = again; this.again.hidden = false; }
    }

    /** Show a text; `details` are hidden below the text until they are opened. */
    say(text, bad = false, details = '') {
      this.status.replaceChildren(text, details ? h('details', {}, h('summary', {}, 'Details'), details) : '');
      this.status.classList.toggle('bad', bad);
      this.again.hidden = true;
    }

    show() {
      if (this.questions.answered()) return;
      const value = this.props.value || {};
      const [photo, cut] = [value.picture?.url, value.cutout?.url];
      this.drop.classList.toggle('full', Boolean(photo));
      this.drop.classList.toggle('cut', Boolean(cut));
      this.shown.hidden = !photo;
      if (photo) this.shown.src = photo; else this.shown.removeAttribute('src');
      this.hint.hidden = Boolean(photo);
      this.preview.hidden = !cut;
      if (cut) this.preview.firstChild.src = cut; else this.preview.firstChild.removeAttribute('src');
      this.drop.classList.toggle('file', Boolean(value.file));
      this.brush.load(value.file ? null : photo, cut, this.restoring);
      mark({ picture: Boolean(cut || value.file) && !value.job, opening: value.job ? opening(value.reads) : '' });
      if (value.job && !cut) this.brush.opener.hidden = true;
      if (value.job) return this.await(value);
      const seen = cut || (value.file && photo);
      if (seen) document.dispatchEvent(new Event('phy124-asked'));
      const restored = Boolean(this.restoring);
      document.dispatchEvent(new CustomEvent('phy124-cut', { detail: { url: seen, photo, restored, fresh: Boolean(this.fresh) && !restored } }));
      const again = this.restoring && cut && this.corrected;
      this.restoring = false;
      if (again) return this.correct(this.corrected);
      if (value.message) { this.say(value.message, true); this.again.hidden = !value.again; }
      else if (value.file) this.say(value.file);
      else if (photo) this.say(value.warning || '', Boolean(value.warning), value.doubts);
      else { this.say(this.local || '', Boolean(this.local)); this.local = null; }
    }

    await({ job, seconds, reads }) {
      if (this.following === job) return;
      this.following = job;
      this.say(reads ? 'Reading the file and drawing its orientations …' : `Cutting out the object${seconds ? `, about ${seconds} s` : ''} …`);
      follow(job, (told) => {
        if (this.following !== job) return false;
        if (told.state === 'waiting' && told.place) this.say(`Waiting: ${told.place} before you`);
        else if (told.state === 'lost') this.say('The connection was lost. Reconnecting …');
        return true;
      }, (told) => {
        if (this.following !== job) return;
        this.following = null;
        if (told.state === 'gone') this.refuse('The server no longer has your picture. Choose it again.');
        else this.ask('cut', { job });
      });
    }
  }

  /** Return a text that says how the server processes a chosen picture or file. */
  const opening = (reads) => reads ? 'the file is being read' : 'the picture is being cut out';

  const isOfGaussians = (file, limits) => limits.file_endings.some((ending) => (file.name || '').toLowerCase().endsWith(ending));

  /** Store a picture in this tab, because the server may not have the picture after a reload. */
  async function keep({ example, file }) {
    try {
      sessionStorage.removeItem(KEPT);
      if (file?.size > LARGEST) return;
      const url = file && await new Promise((done) => { const reader = new FileReader(); reader.onload = () => done(reader.result); reader.readAsDataURL(file); });
      sessionStorage.setItem(KEPT, JSON.stringify({ example, url, name: file?.name, type: file?.type }));
    } catch { /* storage is not available */ }
  }

  function kept() {
    try {
      const { example, url, name, type } = JSON.parse(sessionStorage.getItem(KEPT));
      if (example) return { example };
      return { file: new File([Uint8Array.from(atob(url.split(',')[1]), (c) => c.charCodeAt(0))], name, { type }) };
    } catch { return null; }
  }

  /** Reduce a picture to the size that the server needs; return a file that this browser cannot read unchanged. */
  async function reduced(file, limits) {
    let bitmap;
    try { bitmap = await createImageBitmap(file, { imageOrientation: 'from-image' }); } catch { return file; }
    const { width, height } = bitmap, scale = Math.min(1, SIDE / Math.max(width, height));
    const usual = /png|jpeg|webp/.test(file.type);
    if (usual && scale === 1 && file.size <= limits.bytes) return file;
    const canvas = h('canvas', { width: Math.max(1, Math.round(width * scale)), height: Math.max(1, Math.round(height * scale)) });
    const context = canvas.getContext('2d');
    context.imageSmoothingQuality = 'high';
    context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
    const clear = /png|webp/.test(file.type);
    const blob = (type) => new Promise((done) => canvas.toBlob(done, type, 0.92));
    let made = await blob(clear ? 'image/png' : 'image/jpeg');
    if (clear && made.size > limits.bytes) made = await blob('image/webp');
    return new File([made], `picture.${made.type.split('/')[1]}`, { type: made.type });
  }

  /** Return whether a file can be read; browsers do not read a file that was changed after it was chosen. */
  const isReadable = (file) => file.slice(0, 1).arrayBuffer().then(() => true, () => false);

  /** Send a file; return its path on the server, or the reason of a refusal and whether the connection was lost. */
  async function sent(file, limits) {
    const form = new FormData();
    form.append('files', file, file.name || 'picture.png');
    let answer;
    try { answer = await fetch('gradio_api/upload', { method: 'POST', body: form }); }
    catch { return await isReadable(file) ? { message: 'The file could not be sent: the connection was lost.', lost: true } : { message: UNREAD }; }
    if (!answer.ok) return { message: answer.status === 413 ? limits.too_large : await answer.text() };
    server.look();
    return { path: (await answer.json())[0] };
  }

  Object.assign(globalThis.Phy124, { picture, reduced, sent });
})();
