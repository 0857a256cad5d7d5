/* Plays moving Gaussians. PlayCanvas (global `pc`) sorts and draws them. This file passes the Gaussians of the
 * current time to PlayCanvas, and adds the controls. The script pack.js may be loaded after this file.
 *
 *   const player = await Phy124Player.mount(element, bytes);
 *   player.seek(0.5); player.dispose();
 */
'use strict';
globalThis.Phy124Player = (() => {
  const SPEEDS = [0.1, 0.25, 0.5, 1, 2];
  const BACKGROUNDS = { light: [1, 1, 1], grey: [0.5, 0.5, 0.5], dark: [0.06, 0.07, 0.09] };
  const RAMP = [[0.27, 0, 0.33], [0.23, 0.32, 0.55], [0.13, 0.57, 0.55], [0.37, 0.79, 0.38],
    [0.99, 0.91, 0.14]]; // viridis
  const ICONS = {
    play: '<path d="M7 4.5v15l13-7.5z"/>',
    pause: '<path d="M6 4.5h4v15H6zM14 4.5h4v15h-4z"/>',
    full: '<path d="M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z"/>',
  };
  const icon = (name) =>
    `<svg viewBox="0 0 24 24" width="18" height="18" fill="currentColor" aria-hidden="true">${ICONS[name]}</svg>`;

  function ramp(fraction) {
    const x = Math.min(Math.max(fraction, 0), 1) * (RAMP.length - 1), k = Math.min(Math.floor(x), RAMP.length - 2);
    return RAMP[k].map((v, c) => v + (RAMP[k + 1][c] - v) * (x - k));
  }

  /* ---- the picture ------------------------------------------------------------------------- */

  const STREAMS = { centre: 'phyCentre', rotation: 'phyRotation', scale: 'phyScale', colour: 'phyColour' };
  const READ = `
    vec3 getCenter() { return loadPhyCentre().xyz; }
    vec4 getRotation() { return loadPhyRotation(); }
    vec3 getScale() { return loadPhyScale().xyz; }
    `;

  class Stage {
    constructor(canvas, pack, clear) {
      this.canvas = canvas;
      this.clear = clear;
      this.pack = pack;
      const { Growing, Film, Blend } = Phy124Pack;
      this.blend = new (pack.frames ? Growing : pack.load ? Film : Blend)(pack);
      const device = new pc.WebglGraphicsDevice(canvas, { antialias: false, alpha: clear, preserveDrawingBuffer: true });
      const app = this.app = new pc.AppBase(canvas);
      const options = new pc.AppOptions();
      options.graphicsDevice = device;
      options.componentSystems = [pc.CameraComponentSystem, pc.GSplatComponentSystem];
      app.init(options);
      app.setCanvasFillMode(pc.FILLMODE_NONE);
      app.setCanvasResolution(pc.RESOLUTION_FIXED, canvas.width, canvas.height);
      app.scene.gsplat.alphaClipForward = 1 / 255;
      app.scene.gsplat.minPixelSize = 0;
      app.scene.gsplat.minContribution = 0;
      app.autoRender = false;
      this.addSplats(device);
      this.around = pack.stage ? new Phy124Stage(app, device, this.entity, pack) : null;
      this.camera = new pc.Entity();
      this.camera.addComponent('camera', { fov: pack.view.fov, nearClip: 0.01, farClip: 1000,
        toneMapping: pc.TONEMAP_NONE, gammaCorrection: pc.GAMMA_SRGB });
      app.root.addChild(this.camera);
      app.start();
      // Pictures are drawn only on request, and again at the end of a sort.
      app.systems.gsplat.on('frame:request', () => this.wake());
      app.scene.on('gsplat:sorted', () => this.sortAgain());
      app.systems.gsplat.on('frame:ready', (camera, layer, ready) => { if (ready) this.copyAgain(); });
    }

    addSplats(device) {
      const streams = Object.values(STREAMS).map((name) => ({ name, format: pc.PIXELFORMAT_RGBA32F }));
      const read = READ + Phy124Shine.reads(this.pack.shine);
      const format = new pc.GSplatFormat(device, streams, { readGLSL: read, readWGSL: '' });
      this.laws = Phy124Shine.laws(this.pack);
      const box = this.container = new pc.GSplatContainer(device, this.pack.n, format);
      const { low, high } = this.pack;
      const half = low.map((v, c) => (high[c] - v) / 2 + 0.1);
      box.aabb = new pc.BoundingBox(
        new pc.Vec3(...low.map((v, c) => (v + high[c]) / 2)), new pc.Vec3(...half));
      const entity = this.entity = new pc.Entity();
      entity.setEulerAngles(-90, 0, 0); // z is up in phy124, y in PlayCanvas
      entity.addComponent('gsplat', { resource: box });
      this.app.root.addChild(entity);
    }

    wake() { this.app.renderNextFrame = true; }

    /** Sort again if the camera turned during a sort: PlayCanvas ignores such a turn unless the centres change, too. */
    sortAgain() {
      if (!this.turned) return;
      this.turned = false;
      this.container.update(this.pack.n, true);
      this.wake();
    }

    /** Copy a frame again at the end of a sort. If a frame is shown during a sort, PlayCanvas does not copy it to the
     * buffer that it draws, because the end of the sort clears the request. */
    copyAgain() {
      if (!this.changed) return;
      this.changed = false;
      this.entity.gsplat.workBufferUpdate = pc.WORKBUFFER_UPDATE_ONCE;
      // The end of the current picture clears all requests, so the next picture is requested afterwards.
      queueMicrotask(() => this.wake());
    }

    show(frame, colouring) {
      const n = this.pack.n, box = this.container, out = {};
      for (const key of ['centre', 'rotation', 'scale']) out[key] = box.getTexture(STREAMS[key]).lock();
      this.blend.at(frame, out);
      if (this.around) this.around.show(frame);
      for (let i = 0; i < n; i++) for (let c = 0; c < 3; c++) box.centers[i * 3 + c] = out.centre[i * 4 + c];
      for (let i = 0; i < n; i++) out.centre[i * 4 + 3] = colouring === 'photo' ? this.laws[i] : 0;
      this.paint(frame, colouring, out.scale);
      for (const key of ['centre', 'rotation', 'scale']) box.getTexture(STREAMS[key]).unlock();
      box.update(n, true);
      this.entity.gsplat.workBufferUpdate = pc.WORKBUFFER_UPDATE_ONCE;
      this.changed = true;
      this.wake();
    }

    paint(frame, colouring, scale) {
      const { n, stretch } = this.pack, texture = this.container.getTexture(STREAMS.colour);
      const out = texture.lock(), [least, most] = stretch, rgba = [0, 0, 0, 0];
      for (let i = 0; i < n; i++) {
        let rgb = null;
        if (colouring === 'velocity') rgb = ramp(this.blend.speed(frame, i));
        if (colouring === 'stretch') rgb = ramp((this.blend.stretch(scale, i) - least) / (most - least));
        this.blend.colour(frame, i, rgba);
        for (let c = 0; c < 3; c++) out[i * 4 + c] = rgb ? rgb[c] : rgba[c];
        out[i * 4 + 3] = rgba[3];
      }
      texture.unlock();
    }

    /** Set the background: a colour, null for the background of the clip's videos, or 'page' for only the shadows. */
    background(rgb) {
      const page = rgb === 'page';
      this.camera.camera.clearColor = page ? new pc.Color(0, 0, 0, 0) : new pc.Color(...(rgb || this.pack.background));
      if (this.around) this.around.behind(rgb && !page ? { top: rgb, bottom: rgb } : this.pack.stage, page);
      this.wake();
    }

    look(pose) {
      this.pose = pose;
      this.turned = true;
      const { azimuth, elevation, radius, target } = pose;
      const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
      const away = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
      const eye = away.map((v, c) => target[c] + radius * v);
      if (this.around) {
        const right = [-Math.sin(a), Math.cos(a), 0], ahead = away.map((v) => -v);
        const down = [ahead[1] * right[2] - ahead[2] * right[1], ahead[2] * right[0] - ahead[0] * right[2], ahead[0] * right[1] - ahead[1] * right[0]];
        const { width, height } = this.canvas, focal = height / 2 / Math.tan(this.pack.view.fov * Math.PI / 360);
        this.around.look(eye, [right, down, ahead], focal, [width, height]);
      }
      if (this.pack.shine) {
        this.entity.gsplat.setParameter('uSeenFrom', eye);
        this.entity.gsplat.workBufferUpdate = pc.WORKBUFFER_UPDATE_ONCE;
      }
      this.camera.setPosition(eye[0], eye[2], -eye[1]);
      this.camera.lookAt(target[0], target[2], -target[1]);
      this.wake();
    }

    resize(width, height) {
      if (this.canvas.width === width && this.canvas.height === height) return;
      this.app.setCanvasResolution(pc.RESOLUTION_FIXED, width, height);
      if (this.pose) this.look(this.pose);
      this.wake();
    }

    dispose() { this.app.destroy(); }
  }

  /* ---- the controls ------------------------------------------------------------------------ */

  const options = (values, chosen) => Object.entries(values)
    .map(([key, label]) => `<option value="${key}"${key === chosen ? ' selected' : ''}>${label}</option>`).join('');

  const MARKUP = `
    <canvas class="phy-canvas" tabindex="0" role="img" aria-label="Moving object in 3D.
      Drag or use the arrow keys to turn it, plus and minus to zoom, space to play."></canvas>
    <div class="phy-legend" hidden><span></span><i></i><span></span></div>
    <div class="phy-bar" role="group" aria-label="Player">
      <button type="button" class="phy-play" aria-label="Play">${icon('play')}</button>
      <span class="phy-when"><input class="phy-time" type="range" min="0" step="any" value="0" aria-label="Time"></span>
      <output class="phy-clock">0.00 s</output>
      <select class="phy-speed" aria-label="Speed">${options(
        Object.fromEntries(SPEEDS.map((s) => [String(s), `${s}×`])), '1')}</select>
      <details class="phy-more"><summary aria-label="View">…</summary><div><select class="phy-way" aria-label="At the end">${options(
        { loop: 'Loop', swing: 'Back and forth', once: 'Once' }, 'loop')}</select>
      <select class="phy-colour" aria-label="Colouring">${options(
        { photo: 'Own colours', velocity: 'Velocity', stretch: 'Stretch' }, 'photo')}</select>
      <select class="phy-background" aria-label="Background">${options(
        { filmed: 'As filmed', light: 'Light', grey: 'Grey', dark: 'Dark' }, 'filmed')}</select>
      <button type="button" class="phy-home">Reset the view</button></div></details>
      <button type="button" class="phy-full" aria-label="Full screen">${icon('full')}</button>
    </div>`;

  class Player {
    constructor(host, pack, { play = true, growing = false, clear = false } = {}) {
      if (growing) pack = Phy124Pack.Growing.begin(pack);
      this.pack = pack;
      this.host = host;
      host.classList.add('phy-player');
      host.innerHTML = MARKUP;
      this.find = (name) => host.querySelector(`.phy-${name}`);
      this.canvas = this.find('canvas');
      this.fit();
      this.stage = new Stage(this.canvas, pack, clear);
      this.time = 0;
      this.length = pack.times[pack.t - 1] - pack.times[0];
      // Clips of less than a second are too short to be seen at full speed.
      const short = this.length > 0 && this.length < 1;
      this.speed = short ? 0.5 : 1;
      this.way = short ? 'swing' : 'loop';
      this.forth = 1;
      this.find('speed').value = String(this.speed);
      this.find('way').value = this.way;
      this.followers = [];
      this.colouring = 'photo';
      this.home();
      if (clear) this.find('background').prepend(new Option('Of the page', 'page', true, true));
      this.stage.background(clear ? 'page' : null);
      this.find('time').max = this.length;
      this.hatch();
      this.listen();
      this.seek(0);
      if (pack.load) this.loadAll();
      this.still = matchMedia('(prefers-reduced-motion: reduce)').matches;
      if (play && !this.still && this.length > 0) this.play();
    }

    /** Hatch the part of the time slider in which the motion depends on the grid. */
    hatch() {
      const bar = this.find('when'), until = this.pack.until;
      bar.classList.toggle('phy-hatched', until !== undefined);
      if (until === undefined) return;
      bar.style.setProperty('--until', `${100 * (until - this.pack.times[0]) / this.length}%`);
      bar.title = `After ${until.toFixed(2)} s the motion differs from grid to grid: it is plausible, but not a prediction.`;
    }

    listen() {
      const on = (name, event, act) => this.find(name).addEventListener(event, act);
      on('play', 'click', () => (this.playing ? this.pause() : this.play()));
      on('time', 'input', (event) => { this.pause(); this.seek(Number(event.target.value)); });
      on('speed', 'change', (event) => { this.speed = Number(event.target.value); });
      on('way', 'change', (event) => { this.way = event.target.value; this.forth = 1; });
      on('colour', 'change', (event) => { this.colouring = event.target.value; this.legend(); this.seek(this.time); });
      on('background', 'change', ({ target }) => this.stage.background(target.value === 'page' ? 'page' : BACKGROUNDS[target.value] || null));
      on('home', 'click', () => this.home());
      on('full', 'click', () => (document.fullscreenElement ? document.exitFullscreen() : this.host.requestFullscreen()));
      on('canvas', 'keydown', (event) => this.key(event));
      on('canvas', 'wheel', (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * 0.001)); });
      this.listenPointers();
      this.watcher = new ResizeObserver(() => {
        if (!this.host.isConnected) return this.dispose();
        const { stance } = this;
        this.fit();
        this.stage.resize(...this.pixels);
        if (this.narrow !== this.narrowThen) this.stand(stance);
      });
      this.watcher.observe(this.canvas);
      // A browser may remove the graphics context, and later restores it without its content.
      this.stage.app.graphicsDevice.on('devicerestored', () => this.seek(this.time));
    }

    listenPointers() {
      const touches = new Map();
      let spread = 0;
      const gap = () => { const [a, b] = [...touches.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
      this.canvas.addEventListener('pointerdown', (event) => {
        this.canvas.setPointerCapture(event.pointerId);
        touches.set(event.pointerId, { x: event.clientX, y: event.clientY });
        if (touches.size === 2) spread = gap();
      });
      this.canvas.addEventListener('pointermove', (event) => {
        const last = touches.get(event.pointerId);
        if (!last) return;
        const dx = event.clientX - last.x, dy = event.clientY - last.y;
        touches.set(event.pointerId, { x: event.clientX, y: event.clientY });
        if (touches.size === 1) this.turn(-dx * 0.4, dy * 0.4);
        if (touches.size === 2) { this.zoom(spread / gap()); spread = gap(); }
      });
      for (const end of ['pointerup', 'pointercancel']) {
        this.canvas.addEventListener(end, (event) => touches.delete(event.pointerId));
      }
    }

    key(event) {
      const step = this.length / Math.max(this.pack.t - 1, 1);
      const act = {
        ArrowLeft: () => this.turn(-6, 0), ArrowRight: () => this.turn(6, 0),
        ArrowUp: () => this.turn(0, 6), ArrowDown: () => this.turn(0, -6),
        '+': () => this.zoom(0.9), '=': () => this.zoom(0.9), '-': () => this.zoom(1.1),
        ' ': () => (this.playing ? this.pause() : this.play()), Home: () => this.home(),
        ',': () => { this.pause(); this.seek(this.time - step); },
        '.': () => { this.pause(); this.seek(this.time + step); },
      }[event.key];
      if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      act();
    }

    get pixels() {
      const { clientWidth, clientHeight } = this.canvas;
      // While a clip is computed, fewer pixels are drawn, so that the computation is not slowed down.
      const most = this.pack?.frames ? Math.sqrt(4e5 / Math.max(clientWidth * clientHeight, 1)) : 2;
      const ratio = Math.min(window.devicePixelRatio || 1, 2, most);
      return [Math.max(2, Math.round(clientWidth * ratio)), Math.max(2, Math.round(clientHeight * ratio))];
    }

    fit() { if (!this.stage) [this.canvas.width, this.canvas.height] = this.pixels; }

    home() { this.take({ ...this.pack.view, radius: this.pack.view.radius * this.narrow }); }

    /** Factor on the camera's distance for pictures that are higher than wide, since the field of view is vertical. */
    get narrow() { const [width, height] = this.pixels; return Math.max(1, height / width); }

    /** The direction and zoom of the view, relative to the clip's first view. Another player can use them for a
     * clip whose object has another position and size. */
    get stance() {
      const { azimuth, elevation, radius } = this.pose;
      return { azimuth, elevation, zoom: radius / this.pack.view.radius / this.narrowThen };
    }

    /** Use the direction and zoom of another player (`stance`). */
    stand({ azimuth, elevation, zoom }) { this.take({ azimuth, elevation, radius: this.pack.view.radius * zoom * this.narrow }); }

    /** Set the camera's pose, for example to that of another player. */
    take(pose) {
      this.pose = { ...this.pack.view, ...pose };
      this.narrowThen = this.narrow;
      this.stage.look(this.pose);
      for (const other of this.followers || []) other.take({ azimuth: pose.azimuth, elevation: pose.elevation });
    }

    /** Let another player show the same time from the same side. */
    lead(other) {
      this.followers = other ? [other] : [];
      if (!other) return;
      other.pause();
      other.find('bar').hidden = true;
      this.take(this.pose);
      this.seek(this.time);
    }

    /** Add a frame to a clip that is still being computed. */
    async extend(bytes) {
      const frame = await Phy124Pack.unpack(bytes);
      if (this.gone) return;
      Phy124Pack.Growing.add(this.pack, frame);
      this.length = this.pack.times[this.pack.t - 1] - this.pack.times[0];
      this.find('time').max = this.length;
      this.hatch();
      if (this.still) this.seek(this.length);
      else if (!this.playing) this.play();
    }

    turn(azimuth, elevation) {
      const up = Math.min(89, Math.max(-89, this.pose.elevation + elevation));
      this.take({ ...this.pose, azimuth: this.pose.azimuth + azimuth, elevation: up });
    }

    zoom(factor) {
      const { radius } = this.pack.view;
      this.pose.radius = Math.min(6 * radius, Math.max(0.15 * radius, this.pose.radius * factor));
      this.stage.look(this.pose);
    }

    /** Read all frames of a .p4d file, one after the other, before they are played. */
    async loadAll() {
      for (let k = 0; k < this.pack.t && !this.gone; k++) {
        try { await this.pack.load(k); } catch { /* the frame is read again when it is shown */ }
      }
    }

    /** Return whether a frame and the next one have been read. If not, read them (repeatedly if necessary), then show them. */
    ready(frame) {
      const { load, loaded, t } = this.pack, missing = load ? [Math.floor(frame), Math.min(Math.ceil(frame), t - 1)].filter((k) => loaded[k] !== true) : [];
      if (!missing.length) return true;
      this.waiting ??= Promise.all(missing.map(load)).catch(() => new Promise((wait) => { setTimeout(wait, 1000); }))
        .then(() => { this.waiting = null; if (!this.gone) this.seek(this.time); });
      return false;
    }

    /** Show the frame at `time`, in seconds from the start. */
    seek(time) {
      this.time = Math.min(Math.max(time, 0), this.length);
      const { times, t } = this.pack, now = times[0] + this.time;
      let k = 0;
      while (k < t - 2 && times[k + 1] <= now) k++;
      const frame = t > 1 ? k + (now - times[k]) / (times[k + 1] - times[k]) : 0;
      if (this.ready(frame)) this.stage.show(frame, this.colouring);
      this.find('time').value = this.time;
      this.find('clock').textContent = `${this.time.toFixed(2)} s`;
      for (const other of this.followers) other.seek(time);
    }

    play() {
      this.playing = true;
      this.button('pause', 'Pause');
      if (this.time >= this.length) this.time = 0;
      let last = performance.now();
      const tick = (now) => {
        if (!this.playing) return;
        if (!this.host.isConnected) return this.dispose();
        const next = this.time + Math.min((now - last) / 1000, 0.25) * this.speed * this.forth;
        last = now;
        if (!this.waiting) this.seek(this.turned(next));
        requestAnimationFrame(tick);
      };
      requestAnimationFrame(tick);
    }

    /** Return the time at which playback continues if `time` is before the start or after the end. */
    turned(time) {
      if (time >= 0 && time <= this.length) return time;
      if (this.way === 'swing') { this.forth = -this.forth; return time < 0 ? 0 : this.length; }
      if (this.way === 'once') { this.pause(); return this.length; }
      return 0;
    }

    pause() { this.playing = false; this.button('play', 'Play'); }

    button(name, label) {
      this.find('play').innerHTML = icon(name);
      this.find('play').setAttribute('aria-label', label);
    }

    legend() {
      const box = this.find('legend'), [low, high] = box.querySelectorAll('span');
      box.hidden = this.colouring === 'photo';
      const { speed, stretch } = this.pack;
      [low.textContent, high.textContent] = this.colouring === 'velocity'
        ? ['0', `${speed.toPrecision(2)} m/s`]
        : [`${stretch[0].toFixed(2)}×`, `${stretch[1].toFixed(2)}×`];
    }

    dispose() {
      if (this.gone) return;
      this.gone = true;
      this.playing = false;
      this.watcher.disconnect();
      this.stage.dispose();
    }
  }

  /** Show a pack or a .p4d file given as bytes, or a .p4d file at an address, from which frames are read by range. */
  async function mount(host, source, settings) {
    if (!document.createElement('canvas').getContext('webgl2')) {
      host.textContent = 'This browser has no WebGL 2, which the 3D player needs. The videos show the same motion.';
      return null;
    }
    const moving = typeof source === 'string' || String.fromCharCode(...source.slice(0, 5)) === 'PHY4D';
    const slice = (offset, length) => source.slice(offset, offset + length);
    const open = () => (typeof source === 'string' ? P4D.fetch(source) : P4D.open(slice));
    const pack = await (moving ? open().then(Phy124Pack.film) : Phy124Pack.unpack(source));
    return new Player(host, pack, settings);
  }

  return { mount };
})();
