/* Reads a pack of moving Gaussians (phy124/io/export/html.py writes it) and blends between frames.
 *
 *   const pack = await Phy124Pack.unpack(bytes);
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
    return { ...head, n, t, colours, rest, centres, quats, ratios, speeds, shades };
  }

  /** Values at a fractional frame; planar in (component-major), interleaved with 4 floats out. */
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
      const { n, quats } = this.pack;
      for (let c = 0; c < 4; c++) {
        const a = (k * 4 + c) * n, b = (next * 4 + c) * n;
        for (let i = 0; i < n; i++) out[i * 4 + c] = quats[a + i] * (1 - f) + quats[b + i] * f;
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

    /** Speed of each splat as a fraction of the largest one. */
    speed(frame, i) {
      const { n, t, speeds } = this.pack, k = Math.min(Math.round(frame), t - 1);
      return speeds[k * n + i] / 255;
    }

    /** Longest axis now over longest axis at rest. */
    stretch(scale, i) {
      const { rest } = this.pack;
      return Math.max(scale[i * 4], scale[i * 4 + 1], scale[i * 4 + 2])
        / Math.max(rest[i * 3], rest[i * 3 + 1], rest[i * 3 + 2]);
    }
  }

  /** Frames that come one by one, each a pack of its own, of a clip that is still growing. */
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

  return { unpack, Blend, Growing };
})();
