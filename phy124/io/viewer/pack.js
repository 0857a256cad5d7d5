/* Reads a pack of moving Gaussians (phy124/io/html.py writes it) and blends between frames.
 *
 *   const pack = await Phy124Pack.unpack(bytes);
 *   const pack = await Phy124Pack.film(await P4D.fetch(address));  // a .p4d file (p4d.mjs)
 *   new Phy124Pack.Blend(pack).at(2.5, { centre, rotation, scale });
 */
'use strict';
globalThis.Phy124Pack = (() => {
  async function inflate(bytes) {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  /** Sum differences over frames: `planes` rows of n values in each of t frames. */
  function integrate(values, t, row) {
    for (let i = row; i < t * row; i++) values[i] += values[i - row];
    return values;
  }

  async function unpack(zipped) {
    const bytes = await inflate(zipped);
    const length = new DataView(bytes.buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
    const { splats: n, times } = head, t = times.length;
    let at = 4 + length;
    const take = (count) => bytes.subarray(at, (at += count));
    const colours = take(n * 4);
    const rest = new Float32Array(take(n * 12).slice().buffer);
    const low = take(t * n * 3), high = take(t * n * 3);
    const centres = new Uint16Array(t * n * 3);
    for (let i = 0; i < centres.length; i++) centres[i] = low[i] | (high[i] << 8);
    integrate(centres, t, n * 3);
    const quats = integrate(new Int8Array(take(t * n * 4)), t, n * 4);
    const ratios = integrate(new Uint8Array(take(t * n * 3)), t, n * 3);
    const speeds = integrate(new Uint8Array(take(t * n)), t, n);
    const cells = head.stage && head.stage.floor ? head.stage.floor.cells ** 2 : 0;
    const shades = integrate(take(t * cells), t, cells);
    const hues = head.hues ? integrate(take(t * n * 4), t, n * 4) : null;
    return { ...head, n, t, colours, rest, centres, quats, ratios, speeds, shades, hues };
  }

  /** Interpolates between frames. A pack stores component after component; results have four floats per Gaussian. */
  class Blend {
    constructor(pack) { this.pack = pack; }

    at(frame, out) {
      const k = Math.min(Math.floor(frame), this.pack.t - 1), f = frame - k;
      const next = f > 1e-4 ? Math.min(k + 1, this.pack.t - 1) : k;
      this.centres(k, next, f, out.centre);
      this.quats(k, next, f, out.rotation);
      this.scales(k, next, f, out.scale);
    }

    centres(k, next, f, out) {
      const { n, low, high, centres } = this.pack;
      for (let c = 0; c < 3; c++) {
        const a = (k * 3 + c) * n, b = (next * 3 + c) * n, step = (high[c] - low[c]) / 65535;
        for (let i = 0; i < n; i++) {
          out[i * 4 + c] = low[c] + step * (centres[a + i] * (1 - f) + centres[b + i] * f);
        }
      }
    }

    quats(k, next, f, out) {
      const { n, quats } = this.pack, at = [0, 1, 2, 3].map((c) => (k * 4 + c) * n), to = at.map((from) => from + (next - k) * 4 * n);
      for (let i = 0; i < n; i++) {
        let same = 0;
        for (let c = 0; c < 4; c++) same += quats[at[c] + i] * quats[to[c] + i];
        for (let c = 0; c < 4; c++) out[i * 4 + c] = quats[at[c] + i] * (1 - f) + quats[to[c] + i] * (same < 0 ? -f : f);
      }
      for (let i = 0; i < n * 4; i += 4) {
        const s = 1 / (Math.hypot(out[i], out[i + 1], out[i + 2], out[i + 3]) || 1);
        out[i] *= s; out[i + 1] *= s; out[i + 2] *= s; out[i + 3] *= s;
      }
    }

    scales(k, next, f, out) {
      const { n, rest, ratios, ratio } = this.pack, step = (ratio[1] - ratio[0]) / 255;
      for (let c = 0; c < 3; c++) {
        const a = (k * 3 + c) * n, b = (next * 3 + c) * n;
        for (let i = 0; i < n; i++) {
          const log = ratio[0] + step * (ratios[a + i] * (1 - f) + ratios[b + i] * f);
          out[i * 4 + c] = rest[i * 3 + c] * Math.exp(log);
        }
      }
    }

    /** Colour and opacity of a splat [4], 0 to 1, which vary over time if the pack has hues. */
    colour(frame, i, out) {
      const { n, t, colours, hues } = this.pack;
      if (!hues) { for (let c = 0; c < 4; c++) out[c] = colours[i * 4 + c] / 255; return; }
      const k = Math.min(Math.floor(frame), t - 1), next = Math.min(k + 1, t - 1), f = frame - k;
      for (let c = 0; c < 4; c++) out[c] = (hues[(k * 4 + c) * n + i] * (1 - f) + hues[(next * 4 + c) * n + i] * f) / 255;
    }

    /** Speed of each splat as a fraction of the largest one. */
    speed(frame, i) {
      const { n, t, speeds } = this.pack, k = Math.min(Math.round(frame), t - 1);
      return speeds[k * n + i] / 255;
    }

    /** Length of a splat's longest axis, divided by the length of its longest axis at rest. */
    stretch(scale, i) {
      const { rest } = this.pack;
      return Math.max(scale[i * 4], scale[i * 4 + 1], scale[i * 4 + 2])
        / Math.max(rest[i * 3], rest[i * 3 + 1], rest[i * 3 + 2]);
    }
  }

  /** A clip that is still being computed: each new frame arrives as a separate pack. */
  class Growing extends Blend {
    static begin(first) {
      const { target, radius } = first.view, sides = [-1, 1].map((side) => target.map((v) => v + side * radius));
      return { ...first, low: sides[0], high: sides[1], frames: [first], times: [...first.times] };
    }

    static add(pack, frame) {
      pack.frames.push(frame);
      pack.times.push(frame.times[0]);
      pack.t = pack.frames.length;
    }

    at(frame, out) { new Blend(this.pack.frames[Math.min(Math.round(frame), this.pack.t - 1)]).at(0, out); }

    speed() { return 0; }

    stretch() { return 1; }
  }

  /** Convert a vector from the axes of phy124 (x front, z up) to the axes of SOG (-z front, -y up). */
  const turned = (x, y, z) => [-z, x, -y];

  /** Create the pack of a .p4d file; `load(k)` must read frame k before the frame is drawn. */
  async function film(p4d) {
    const { about } = p4d, { count: n, times, player } = about, t = times.length;
    const [still, flat] = await Promise.all([p4d.still(), player.shades ? p4d.section(player.shades) : new Uint8Array()]);
    const middle = player.low.map((v, c) => (v + player.high[c]) / 2), view = { target: middle, radius: 2.2 * about.size, azimuth: 0, elevation: 10, fov: 49.1 };
    const pack = { view, background: [1, 1, 1], ...player, times, n, t, p4d, still, colours: still.colours, rest: still.scales,
      centres: new Uint16Array(t * n * 3), quats: new Int8Array(t * n * 4), ratios: new Uint8Array(t * n * 3), loaded: [],
      ...p4d.cells(still.centres) };
    pack.shades = integrate(flat, t, flat.length / t);
    pack.axes = restAxes(still);
    const failed = (k) => (error) => { pack.loaded[k] = undefined; throw error; }; // reading can be repeated
    pack.load = (k) => (pack.loaded[k] ??= p4d.displacements(k).then((moves) => { pose(pack, k, moves); pack.loaded[k] = true; }).catch(failed(k)));
    await pack.load(0);
    return pack;
  }

  /** Columns of the rotation matrix of each Gaussian, times its scales [N,9]. */
  function restAxes({ quats, scales }) {
    const n = scales.length / 3, out = new Float32Array(9 * n);
    for (let i = 0; i < n; i++) {
      const [w, x, y, z] = quats.subarray(4 * i, 4 * i + 4), [a, b, c] = scales.subarray(3 * i, 3 * i + 3);
      out.set([a * (1 - 2 * (y * y + z * z)), a * 2 * (x * y + w * z), a * 2 * (x * z - w * y),
        b * 2 * (x * y - w * z), b * (1 - 2 * (x * x + z * z)), b * 2 * (y * z + w * x),
        c * 2 * (x * z + w * y), c * 2 * (y * z - w * x), c * (1 - 2 * (x * x + y * y))], 9 * i);
    }
    return out;
  }

  /** Compute centres and shapes in frame k; shapes follow the deformation gradient F = I + sum u (grad w)^T. */
  function pose(pack, k, { moved, shifts }) {
    const { n, low, high, ratio, near, share, still, rest, axes, p4d } = pack, h = 1 / p4d.about.spacing;
    const ratios = 255 / Math.max(ratio[1] - ratio[0], 1e-12), width = low.map((v, c) => 65535 / Math.max(high[c] - v, 1e-12));
    const shift = new Float32Array(3 * n), m = new Float64Array(9), g = new Float64Array(9);
    p4d.exceptions.forEach((i, e) => shift.set(shifts.subarray(3 * e, 3 * e + 3), 3 * i));
    for (let i = 0; i < n; i++) {
      let x = still.centres[3 * i] + shift[3 * i], y = still.centres[3 * i + 1] + shift[3 * i + 1], z = still.centres[3 * i + 2] + shift[3 * i + 2];
      const p = share[3 * i], q = share[3 * i + 1], r = share[3 * i + 2];
      g.set([1, 0, 0, 0, 1, 0, 0, 0, 1]);
      for (let corner = 0; corner < 8; corner++) {
        const at = 3 * near[8 * i + corner], u = moved[at], v = moved[at + 1], w = moved[at + 2];
        const a = corner & 4 ? p : 1 - p, b = corner & 2 ? q : 1 - q, c = corner & 1 ? r : 1 - r, weight = a * b * c;
        const da = (corner & 4 ? h : -h) * b * c, db = (corner & 2 ? h : -h) * a * c, dc = (corner & 1 ? h : -h) * a * b;
        x += weight * u; y += weight * v; z += weight * w;
        g[0] += u * da; g[1] += v * da; g[2] += w * da; g[3] += u * db; g[4] += v * db; g[5] += w * db; g[6] += u * dc; g[7] += v * dc; g[8] += w * dc;
      }
      const place = turned(x, y, z);
      for (let c = 0; c < 3; c++) pack.centres[(k * 3 + c) * n + i] = Math.min(Math.max((place[c] - low[c]) * width[c], 0), 65535) + 0.5;
      for (let j = 0; j < 9; j += 3) for (let c = 0; c < 3; c++) m[j + c] = g[c] * axes[9 * i + j] + g[3 + c] * axes[9 * i + j + 1] + g[6 + c] * axes[9 * i + j + 2];
      orthogonalise(m);
      for (let c = 0; c < 3; c++) {
        const length = Math.max(Math.hypot(m[3 * c], m[3 * c + 1], m[3 * c + 2]), 1e-12), log = Math.log(length / rest[3 * i + c]);
        pack.ratios[(k * 3 + c) * n + i] = Math.min(Math.max((log - ratio[0]) * ratios, 0), 255) + 0.5;
        m.set(turned(m[3 * c] / length, m[3 * c + 1] / length, m[3 * c + 2] / length), 3 * c);
      }
      quaternion(m).forEach((value, c) => { pack.quats[(k * 4 + c) * n + i] = Math.round(127 * value); });
    }
  }

  /** Make three columns [9] orthogonal by rotations of pairs of columns: one-sided Jacobi (Hestenes 1958). */
  function orthogonalise(m) {
    for (let sweep = 0; sweep < 6; sweep++) {
      let done = true;
      for (let a = 0; a < 6; a += 3) {
        for (let b = a + 3; b < 9; b += 3) {
          const p = m[a] ** 2 + m[a + 1] ** 2 + m[a + 2] ** 2, q = m[b] ** 2 + m[b + 1] ** 2 + m[b + 2] ** 2;
          const r = m[a] * m[b] + m[a + 1] * m[b + 1] + m[a + 2] * m[b + 2];
          if (r * r <= 1e-6 * p * q) continue;
          done = false;
          const slope = (q - p) / (2 * r), t = (slope < 0 ? -1 : 1) / (Math.abs(slope) + Math.sqrt(1 + slope * slope)), c = 1 / Math.sqrt(1 + t * t), s = c * t;
          for (let j = 0; j < 3; j++) { const u = m[a + j], v = m[b + j]; m[a + j] = c * u - s * v; m[b + j] = s * u + c * v; }
        }
      }
      if (done) return;
    }
  }

  /** Quaternion wxyz of three orthonormal columns [9]; a left-handed set is inverted first (Shepperd 1978). */
  function quaternion(m) {
    const determinant = m[0] * (m[4] * m[8] - m[7] * m[5]) - m[3] * (m[1] * m[8] - m[7] * m[2]) + m[6] * (m[1] * m[5] - m[4] * m[2]);
    if (determinant < 0) for (let j = 0; j < 9; j++) m[j] = -m[j];
    const sizes = [m[0] + m[4] + m[8], m[0] - m[4] - m[8], m[4] - m[0] - m[8], m[8] - m[0] - m[4]];
    const most = sizes.indexOf(Math.max(...sizes)), a = Math.sqrt(1 + sizes[most]) / 2, b = 1 / (4 * a);
    const [x, y, z] = [m[5] - m[7], m[6] - m[2], m[1] - m[3]], [xy, xz, yz] = [m[1] + m[3], m[2] + m[6], m[5] + m[7]];
    const q = [[4 * a * a, x, y, z], [x, 4 * a * a, xy, xz], [y, xy, 4 * a * a, yz], [z, xz, yz, 4 * a * a]][most];
    return q.map((value) => value * b);
  }

  /** Frames of a .p4d file. */
  class Film extends Blend {
    speed(frame, i) {
      const { n, t, times, centres, low, high, speed } = this.pack, k = Math.min(Math.round(frame), t - 1);
      const [a, b] = [Math.max(k - 1, 0), Math.min(k + 1, t - 1)].map((at) => (this.pack.loaded[at] === true ? at : k));
      const away = low.map((v, c) => (high[c] - v) / 65535 * (centres[(b * 3 + c) * n + i] - centres[(a * 3 + c) * n + i]));
      return a === b ? 0 : Math.hypot(...away) / (times[b] - times[a]) / (speed || 1);
    }
  }

  return { unpack, film, Blend, Growing, Film };
})();
