/* A dialog with a brush over the picture: green keeps, red removes. Strokes are lines in fractions of the picture's
 * longer side. The server paints the strokes. On the keyboard, arrows move the brush, space holds it down, P picks the
 * object under it. */
'use strict';
(() => {
  const { h } = globalThis.Phy124;
  const COLOURS = { keep: '#16a34a', remove: '#dc2626' };

  class Brush {
    constructor(apply, pick) {
      Object.assign(this, { pick, strokes: [], keep: true, width: 0.05, spot: [0.5, 0.5], stroke: null });
      this.canvas = h('canvas', { class: 'brush-canvas', tabindex: 0, role: 'application', 'aria-label':
        'Brush over the picture. Arrow keys move the brush, space begins and ends a stroke, K keeps, R removes, P picks the object under the brush.' });
      const tool = (name, keep) => h('label', {}, h('input', { type: 'radio', name: 'brush-tool', checked: keep === this.keep, onchange: () => { this.keep = keep; } }), h('span', {}, name));
      const size = h('input', { type: 'range', min: 0.01, max: 0.15, step: 0.005, value: this.width, 'aria-label': 'Width of the brush', oninput: () => { this.width = Number(size.value); this.draw(); } });
      const button = (label, act, kind = 'quiet') => h('button', { type: 'button', class: kind, onclick: act }, label);
      this.opener = h('button', { type: 'button', class: 'wide', id: 'correct', hidden: true, onclick: () => { this.element.showModal(); this.draw(); } });
      this.element = h('dialog', { class: 'brush', id: 'brush', 'aria-label': 'Correct the cut-out' }, this.title = h('h2', {}), h('p', {}, 'Paint green what belongs to the object, red what does not.'),
        h('div', { class: 'brush-tools' }, h('div', { class: 'segments', role: 'radiogroup', 'aria-label': 'Brush' }, tool('Keep', true), tool('Remove', false)), size),
        this.canvas, h('div', { class: 'brush-tools' }, button('Undo', () => { this.strokes.pop(); this.draw(); }), button('Clear', () => { this.strokes = []; this.draw(); }),
          button('Close', () => this.element.close()), button('Apply the strokes', () => { if (this.strokes.length) apply(this.strokes); this.element.close(); }, 'filled')));
      this.listen();
    }

    /** Show a picture and its cut-out; remove the strokes if the picture is new and not only sent again. */
    load(photo, cut, again = false) {
      this.opener.hidden = !photo;
      if (!photo) this.element.close();
      this.title.textContent = this.opener.textContent = cut ? 'Correct the cut-out' : 'Mark the object';
      if (photo !== this.photo && !again) this.strokes = [];
      if (photo === this.photo && cut === this.cut) return;
      Object.assign(this, { photo, cut });
      const image = (url) => new Promise((done) => { if (!url) return done(null); const img = new Image(); img.onload = () => done(img); img.onerror = () => done(null); img.src = url; });
      Promise.all([image(photo), image(cut)]).then(([below, above]) => { Object.assign(this, { below, above }); this.draw(); });
    }

    get sides() { const { width, height } = this.canvas, side = Math.max(width, height); return [width / side, height / side, side]; }

    listen() {
      const at = (event) => {
        const box = this.canvas.getBoundingClientRect(), side = Math.max(box.width, box.height);
        return [(event.clientX - box.left) / side, (event.clientY - box.top) / side];
      };
      this.canvas.addEventListener('pointerdown', (event) => { this.canvas.setPointerCapture(event.pointerId); this.spot = at(event); this.begin(); });
      this.canvas.addEventListener('pointermove', (event) => { if (this.stroke) { this.spot = at(event); this.go(); } });
      for (const end of ['pointerup', 'pointercancel']) this.canvas.addEventListener(end, () => { this.stroke = null; });
      this.canvas.addEventListener('keydown', (event) => this.key(event));
      for (const name of ['focus', 'blur']) this.canvas.addEventListener(name, () => this.draw());
    }

    key(event) {
      const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
      if (move) {
        const [w, hgt] = this.sides, clamp = (v, most) => Math.min(most, Math.max(0, v));
        this.spot = [clamp(this.spot[0] + move[0] * 0.02, w), clamp(this.spot[1] + move[1] * 0.02, hgt)];
        this.go();
      } else if (/^p$/i.test(event.key)) {
        const [w, hgt] = this.sides;
        this.pick([this.spot[0] / w, this.spot[1] / hgt]);
        this.element.close();
      } else if (event.key === ' ') { if (this.stroke) this.stroke = null; else this.begin(); } else if (/^[kr]$/i.test(event.key)) {
        this.keep = event.key.toLowerCase() === 'k';
        this.element.querySelectorAll('input[type=radio]').forEach((radio, i) => { radio.checked = (i === 0) === this.keep; });
      } else return;
      event.preventDefault();
      this.draw();
    }

    begin() { this.stroke = { keep: this.keep, width: this.width, points: [] }; this.strokes.push(this.stroke); this.go(); }

    go() {
      if (this.stroke && this.stroke.points.length < 2000) this.stroke.points.push(this.spot.map((v) => Math.round(v * 1e4) / 1e4));
      this.draw();
    }

    draw() {
      const { canvas, below, above } = this;
      if (!below || !this.element.open) return;
      const scale = Math.min(1, 720 / Math.max(below.naturalWidth, below.naturalHeight));
      const [width, height] = [Math.round(below.naturalWidth * scale), Math.round(below.naturalHeight * scale)];
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
      const context = canvas.getContext('2d');
      context.globalAlpha = 1;
      context.fillStyle = '#fff';
      context.fillRect(0, 0, width, height);
      context.globalAlpha = above ? 0.3 : 1; // removed parts of the picture are pale
      context.drawImage(below, 0, 0, width, height);
      context.globalAlpha = 1;
      if (above) context.drawImage(above, 0, 0, width, height);
      for (const stroke of this.strokes) this.paint(context, stroke, Math.max(width, height));
      if (document.activeElement === canvas) this.paint(context, { keep: this.keep, width: this.width, points: [this.spot] }, Math.max(width, height));
    }

    paint(context, { keep, width, points }, side) {
      Object.assign(context, { globalAlpha: 0.6, lineCap: 'round', lineJoin: 'round', lineWidth: width * side, strokeStyle: keep ? COLOURS.keep : COLOURS.remove });
      context.beginPath();
      points.forEach(([x, y], i) => context[i ? 'lineTo' : 'moveTo'](x * side, y * side));
      if (points.length === 1) context.lineTo(points[0][0] * side + 0.1, points[0][1] * side);
      context.stroke();
      context.globalAlpha = 1;
    }
  }

  Object.assign(globalThis.Phy124, { Brush });
})();
