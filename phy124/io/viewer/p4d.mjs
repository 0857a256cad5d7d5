// Read a .p4d file of phy124 by HTTP range requests, in a browser or in node (motion only).
//   const film = await P4D.fetch('duck.p4d'), { centres } = await film.still();
//   const places = await film.frame(5, centres);   // Float32Array [N,3], m
export class P4D {
  static fetch(url) {
    let whole; // the whole file, if the server does not answer range requests
    return P4D.open(async (offset, length) => {
      if (whole) return whole.slice(offset, offset + length);
      const range = { headers: { Range: `bytes=${offset}-${offset + length - 1}` } };
      const answer = await fetch(url, range);
      if (!answer.ok) throw new Error(`${url}: ${answer.status} ${answer.statusText}`);
      const data = new Uint8Array(await answer.arrayBuffer());
      if (answer.status === 206) return data;
      whole = data;
      return whole.slice(offset, offset + length);
    });
  }

  /** `read(offset, length)` returns a Uint8Array or its promise. */
  static async open(read) {
    const film = new P4D(), head = await read(0, 12);
    if (String.fromCharCode(...head.slice(0, 5)) !== 'PHY4D' || head[6] !== 1) throw new Error('This is no .p4d file of version 1.');
    film.read = async (offset, length) => {
      const data = await read(offset, length);
      if (data.length < length) throw new Error('The .p4d file is cut short.');
      return data;
    };
    film.about = JSON.parse(new TextDecoder().decode(await film.read(12, new DataView(head.buffer, head.byteOffset).getUint32(8, true))));
    const numbers = new Uint32Array((await film.section(film.about.indices)).buffer);
    film.index = new Map(Array.from(numbers.slice(0, film.about.nodes), (node, k) => [node, k]));
    film.exceptions = numbers.slice(film.about.nodes);
    return film;
  }

  async section([offset, length]) { return inflate(await this.read(offset, length)); }

  /** Cell of each centre: its position in the cell [N,3], 0..1, and its eight nodes [N,8]; a missing node is `nodes`. */
  cells(centres) {
    const { origin, spacing, shape, nodes } = this.about, near = new Uint32Array(centres.length / 3 * 8), share = new Float32Array(centres.length);
    for (let n = 0; n < centres.length; n += 3) {
      const cell = [0, 1, 2].map((c) => {
        const at = (centres[n + c] - origin[c]) / spacing, whole = Math.min(Math.max(Math.floor(at), 0), shape[c] - 2);
        share[n + c] = at - whole;
        return whole;
      });
      for (let corner = 0; corner < 8; corner += 1) {
        const node = ((cell[0] + (corner >> 2)) * shape[1] + cell[1] + ((corner >> 1) & 1)) * shape[2] + cell[2] + (corner & 1);
        near[n / 3 * 8 + corner] = this.index.get(node) ?? nodes;
      }
    }
    return { near, share };
  }

  /** Displacements in a frame, m: of the nodes and of a missing node [nodes + 1,3], and shifts of the exceptions [E,3]. */
  async displacements(number) {
    const [offset, length] = this.about.frames[number], data = await this.read(offset, length);
    const step = new DataView(data.buffer, data.byteOffset).getFloat32(0, true);
    const changes = new Int16Array((await inflate(data.slice(4))).buffer), many = changes.length / 3, { nodes } = this.about;
    const moved = new Float32Array(3 * nodes + 3), shifts = new Float32Array(3 * (many - nodes));
    for (let axis = 0; axis < 3; axis += 1) {
      for (let k = 0, sum = 0; k < many; k += 1) {
        sum = (sum + changes[axis * many + k]) << 16 >> 16;
        if (k < nodes) moved[3 * k + axis] = step * sum; else shifts[3 * (k - nodes) + axis] = step * sum;
      }
    }
    return { moved, shifts };
  }

