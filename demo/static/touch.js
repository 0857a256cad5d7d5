/* Touch: a live run that the visitor pushes, over a socket (demo/touch).
 *
 * Pressing on the object and dragging pulls it. Dragging next to the object turns the view. Each frame is
 * acknowledged once it is drawn, so a slow browser skips frames. While something moves, the browser draws only
 * as many pixels, and as many (enlarged) Gaussians, as it can draw in time. An object at rest is drawn once, with
 * all Gaussians, and is not drawn again until it moves.
 */
'use strict';
(() => {
  const { h, mark, announce } = globalThis.Phy124;
  const FEWEST = 1500, COARSE = 0.5, SLOW = 36, FAST = 14, NEAR = 28, STEP = 0.06, CALM = 6, OFTEN = 16;
  const GRAVITIES = { Earth: 9.81, Mars: 3.71, Moon: 1.62, None: 0 };
  const KEYS = { ArrowLeft: ['right', -1], ArrowRight: ['right', 1], ArrowUp: ['up', 1], ArrowDown: ['up', -1], PageUp: ['ahead', 1], PageDown: ['ahead', -1] };

  function touch(element, props, watch, trigger) {
    let hand = null;
    const show = () => {
      const { ticket, refused, message = refused } = props.value || {};
      if (refused && hand && !hand.gone) { hand.resume(refused); return; }
      hand?.leave();
      hand = null;
      element.replaceChildren();
      if (message) element.replaceChildren(h('p', { class: 'message', role: 'alert' }, message));
      if (ticket) hand = element.hand = new Hand(element, ticket, trigger);
    };
    watch('value', show);
    show();
    document.addEventListener('phy124-asked', () => element.querySelector(':scope > .message')?.remove());
  }

  class Hand {
    constructor(element, ticket, trigger) {
      Object.assign(this, { element, trigger, seq: 0, sent: new Map(), delays: [], bytes: 0, frames: 0, pictures: 0, calm: 0, keyed: null, held: null, touches: new Map() });
      this.build();
      const address = new URL(`phy124/touch/${ticket}`, document.baseURI);
      address.protocol = address.protocol.replace('http', 'ws');
      this.socket = new WebSocket(address);
      this.socket.binaryType = 'arraybuffer';
      this.socket.onmessage = ({ data }) => this.take(data);
      this.socket.onclose = () => this.ended('The connection to the live run was lost.');
    }

    /* ---- the picture ----------------------------------------------------------------------- */

    build() {
      const button = (label, act) => h('button', { type: 'button', class: 'quiet', onclick: act }, label);
      this.canvas = h('canvas', { tabindex: 0, role: 'application', 'aria-label': 'The object. Drag it to hold and throw it. By keyboard, Enter grabs the top of the object, and arrow keys, Page Up and Page Down move it; Enter lets go. Arrow keys with Shift turn the view.' });
      const cut = document.querySelector('#cutout img')?.getAttribute('src') || document.querySelector('#photo img')?.getAttribute('src');
      this.status = h('p', { class: 'touch-status', role: 'status' }, 'Starting …');
      this.grid = h('small', { class: 'touch-grid' });
      this.rate = h('p', { class: 'touch-rate' });
      const gravity = h('select', { 'aria-label': 'Gravity', onchange: () => this.say({ do: 'gravity', value: GRAVITIES[gravity.value] }) },
        ...Object.keys(GRAVITIES).map((name) => h('option', { value: name }, name)));
      this.soft = h('input', { type: 'range', min: -1, max: 1, step: 0.05, value: 0, 'aria-label': 'Softness' });
      this.soft.addEventListener('input', () => this.say({ do: 'soften', value: 10 ** -Number(this.soft.value) }));
      this.gravity = gravity;
      this.saving = button('Save as clip', () => this.say({ do: 'save' }));
      this.tools = h('fieldset', { class: 'touch-tools', disabled: true }, button('Reset', () => this.reset()),
        h('label', {}, 'Gravity', gravity), h('label', { class: 'touch-soft' }, 'Stiffer', this.soft, 'Softer'),
        this.saving);
      this.ending = button('End', () => this.leave());
      this.box = h('section', { class: 'touch', 'aria-label': 'Touch' }, h('div', { class: 'touch-view' }, this.canvas, cut ? h('img', { class: 'hero', src: cut, alt: '' }) : null, this.rate), h('div', { class: 'touch-foot' }, this.status, this.tools, this.ending, this.grid));
      this.element.replaceChildren(this.box);
      this.listen();
      mark({ touching: true });
    }

    begin(buffer) {
      const lattice = this.lattice = new Phy124Lattice(buffer, 1);
      this.ground = lattice.ground ?? 0;
      this.count = lattice.splats;
      this.sharp = 1;
      this.home = { azimuth: 25, elevation: 14, radius: 3 * lattice.size, target: [0, 0, this.ground + 0.55 * lattice.size] };
      this.pose = { ...this.home };
      this.prepare();
      this.status.textContent = 'Drag the object. Drag next to it to turn the view.';
      this.grid.textContent = lattice.sentence;
      this.soft.parentElement.hidden = !lattice.softens;
      this.tools.disabled = false;
      this.canvas.classList.add('ready');
    }

    prepare() {
      this.splats = new Phy124Splats(this.canvas, this.lattice);
      this.splats.look(this.pose);
    }

    /** Handle the loss of the WebGL context, which the browser restores without its content. */
    restore() {
      this.prepare();
      this.drawing = null;
      this.again();
    }

    /** Handle a message of the socket: show text to the visitor; in binary data, the first byte is a letter for the kind. */
    take(data) {
      if (typeof data === 'string') return this.told(JSON.parse(data));
      this.bytes += data.byteLength;
      const letter = String.fromCharCode(new Uint8Array(data, 0, 1)[0]);
      if (letter === 'b') return this.begin(data);
      this.frame = data;
      this.got = (this.got ?? 0) + 1;
      if (!this.drawing) this.drawing = requestAnimationFrame(() => this.show());
    }

    told({ kind, text }) {
      if (kind === 'ended') return this.ended(text);
      this.status.textContent = text;
      announce(text);
      // The server stores the session while the run lasts, and ends the run when the session is saved.
      if (kind === 'saved') { this.saved = true; this.trigger('save'); }
    }

    /** Continue the run, which pauses while it is saved, and show the reason why it was not saved. */
    resume(text) {
      this.say({ do: 'pause', value: false });
      this.status.textContent = text;
      announce(text);
    }

    show() {
      this.drawing = null;
      if (this.gone || !this.splats || this.splats.gl.isContextLost()) return;
      const begun = performance.now();
      if (this.frame) {
        this.head = this.lattice.take(this.frame, 1);
        this.frame = null;
        this.news = this.got;
        this.tellRate();
      }
      const rests = this.rests();
      if (rests && this.fine && this.lattice.strayed < this.pixel) return this.acknowledge(begun);
      this.fine = rests;
      this.turned = false;
      const count = rests ? this.lattice.splats : this.count;
      this.fit(rests ? 1 : this.sharp);
      this.lattice.ride(count);
      this.lattice.shown();
      this.splats.draw(count);
      const { gl } = this.splats, fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
      gl.flush();
      this.drawing = -1;
      this.drawn(fence, begun);
    }

    tellRate() {
      const rate = this.head.factor < 0.95 ? `${this.head.factor.toFixed(1)}× real time` : '';
      // Setting the same text again would make the browser lay out the page again.
      if (rate !== this.rate.textContent) this.rate.textContent = rate;
    }

    /** Return the size of half a pixel of the screen at the distance of the object [m]. */
    get pixel() { return 0.5 * this.pose.radius / this.splats.focal * this.canvas.width / this.canvas.clientWidth; }

    /** Return whether no visible motion has occurred for a while. */
    rests() {
      const still = this.head && !this.held && !this.turned && this.lattice.stirred < 0.2 * this.pixel;
      this.calm = still ? this.calm + 1 : 0;
      return this.calm > CALM;
    }

    /** Wait until the picture is drawn, then request the next frame. */
    drawn(fence, begun) {
      const { gl } = this.splats, now = performance.now();
      if (this.gone || gl.isContextLost()) return;
      if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && now - begun < 2000) { setTimeout(() => this.drawn(fence, begun), 3); return; }
      gl.deleteSync(fence);
      this.drawing = null;
      this.pictures++;
      if (!this.fine) this.adapt(now - begun);
      this.acknowledge(now);
      if (this.frame) this.drawing = requestAnimationFrame(() => this.show());
    }

    /** Acknowledge the newest frame, which is now drawn; earlier frames may have been skipped. */
    acknowledge(now) {
      if (!this.news) return;
      this.frames++;
      for (const [seq, at] of this.sent) if (seq <= this.head.heard) { this.delays.push(now - at); this.sent.delete(seq); }
      if (this.delays.length > 5000) this.delays.splice(0, 1000);
      this.send({ do: 'seen', value: this.news });
      this.news = 0;
    }

    /** Draw fewer pixels, then fewer Gaussians, while pictures take too long. */
    adapt(ms) {
      this.slow = 0.8 * (this.slow ?? ms) + 0.2 * ms;
      const most = this.lattice.splats, least = Math.min(FEWEST, most);
      if (this.slow > SLOW && this.sharp > COARSE) this.sharp = Math.max(COARSE, 0.9 * this.sharp);
      else if (this.slow > SLOW) this.count = Math.max(least, Math.round(0.85 * this.count));
      else if (this.slow < FAST && this.count < most) this.count = Math.min(most, Math.round(1.1 * this.count));
      else if (this.slow < FAST) this.sharp = Math.min(1, 1.1 * this.sharp);
    }

    fit(sharp) {
      const ratio = Math.min(window.devicePixelRatio || 1, 2) * sharp, { clientWidth, clientHeight } = this.canvas;
      const [width, height] = [clientWidth, clientHeight].map((side) => Math.max(2, Math.round(side * ratio)));
      if (Math.abs(this.canvas.width - width) > 0.04 * width || Math.abs(this.canvas.height - height) > 0.04 * height) Object.assign(this.canvas, { width, height });
    }

    again() { this.turned = true; if (!this.drawing) this.drawing = requestAnimationFrame(() => this.show()); }

    /* ---- messages ---------------------------------------------------------------------- */

    send(message) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message)); }

    /** Send a message; `at` is the time of the hand's action [ms], which may precede the event in the page. */
    say(message, at = performance.now()) {
      if (!this.splats) return;
      this.saved = false;
      this.seq++;
      this.sent.set(this.seq, at);
      if (this.sent.size > 500) this.sent.clear();
      this.send({ ...message, seq: this.seq });
    }

    reset() {
      this.letGo();
      this.soft.value = 0;
      this.gravity.value = 'Earth';
      if (this.home) { this.pose = { ...this.home }; this.splats.look(this.pose); }
      this.say({ do: 'reset' });
    }

    /* ---- the hand -------------------------------------------------------------------------- */

    /** Return a pointer's position relative to the middle of the picture, in pixels, with the y axis up. */
    pointed(event) {
      const box = this.canvas.getBoundingClientRect(), scale = this.canvas.width / box.width;
      return [(event.clientX - box.left - box.width / 2) * scale, (box.height / 2 - event.clientY + box.top) * scale];
    }

    /** Return the position of the foremost Gaussian at or near a pointer; null if the pointer is not on the object. */
    under([px, py]) {
      const { splats, lattice, count } = this, { focal } = splats, reach = NEAR * this.canvas.width / this.canvas.clientWidth;
      const { shapes } = lattice, grown = splats.grown(count);
      let best = null, least = Infinity, hit = null, first = Infinity;
      for (let i = 0; i < count; i++) {
        if (lattice.colours[4 * i + 3] < 60) continue;
        const [x, y, z] = [lattice.centres[3 * i], lattice.centres[3 * i + 1], lattice.centres[3 * i + 2]], [r, u, a] = splats.seen(x, y, z);
        if (a <= 0) continue;
        const off = Math.hypot(focal * r / a - px, focal * u / a - py);
        const wide = focal / a * Math.sqrt(grown * (shapes[6 * i] + shapes[6 * i + 3] + shapes[6 * i + 5]) / 3);
        if (off < wide && a < first) { first = a; hit = [x, y, z]; }
        // The distances from the eye and from the pointer are both considered.
        const cost = a / lattice.size + (off / reach) ** 2;
        if (off < reach && cost < least) { least = cost; best = [x, y, z]; }
      }
      return hit ?? best;
    }

    /** Return the position under a pointer at a given distance ahead of the eye. */
    ahead([px, py], far) {
      const { eye, right, up, ahead, focal } = this.splats;
      return eye.map((e, c) => e + far * (ahead[c] + (px * right[c] + py * up[c]) / focal));
    }

    hold(place, id) {
      this.held = { id, far: this.splats.seen(...place)[2], place };
      this.canvas.classList.add('holds');
      this.say({ do: 'grab', value: place });
    }

    letGo() {
      if (!this.held) return;
      this.held = null;
      this.canvas.classList.remove('holds');
      this.say({ do: 'release' });
    }

    listen() {
      const on = (name, act) => this.canvas.addEventListener(name, act);
      // Without this call, the browser would not restore the WebGL context.
      on('webglcontextlost', (event) => event.preventDefault());
      on('webglcontextrestored', () => this.restore());
      on('pointerdown', (event) => this.press(event));
      on('pointermove', (event) => this.drag(event));
      // Browsers delay the other pointer events until they draw.
      on('pointerrawupdate', (event) => { if (this.held?.id === event.pointerId && event.timeStamp > (this.led ?? 0) + OFTEN) this.drag(event); });
      for (const end of ['pointerup', 'pointercancel']) on(end, (event) => this.lift(event));
      on('wheel', (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY * 0.001)); });
      on('keydown', (event) => this.key(event));
      on('blur', () => { if (this.held?.id === 'keys') this.letGo(); });
      this.watcher = new ResizeObserver(() => { if (!this.element.isConnected) this.leave(); else this.again(); });
      this.watcher.observe(this.canvas);
    }

    press(event) {
      if (!this.splats) return;
      this.canvas.setPointerCapture(event.pointerId);
      this.touches.set(event.pointerId, [event.clientX, event.clientY]);
      if (this.touches.size > 1) { this.spread = this.gap(); this.letGo(); return; }
      const place = this.under(this.pointed(event));
      if (place) { event.preventDefault(); this.canvas.focus({ preventScroll: true }); this.hold(place, event.pointerId); }
    }

    drag(event) {
      const last = this.touches.get(event.pointerId);
      if (!last) return;
      this.touches.set(event.pointerId, [event.clientX, event.clientY]);
      if (this.held?.id === event.pointerId) { this.lead(event); return; }
      if (this.touches.size === 2) { const gap = this.gap(); this.zoom(this.spread / gap); this.spread = gap; return; }
      this.turn((last[0] - event.clientX) * 0.4, (event.clientY - last[1]) * 0.4);
    }

    /** Send the target of the held object for each position of a pointer. */
    lead(event) {
      if (event.timeStamp === this.led) return;
      this.held.place = this.ahead(this.pointed(event), this.held.far);
      this.led = event.timeStamp;
      this.say({ do: 'to', value: this.held.place }, event.timeStamp);
    }

    lift(event) {
      this.touches.delete(event.pointerId);
      if (this.held?.id === event.pointerId) this.letGo();
    }

    gap() { const [a, b] = [...this.touches.values()]; return Math.max(1, Math.hypot(a[0] - b[0], a[1] - b[1])); }

    turn(azimuth, elevation) {
      this.pose.azimuth += azimuth;
      this.pose.elevation = Math.min(85, Math.max(2, this.pose.elevation + elevation));
      this.splats.look(this.pose);
      this.again();
    }

    zoom(factor) {
      if (!this.splats) return;
      this.pose.radius = Math.min(5 * this.home.radius, Math.max(0.3 * this.home.radius, this.pose.radius * factor));
      this.splats.look(this.pose);
      this.again();
    }

    key(event) {
      if (!this.splats || event.ctrlKey || event.metaKey || event.altKey) return;
      const move = KEYS[event.key];
      if (event.key === 'Enter' || event.key === ' ') {
        event.preventDefault();
        if (this.held) this.letGo(); else this.hold(this.top(), 'keys');
      } else if (event.key === '+' || event.key === '-') { this.zoom(event.key === '+' ? 0.9 : 1.1); } else if (move) {
        event.preventDefault();
        const [way, sign] = move;
        if (event.shiftKey || !this.held) { this.turn(way === 'right' ? 6 * sign : 0, way === 'up' ? 6 * sign : 0); return; }
        const axis = this.splats[way], step = sign * STEP * this.lattice.size;
        this.held.place = this.held.place.map((v, c) => v + step * axis[c]);
        this.say({ do: 'to', value: this.held.place });
      }
    }

    /** Return the highest of the Gaussians that are drawn. */
    top() {
      const { centres } = this.lattice;
      let best = 0;
      for (let i = 1; i < this.count; i++) if (centres[3 * i + 2] > centres[3 * best + 2]) best = i;
      return [centres[3 * best], centres[3 * best + 1], centres[3 * best + 2]];
    }

    /* ---- the end --------------------------------------------------------------------------- */

    ended(text) {
      if (this.gone) return;
      if (this.saved) return this.leave();
      this.close();
      this.status.textContent = text;
      this.tools.disabled = false;
      this.tools.replaceChildren(h('button', { type: 'button', class: 'filled', onclick: () => this.trigger('begin') }, 'Start again'));
      announce(text);
    }

    leave() {
      this.close();
      this.box.remove();
      mark({ touching: false });
    }

    close() {
      if (this.gone) return;
      this.gone = true;
      this.watcher.disconnect();
      this.socket.onclose = null;
      this.socket.close();
      this.splats?.dispose();
    }
  }

  globalThis.Phy124 = Object.assign(globalThis.Phy124 || {}, { touch });
})();
