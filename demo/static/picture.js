/* The picture panel: choose a picture (file, drop, paste, camera, example), see its cut-out, correct
 * it by brush. Large photographs are reduced here, before they are sent. A file of Gaussians may take the
 * picture's place. */
'use strict';
(() => {
  const { h, follow, server, Questions } = globalThis.Phy124;
  const KEPT = 'phy124-picture', LARGEST = 3e6; // a tab keeps a few MB of text
  const SIDE = 2048; // the server looks no closer
  const ACCEPT = 'image/png,image/jpeg,image/webp,image/heic,image/heif,image/avif,.heic,.heif,.avif';

  async function picture(element, props, watch, trigger) {
    const offer = await (await fetch('phy124/catalogue.json')).json();
    new PicturePanel(element, props, watch, trigger, offer);
  }

  class PicturePanel {
    constructor(element, props, watch, trigger, offer) {
      Object.assign(this, { element, props, offer, questions: new Questions(trigger), following: null });
      this.status = h('p', { class: 'picture-status', role: 'status' });
      this.again = h('button', { type: 'button', class: 'quiet', hidden: true, onclick: () => this.retry() }, 'Try again');
      this.brush = new globalThis.Phy124.Brush((strokes) => this.correct({ strokes }), (pick) => this.correct({ pick }));
      this.drop = this.dropzone();
      this.preview = h('figure', { id: 'cutout', hidden: true }, h('img', { alt: 'The object, cut out' }));
      element.replaceChildren(h('div', { class: 'pictures' }, this.drop, this.preview), this.status, this.again,
        this.examples(), this.brush.element);
      document.addEventListener('paste', (event) => this.paste(event));
      document.addEventListener('phy124-way', (event) => { if (this.props.value?.file) this.shown.src = event.detail; });
      document.addEventListener('phy124-failed', () => this.fail());
      document.addEventListener('phy124-forgotten', () => this.restore());
      watch('value', () => this.show());
      this.show();
      if (server.forgot) this.restore();
    }

    dropzone() {
      const input = this.input = h('input', { type: 'file', accept: [ACCEPT, ...this.offer.limits.file_endings].join(), 'aria-label': 'Choose a picture or a file of Gaussians', onchange: () => this.take({ file: input.files[0] }) });
      this.shown = h('img', { alt: 'Your picture', title: 'Click the object that is meant', hidden: true, onclick: (event) => this.pick(event) });
      this.hint = h('span', { class: 'photo-hint' }, h('strong', {}, 'Choose a picture'), 'or drop or paste it here', h('small', {}, `Gaussians, too: ${this.offer.limits.file_endings.join(' ')}`));
      const zone = h('div', { id: 'photo' }, h('label', {}, input, this.shown, this.hint),
        h('button', { type: 'button', class: 'quiet another', 'aria-label': 'Another picture', onclick: () => input.click() }, 'Another'),
        h('button', { type: 'button', class: 'quiet camera', onclick: () => this.photograph() }, 'Camera'));
      for (const name of ['dragover', 'dragleave', 'drop']) {
        zone.addEventListener(name, (event) => { event.preventDefault(); zone.classList.toggle('over', name === 'dragover'); });
      }
      zone.addEventListener('drop', (event) => this.take({ file: event.dataTransfer.files[0] }));
      return zone;
    }

    /** A click on the picture that is shown, whose sides may be blank: the object there is meant. */
    pick(event) {
      event.preventDefault(); // the label would ask for another file
      if (this.props.value?.file) return;
      const box = this.shown.getBoundingClientRect(), { naturalWidth, naturalHeight } = this.shown;
      const scale = Math.min(box.width / naturalWidth, box.height / naturalHeight);
      const x = 0.5 + (event.clientX - box.left - box.width / 2) / (scale * naturalWidth);
      const y = 0.5 + (event.clientY - box.top - box.height / 2) / (scale * naturalHeight);
      if (Math.min(x, y) >= 0 && Math.max(x, y) <= 1) this.brush.pick([x, y]);
    }

    examples() {
      const button = (name) => h('button', { type: 'button', 'aria-label': `Example: ${name.replace(/_/g, ' ')}`, onclick: () => this.take({ example: name }) },
        h('img', { src: `phy124/examples/${name}.png`, alt: '', width: 48, height: 48, loading: 'lazy' }));
      return h('div', {}, h('p', { class: 'examples-title' }, 'Or begin with one of these'), h('div', { class: 'examples' }, ...this.offer.examples.map(button)));
    }

    paste(event) {
      const file = [...(event.clipboardData?.files || [])].find((f) => f.type.startsWith('image/'));
      if (file) { event.preventDefault(); this.take({ file }); }
    }

    async photograph() {
      let stream;
      try { stream = await navigator.mediaDevices.getUserMedia({ video: { facingMode: 'environment', width: { ideal: SIDE } } }); }
      catch { return this.say('There is no camera, or it may not be used here.', true); }
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

    /** What a visitor has chosen: an example, or a file; it is kept to be sent again. */
    take(chosen) {
      Object.assign(this, { chosen, corrected: null });
      this.begin(chosen);
    }

    begin({ example, file }) {
      if (file) this.send(file);
      else if (example) { this.choose({ example }); keep({ example }); }
    }

    /** The server has forgotten the picture: it is sent again, and corrected as it was. */
    restore() {
      this.following = null;
      const chosen = this.chosen || kept();
      if (chosen) {
        Object.assign(this, { chosen, restoring: true });
        this.begin(chosen);
      } else if (this.props.value?.picture) this.refuse('The server no longer has your picture. Choose it once more.');
    }

    /** Send a file, reduced if it is large, and have it cut out. */
    async send(file) {
      const { limits } = this.offer, gaussians = isOfGaussians(file, limits);
      if (gaussians && file.size > limits.file_bytes) return this.refuse(limits.too_large);
      this.say(`Sending the ${gaussians ? 'file' : 'picture'} …`);
      const small = gaussians ? file : await reduced(file, limits);
      this.input.value = '';
      if (this.chosen?.file !== file) return; // another one was chosen meanwhile
      const { path, message, lost } = await sent(small, limits);
      if (this.chosen?.file !== file) return;
      if (message) return this.refuse(message, lost && (() => this.send(file)));
      keep({ file: small });
      this.choose({ upload: path }, gaussians);
    }

    choose(what, reads = false) {
      this.local = null;
      this.say(reads ? 'Reading the file …' : 'Cutting the object out …');
      this.ask('choose', what);
    }

    /** Brush strokes, or a click on another object. */
    correct(how) {
      this.corrected = how.pick ? how : { ...this.corrected, ...how };
      this.ask('correct', how);
    }

    ask(event, what) {
      // A question about this picture has no meaning once another one has been chosen.
      if (event !== 'choose' && this.questions.holds('choose')) return;
      this.last = () => this.questions.ask(event, what);
      this.last();
    }

    /** A request was answered by an error, which carries no new value. */
    fail() {
      if (!this.questions.pending || this.questions.answered()) return;
      this.say('The server could not do this.', true);
      this.again.hidden = false;
    }

    retry() { this.again.hidden = true; this.last(); }

    /** What was chosen before must not be generated from after a refusal: the server forgets it. */
    refuse(message, again = null) {
      this.restoring = false;
      this.questions.ask('choose', {});
      this.local = message;
      this.say(message, true);
      if (again) { this.last = again; this.again.hidden = false; }
    }

    say(text, bad = false) {
      this.status.textContent = text;
      this.status.classList.toggle('bad', bad);
      this.again.hidden = true;
    }

    show() {
      if (this.questions.answered()) return;
      const value = this.props.value || {};
      const [photo, cut] = [value.picture?.url, value.cutout?.url];
      this.drop.classList.toggle('full', Boolean(photo));
      this.shown.hidden = !photo;
      if (photo) this.shown.src = photo; else this.shown.removeAttribute('src');
      this.hint.hidden = Boolean(photo);
      this.preview.hidden = !cut;
      if (cut) this.preview.firstChild.src = cut; else this.preview.firstChild.removeAttribute('src');
      this.drop.classList.toggle('file', Boolean(value.file));
      this.brush.load(value.file ? null : photo, cut, this.restoring);
      if (value.job && !cut) this.brush.element.hidden = true;
      if (value.job) return this.await(value);
      if (cut || value.file) document.dispatchEvent(new Event('phy124-asked'));
      const again = this.restoring && cut && this.corrected;
      this.restoring = false;
      if (again) return this.correct(this.corrected);
      if (value.message) { this.say(value.message, true); this.again.hidden = !value.again; }
      else if (value.file) this.say(value.file);
      else if (photo) this.say([cut && `The object is cut out by ${value.by}.`, value.doubts].filter(Boolean).join(' '), Boolean(value.doubts));
      else { this.say(this.local || '', Boolean(this.local)); this.local = null; }
    }

    await({ job, seconds, reads }) {
      if (this.following === job) return;
      this.following = job;
      this.say(reads ? 'Reading the file, and drawing it all ways up …' : `Cutting the object out${seconds ? `, about ${seconds} s` : ''} …`);
      follow(job, (told) => {
        if (this.following !== job) return false;
        if (told.state === 'waiting' && told.place) this.say(`Waiting to be ${reads ? 'read' : 'cut out'}, ${told.place} before this ${reads ? 'file' : 'picture'}`);
        else if (told.state === 'lost') this.say('The connection was lost. Trying again …');
        return true;
      }, (told) => {
        if (this.following !== job) return;
        this.following = null;
        if (told.state === 'gone') this.refuse('The server no longer has your picture. Choose it once more.');
        else this.ask('cut', { job });
      });
    }
  }

  const isOfGaussians = (file, limits) => limits.file_endings.some((ending) => (file.name || '').toLowerCase().endsWith(ending));

  /** Keep a picture in this tab over a reload, should the server have forgotten it by then. */
  async function keep({ example, file }) {
    try {
      sessionStorage.removeItem(KEPT);
      if (file?.size > LARGEST) return;
      const url = file && await new Promise((done) => { const reader = new FileReader(); reader.onload = () => done(reader.result); reader.readAsDataURL(file); });
      sessionStorage.setItem(KEPT, JSON.stringify({ example, url, name: file?.name, type: file?.type }));
    } catch { /* not kept, then */ }
  }

  function kept() {
    try {
      const { example, url, name, type } = JSON.parse(sessionStorage.getItem(KEPT));
      if (example) return { example };
      return { file: new File([Uint8Array.from(atob(url.split(',')[1]), (c) => c.charCodeAt(0))], name, { type }) };
    } catch { return null; }
  }

  /** A picture file no longer and larger than the server needs; one that this browser cannot read as it is. */
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

  /** Send a file: its path there, or why it was not taken, and whether the connection was lost. */
  async function sent(file, limits) {
    const form = new FormData();
    form.append('files', file, file.name || 'picture.png');
    let answer;
    try { answer = await fetch('gradio_api/upload', { method: 'POST', body: form }); }
    catch { return { message: 'The file could not be sent: the connection was lost.', lost: true }; }
    if (!answer.ok) return { message: answer.status === 413 ? limits.too_large : await answer.text() };
    server.look();
    return { path: (await answer.json())[0] };
  }

  Object.assign(globalThis.Phy124, { picture, reduced, sent });
})();