  /** Centres of the Gaussians in a frame. */
  async frame(number, centres) {
    const { near, share } = this.cells(centres), { moved, shifts } = await this.displacements(number), places = Float32Array.from(centres);
    for (let n = 0; n < centres.length; n += 3) {
      for (let corner = 0; corner < 8; corner += 1) {
        const weight = [corner >> 2, (corner >> 1) & 1, corner & 1].reduce((w, far, c) => w * (far ? share[n + c] : 1 - share[n + c]), 1);
        for (let c = 0; c < 3; c += 1) places[n + c] += weight * moved[3 * near[n / 3 * 8 + corner] + c];
      }
    }
    this.exceptions.forEach((n, k) => { for (let c = 0; c < 3; c += 1) places[3 * n + c] += shifts[3 * k + c]; });
    return places;
  }

  /** Gaussians of the first frame, from the SOG file: centres and scales [N,3], m, quats wxyz and colours [N,4]; for browsers, which decode WebP. */
  async still() {
    const files = unzip(await this.read(...this.about.still)), meta = JSON.parse(new TextDecoder().decode(files['meta.json'])), n = meta.count;
    const images = (entry) => Promise.all(entry.files.map((name) => pixels(files[name])));
    const [[low, high], [packed], [sizes], [colour]] = await Promise.all([meta.means, meta.quats, meta.scales, meta.sh0].map(images));
    const { mins, maxs } = meta.means, centres = new Float32Array(3 * n), scales = new Float32Array(3 * n), quats = new Float32Array(4 * n), colours = new Uint8Array(4 * n);
    for (let i = 0; i < n; i += 1) {
      const largest = packed[4 * i + 3] - 252;
      for (let c = 0, rest = 1; c < 3; c += 1) {
        const value = mins[c] + (low[4 * i + c] + 256 * high[4 * i + c]) / 65535 * (maxs[c] - mins[c]);
        centres[3 * i + c] = Math.sign(value) * Math.expm1(Math.abs(value));
        scales[3 * i + c] = Math.exp(meta.scales.codebook[sizes[4 * i + c]]);
        colours[4 * i + c] = 255 * (0.5 + 0.28209479177387814 * meta.sh0.codebook[colour[4 * i + c]]) + 0.5;
        const other = quats[4 * i + (c < largest ? c : c + 1)] = (packed[4 * i + c] / 255 * 2 - 1) / Math.SQRT2;
        quats[4 * i + largest] = Math.sqrt(Math.max(rest -= other * other, 0));
      }
      colours[4 * i + 3] = colour[4 * i + 3];
    }
    return { centres, scales, quats, colours };
  }
}

async function inflate(data) {
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Pixels of a picture, read by WebGL, because a 2D canvas would round colours of low opacity. If the browser removes
 * the graphics context meanwhile, the pixels are zeros; the picture is then read again, up to ten times. */
async function pixels(data, attempts = 10) {
  const picture = await createImageBitmap(new Blob([data], { type: 'image/webp' }), { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
  const gl = new OffscreenCanvas(1, 1).getContext('webgl2'), { width, height } = picture, out = new Uint8Array(4 * width * height);
  if (!gl) throw new Error('This browser has no WebGL 2, which reads the colours of a .p4d file.');
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
  gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, texture, 0);
  gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
  if (gl.isContextLost()) {
    if (attempts === 1) throw new Error('The browser removed the graphics context while the .p4d file was read.');
    await new Promise((wait) => { setTimeout(wait, 200); });
    return pixels(data, attempts - 1);
  }
  gl.getExtension('WEBGL_lose_context')?.loseContext();
  return out;
}

/** Files of a zip archive without compression, such as SOG. */
function unzip(data) {
  const view = new DataView(data.buffer, data.byteOffset), files = {};
  for (let at = 0; view.getUint32(at, true) === 0x04034b50;) {
    const size = view.getUint32(at + 18, true), name = view.getUint16(at + 26, true), start = at + 30 + name + view.getUint16(at + 28, true);
    files[new TextDecoder().decode(data.slice(at + 30, at + 30 + name))] = data.slice(start, start + size);
    at = start + size;
  }
  return files;
}
