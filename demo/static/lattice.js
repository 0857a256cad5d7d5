/* The lattice of a live run: each frame brings new nodes, and the Gaussians bound to the nodes follow.
 * demo/touch/lattice.py defines the format of the binding, of the nodes and of the walls.
 *
 *   const lattice = new Phy124Lattice(binding); lattice.take(frame); lattice.ride(1000);
 */
'use strict';
globalThis.Phy124Lattice = (() => {
  const CARRIERS = 8, REACH = 8, HEAD = 16;

  function apart(a, b) {
    let most = 0;
    for (let i = 0; i < a.length; i++) most = Math.max(most, Math.abs(a[i] - b[i]));
    return most;
  }

  return class Lattice {
    constructor(buffer, at) {
      const length = new DataView(buffer).getUint32(at, true);
      Object.assign(this, JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, at + 4, length))));
      const n = this.splats, bytes = buffer.slice(at + 4 + length);
      let here = 0;
      const take = (Kind, count) => { const part = new Kind(bytes, here, count); here += part.byteLength; return part; };
      this.means = take(Float32Array, 3 * n);
      this.sigma = take(Float32Array, 6 * n);
      this.stretch = take(Float32Array, n);
      this.rest = take(Float32Array, 3 * this.nodes);
      this.near = take(Uint16Array, CARRIERS * n);
      const weights = take(Uint8Array, CARRIERS * n);
      this.colours = take(Uint8Array, 4 * n);
      this.weights = Float32Array.from(weights, (w) => w / 255);
      for (let i = 0; i < n; i++) this.normalise(i);
      /** For each node: F, and the position to which the node's affine map moves the origin. */
      this.moves = new Float32Array(12 * this.nodes);
      this.centres = new Float32Array(this.means);
      this.shapes = new Float32Array(this.sigma);
      this.moved = new Float32Array(3 * this.walls.length).fill(NaN);
      /** Positions of the nodes in this frame, in the previous frame, and when they were last drawn. */
      [this.places, this.before, this.drawn] = [0, 1, 2].map(() => new Float32Array(3 * this.nodes).fill(Infinity));
      this.box = [[0, 0, 0], [0, 0, 0]];
    }

    normalise(i) {
      let sum = 0;
      for (let k = CARRIERS * i; k < CARRIERS * (i + 1); k++) sum += this.weights[k];
      if (sum) for (let k = CARRIERS * i; k < CARRIERS * (i + 1); k++) this.weights[k] /= sum;
    }

    /** Read a frame: store its nodes, and return its numbers. */
    take(buffer, at) {
      const view = new DataView(buffer, at), p = this.nodes, { moves, rest } = this;
      const head = { index: view.getUint32(0, true), heard: view.getUint32(4, true), time: view.getFloat32(8, true), factor: view.getFloat32(12, true) };
      const own = buffer.slice(at + HEAD), box = new Float32Array(own, 0, 6);
      const places = new Uint16Array(own, 24, 3 * p), turned = new Int16Array(own, 24 + 6 * p, 9 * p);
      const around = new Float32Array(own, 24 * (p + 1));
      this.box = [[...box.subarray(0, 3)], [...box.subarray(3)]];
      this.ground = Number.isNaN(around[0]) ? null : around[0];
      /** Displacement of each wall; NaN if the wall is absent. */
      const walls = around.subarray(1), stands = walls.every((v, i) => Object.is(v, this.moved[i]));
      this.moved = walls;
      [this.places, this.before] = [this.before, this.places];
      const step = [0, 1, 2].map((c) => (box[3 + c] - box[c]) / 65535);
      for (let i = 0; i < p; i++) {
        const m = 12 * i, r = 3 * i;
        for (let k = 0; k < 9; k++) moves[m + k] = turned[9 * i + k] * REACH / 32767;
        for (let c = 0; c < 3; c++) {
          const f = m + 3 * c, x = this.places[r + c] = box[c] + step[c] * places[r + c];
          moves[m + 9 + c] = x - moves[f] * rest[r] - moves[f + 1] * rest[r + 1] - moves[f + 2] * rest[r + 2];
        }
      }
      /** Largest displacement of a node since the previous frame, and since the last picture was drawn [m]. */
      this.stirred = stands ? apart(this.places, this.before) : Infinity;
      this.strayed = stands ? apart(this.places, this.drawn) : Infinity;
      return head;
    }

    /** Record that a picture of this frame is drawn. */
    shown() { this.drawn.set(this.places); }

    /** Compute positions and covariances of the first `count` Gaussians: x = sum w (F X + b), F Sigma F^T. */
    ride(count) {
      const { means, sigma, near, weights, moves, centres, shapes, stretch } = this;
      for (let i = 0; i < count; i++) {
        let a = 0, b = 0, c = 0, d = 0, e = 0, f = 0, g = 0, h = 0, j = 0, x = 0, y = 0, z = 0;
        for (let k = CARRIERS * i; k < CARRIERS * (i + 1); k++) {
          const w = weights[k], m = 12 * near[k];
          if (w === 0) continue;
          a += w * moves[m]; b += w * moves[m + 1]; c += w * moves[m + 2];
          d += w * moves[m + 3]; e += w * moves[m + 4]; f += w * moves[m + 5];
          g += w * moves[m + 6]; h += w * moves[m + 7]; j += w * moves[m + 8];
          x += w * moves[m + 9]; y += w * moves[m + 10]; z += w * moves[m + 11];
        }
        const o = 3 * i, s = 6 * i;
        if (weights[CARRIERS * i] === 0) continue;
        const X = means[o], Y = means[o + 1], Z = means[o + 2];
        centres[o] = a * X + b * Y + c * Z + x;
        centres[o + 1] = d * X + e * Y + f * Z + y;
        centres[o + 2] = g * X + h * Y + j * Z + z;
        const xx = sigma[s], xy = sigma[s + 1], xz = sigma[s + 2], yy = sigma[s + 3], yz = sigma[s + 4], zz = sigma[s + 5];
        // Rows of F Sigma.
        const p0 = a * xx + b * xy + c * xz, p1 = a * xy + b * yy + c * yz, p2 = a * xz + b * yz + c * zz;
        const q0 = d * xx + e * xy + f * xz, q1 = d * xy + e * yy + f * yz, q2 = d * xz + e * yz + f * zz;
        const r0 = g * xx + h * xy + j * xz, r1 = g * xy + h * yy + j * yz, r2 = g * xz + h * yz + j * zz;
        const u = p0 * a + p1 * b + p2 * c, v = q0 * d + q1 * e + q2 * f, w = r0 * g + r1 * h + r2 * j;
        // Gaussians that are stretched too far are drawn smaller.
        const most = stretch[i] * stretch[i] * (xx + yy + zz), scale = u + v + w > most ? most / (u + v + w) : 1;
        shapes[s] = scale * u; shapes[s + 1] = scale * (p0 * d + p1 * e + p2 * f); shapes[s + 2] = scale * (p0 * g + p1 * h + p2 * j);
        shapes[s + 3] = scale * v; shapes[s + 4] = scale * (q0 * g + q1 * h + q2 * j); shapes[s + 5] = scale * w;
      }
    }

    /** Return the middle of the nodes, their spread along x and y, and the height of the lowest node. */
    shadow() {
      const { nodes, moves, rest } = this, sums = [0, 0, 0, 0, 0];
      let low = Infinity;
      for (let i = 0; i < nodes; i++) {
        const m = 12 * i, r = 3 * i;
        const at = (c) => moves[m + 9 + c] + moves[m + 3 * c] * rest[r] + moves[m + 3 * c + 1] * rest[r + 1] + moves[m + 3 * c + 2] * rest[r + 2];
        const x = at(0), y = at(1);
        low = Math.min(low, at(2));
        sums[0] += x; sums[1] += y; sums[2] += x * x; sums[3] += x * y; sums[4] += y * y;
      }
      const [x, y, xx, xy, yy] = sums.map((sum) => sum / nodes);
      return { middle: [x, y], spread: [xx - x * x + 1e-6, xy - x * y, yy - y * y + 1e-6], low };
    }
  };
})();
