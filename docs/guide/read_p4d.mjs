// Read a .p4d file of phy124 by HTTP range requests, in a browser or in node (motion only).
//   const film = await P4D.fetch('duck.p4d'), centres = await film.centres();
//   const places = await film.frame(5, centres);   // Float32Array [N,3], m
export class P4D {
  static async fetch(url) {
    return P4D.open(async (offset, length) => {
      const range = { headers: { Range: `bytes=${offset}-${offset + length - 1}` } };
      const answer = await fetch(url, range), data = new Uint8Array(await answer.arrayBuffer());
      return answer.status === 206 ? data : data.slice(offset, offset + length);
    });
  }

  /** `read(offset, length)` resolves to a Uint8Array. */
  static async open(read) {
    const film = new P4D(), head = await read(0, 12);
    if (String.fromCharCode(...head.slice(0, 5)) !== 'PHY4D' || head[6] !== 1) throw new Error('This is no .p4d file of version 1.');
    film.read = read;
    film.about = JSON.parse(new TextDecoder().decode(await read(12, new DataView(head.buffer).getUint32(8, true))));
    const numbers = new Uint32Array((await inflate(await read(...film.about.indices))).buffer);
    film.index = new Map(Array.from(numbers.slice(0, film.about.nodes), (node, k) => [node, k]));
    film.exceptions = numbers.slice(film.about.nodes);
    return film;
  }

  /** Centres of the Gaussians in a frame. */
  async frame(number, centres) {
    const data = await this.read(...this.about.frames[number]);
    const step = new DataView(data.buffer, data.byteOffset).getFloat32(0, true);
    const changes = new Int16Array((await inflate(data.slice(4))).buffer);
    const many = changes.length / 3, { origin, spacing, shape, nodes } = this.about;
    const shifts = [0, 1, 2].map((axis) => {
      const values = new Int16Array(many);
      for (let k = 0, sum = 0; k < many; k += 1) values[k] = sum = (sum + changes[axis * many + k]) << 16 >> 16;
      return values;
    });
    const places = Float32Array.from(centres);
    for (let n = 0; n < centres.length; n += 3) {
      const at = [0, 1, 2].map((c) => (centres[n + c] - origin[c]) / spacing);
      const cell = at.map((x, c) => Math.min(Math.max(Math.floor(x), 0), shape[c] - 2));
      for (let corner = 0; corner < 8; corner += 1) {
        const d = [corner >> 2, (corner >> 1) & 1, corner & 1];
        const node = this.index.get(((cell[0] + d[0]) * shape[1] + cell[1] + d[1]) * shape[2] + cell[2] + d[2]);
        if (node === undefined) continue;
        const weight = d.reduce((w, one, c) => w * (one ? at[c] - cell[c] : 1 - at[c] + cell[c]), step);
        for (let c = 0; c < 3; c += 1) places[n + c] += weight * shifts[c][node];
      }
    }
    this.exceptions.forEach((n, k) => { for (let c = 0; c < 3; c += 1) places[3 * n + c] += step * shifts[c][nodes + k]; });
    return places;
  }

  /** Centres in the first frame, from the SOG file; needs a browser, which decodes WebP. */
  async centres() {
    const files = unzip(await this.read(...this.about.still));
    const meta = JSON.parse(new TextDecoder().decode(files['meta.json']));
    const [low, high] = await Promise.all(meta.means.files.map((name) => pixels(files[name])));
    return Float32Array.from({ length: 3 * meta.count }, (_, k) => {
      const c = k % 3, pixel = 4 * Math.floor(k / 3) + c, { mins, maxs } = meta.means;
      const value = mins[c] + (low[pixel] + 256 * high[pixel]) / 65535 * (maxs[c] - mins[c]);
      return Math.sign(value) * Math.expm1(Math.abs(value));
    });
  }
}

async function inflate(data) {
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream('deflate'));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

async function pixels(data) {
  const picture = await createImageBitmap(new Blob([data], { type: 'image/webp' }), { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
  const context = new OffscreenCanvas(picture.width, picture.height).getContext('2d', { willReadFrequently: true });
  context.drawImage(picture, 0, 0);
  return context.getImageData(0, 0, picture.width, picture.height).data;
}

/** Members of an archive whose files are stored, as those of SOG are. */
function unzip(data) {
  const view = new DataView(data.buffer, data.byteOffset), files = {};
  for (let at = 0; view.getUint32(at, true) === 0x04034b50;) {
    const size = view.getUint32(at + 18, true), name = view.getUint16(at + 26, true), start = at + 30 + name + view.getUint16(at + 28, true);
    files[new TextDecoder().decode(data.slice(at + 30, at + 30 + name))] = data.slice(start, start + size);
    at = start + size;
  }
  return files;
}
