/* Draws the surroundings of the object: backdrop, floor with its shadow, boundaries as glass. The functions
 * are translations of the kernels in phy124/kernels/splat/{stage,glass}.py. A pack (phy124/io/html.py) contains
 * the shapes and positions.
 *
 *   const around = new Phy124Stage(app, device, entity, pack);
 *   around.show(2.5); around.look(eye, rows, focal, size);
 */
'use strict';
globalThis.Phy124Stage = (() => {
  const GLASS = `
    uniform highp sampler2D uSolids;
    uniform vec3 uEye;
    const float FACE = 0.10, LINE = 0.45, RIM = 0.50, WIDTH = 1.5, NEARLY = 0.9999;
    const vec3 TINT = vec3(0.36, 0.44, 0.52);

    float edgeOf(vec3 extents, vec3 at, float pixel) {
      vec3 d = abs(extents - abs(at));
      float second = max(min(d.x, d.y), min(max(d.x, d.y), d.z));
      return FACE + (LINE - FACE) * clamp(1.0 - second / (WIDTH * pixel), 0.0, 1.0);
    }

    // A hit is (distance at which the ray enters, at which it leaves, opacities of the two faces).
    vec4 boxHit(vec3 centre, vec3 extents, mat3 axes, vec3 origin, vec3 ray, float pixel) {
      vec3 o = (origin - centre) * axes, d = ray * axes;
      d = mix(d, vec3(1.0e-9), vec3(lessThan(abs(d), vec3(1.0e-9))));
      vec3 a = (-extents - o) / d, b = (extents - o) / d, low = min(a, b), high = max(a, b);
      vec4 hit = vec4(max(max(low.x, low.y), low.z), min(min(high.x, high.y), high.z), 0.0, 0.0);
      if (hit.y > max(hit.x, 0.0)) {
        hit.z = edgeOf(extents, o + hit.x * d, hit.x * pixel);
        hit.w = edgeOf(extents, o + hit.y * d, hit.y * pixel);
      }
      return hit;
    }

    float rimOf(vec3 towards, vec3 ray) {
      float grazing = 1.0 - abs(dot(towards, ray)) / (length(towards) * length(ray));
      return 0.6 * FACE + (RIM - 0.6 * FACE) * grazing * grazing * grazing;
    }

    vec3 fromAxis(vec3 centre, vec3 axis, float reach, vec3 point) {
      vec3 away = point - centre;
      return away - clamp(dot(away, axis), -reach, reach) * axis;
    }

    vec2 ballHit(vec3 centre, float radius, vec3 origin, vec3 ray) {
      vec3 o = origin - centre;
      float a = dot(ray, ray), b = dot(o, ray);
      vec3 closest = o - (b / a) * ray;
      float rest = radius * radius - dot(closest, closest);
      if (rest <= 0.0) return vec2(1.0, -1.0);
      return vec2(-b / a) + sqrt(rest / a) * vec2(-1.0, 1.0);
    }

    vec2 joined(vec2 a, vec2 b) {
      if (a.y < a.x) return b;
      if (b.y < b.x) return a;
      return vec2(min(a.x, b.x), max(a.y, b.y));
    }

    vec4 capsuleHit(vec3 centre, float reach, float radius, vec3 axis, vec3 origin, vec3 ray) {
      vec2 ends = joined(ballHit(centre - reach * axis, radius, origin, ray),
        ballHit(centre + reach * axis, radius, origin, ray));
      vec3 o = origin - centre;
      float along = dot(ray, axis);
      vec3 across = ray - along * axis;
      if (reach > 0.0 && dot(across, across) > 1.0e-12) {
        float start = dot(o, axis);
        vec2 tube = ballHit(vec3(0.0), radius, o - start * axis, across);
        if (abs(along) < 1.0e-9) along = 1.0e-9;
        float a = (-reach - start) / along, b = (reach - start) / along;
        vec2 part = vec2(max(tube.x, min(a, b)), min(tube.y, max(a, b)));
        if (part.y > part.x) ends = joined(ends, part);
      }
      vec4 hit = vec4(ends, 0.0, 0.0);
      if (hit.y > max(hit.x, 0.0)) {
        hit.z = rimOf(fromAxis(centre, axis, reach, origin + hit.x * ray), ray);
        hit.w = rimOf(fromAxis(centre, axis, reach, origin + hit.y * ray), ray);
      }
      return hit;
    }

    float veil(int k, vec3 origin, vec3 ray, float limit, float pixel) {
      vec4 place = texelFetch(uSolids, ivec2(0, k), 0);
      vec3 extents = texelFetch(uSolids, ivec2(1, k), 0).xyz;
      mat3 axes = mat3(texelFetch(uSolids, ivec2(2, k), 0).xyz, texelFetch(uSolids, ivec2(3, k), 0).xyz,
        texelFetch(uSolids, ivec2(4, k), 0).xyz);
      vec4 hit = place.w > 0.0 ? capsuleHit(place.xyz, extents.x, place.w, axes[0], origin, ray)
        : boxHit(place.xyz, extents, axes, origin, ray, pixel);
      if (hit.y <= max(hit.x, 0.0) || hit.x >= limit) return 0.0;
      float clear = 1.0;
      if (hit.x > 0.0) clear *= 1.0 - hit.z;
      if (hit.y < NEARLY * limit) clear *= 1.0 - hit.w;
      float chord = (hit.y - max(hit.x, 0.0)) * length(ray);
      return (1.0 - clear) * clamp(chord / (WIDTH * pixel * hit.y), 0.0, 1.0);
    }

    float seenThrough(int count, vec3 ray, float limit, float pixel) {
      float clear = 1.0;
      for (int k = 0; k < count; k++) clear *= 1.0 - veil(k, uEye, ray, limit, pixel);
      return 1.0 - clear;
    }`;

  const VERTEX = `
    attribute vec2 aPosition;
    void main(void) { gl_Position = vec4(aPosition, 0.0, 1.0); }`;

  const FRAGMENT = `
    precision highp float;
    precision highp int;
    uniform highp sampler2D uShade;
    uniform sampler2D uPicture;
    uniform vec3 uRight, uDown, uAhead, uTop, uBottom;
    uniform vec4 uFloor;     // 1 if there is a floor, its height, width and height of the picture [px]
    uniform vec4 uMap;       // shadow map: middle x and y, half its side, number of cells
    uniform vec4 uFill;      // part of the backdrop picture that fills the frame: scale, offset
    uniform float uFocal, uCount, uHasPicture, uClear;
    const float POOL = 0.5;
    ${GLASS}

    float shadeAt(vec2 at) {
      float last = uMap.w - 1.0;
      if (at.x < 0.0 || at.y < 0.0 || at.x >= last || at.y >= last) return 0.0;
      ivec2 cell = ivec2(at);
      vec2 part = at - vec2(cell);
      // Rows of the texture go along x of the world, columns along y.
      float a = texelFetch(uShade, cell.yx, 0).r, b = texelFetch(uShade, cell.yx + ivec2(0, 1), 0).r;
      float c = texelFetch(uShade, cell.yx + ivec2(1, 0), 0).r, d = texelFetch(uShade, cell.yx + ivec2(1, 1), 0).r;
      return mix(mix(a, b, part.x), mix(c, d, part.x), part.y);
    }

    void main(void) {
      vec2 size = uFloor.zw, at = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y);
      vec3 ray = ((at.x - 0.5 * size.x) * uRight + (at.y - 0.5 * size.y) * uDown) / uFocal + uAhead;
      vec3 colour = mix(uTop, uBottom, at.y / size.y);
      if (uHasPicture > 0.5) colour = texture2D(uPicture, at / size * uFill.xy + uFill.zw).rgb;
      float limit = 1.0e30, light = 1.0;
      if (uFloor.x > 0.5 && uEye.z > uFloor.y && ray.z < 0.0) {
        limit = (uFloor.y - uEye.z) / ray.z;
        vec2 on = uEye.xy + limit * ray.xy - uMap.xy, far = on / uMap.z;
        float rest = max(1.0 - 0.5 * dot(far, far), 0.0), pool = POOL * rest * rest;
        light = 1.0 - shadeAt((on + uMap.z) * 0.5 * uMap.w / uMap.z - 0.5);
        colour = light * (colour + pool * colour * (1.0 - colour));
      }
      float veiled = seenThrough(int(uCount), ray, limit, 1.0 / uFocal);
      // In front of a page, draw only shadow and glass, premultiplied by their opacity.
      gl_FragColor = uClear > 0.5 ? vec4(veiled * TINT, 1.0 - (1.0 - veiled) * light) : vec4(min(mix(colour, TINT, veiled), 1.0), 1.0);
    }`;

  // y is up in PlayCanvas, z in phy124.
  const TINTING = `
    uniform vec3 uAhead;
    uniform float uFocal, uCount;
    ${GLASS}
    void modifySplatCenter(inout vec3 center) {}
    void modifySplatRotationScale(vec3 before, vec3 after, inout vec4 rotation, inout vec3 scale) {}
    void modifySplatColor(vec3 center, inout vec4 color) {
      vec3 ray = vec3(center.x, -center.z, center.y) - uEye;
      color.rgb = mix(color.rgb, TINT, seenThrough(int(uCount), ray, 1.0, dot(uAhead, ray) / uFocal));
    }`;

  class Stage {
    constructor(app, device, entity, pack) {
      Object.assign(this, { device, entity, pack, given: pack.stage });
      this.material = new pc.ShaderMaterial({ uniqueName: 'Phy124Stage', vertexGLSL: VERTEX, fragmentGLSL: FRAGMENT,
        attributes: { aPosition: pc.SEMANTIC_POSITION } });
      Object.assign(this.material, { depthTest: false, depthWrite: false, cull: pc.CULLFACE_NONE });
      const mesh = new pc.Mesh(device);
      mesh.setPositions([-1, -1, 3, -1, -1, 3], 2);
      mesh.update();
      const drawn = new pc.MeshInstance(mesh, this.material, new pc.GraphNode());
      drawn.cull = false;
      // Gaussians appear only after their first sort; until then, the shadow would be visible without its object.
      drawn.visible = false;
      app.scene.once('gsplat:sorted', () => { drawn.visible = true; });
      app.scene.layers.getLayerById(pc.LAYERID_WORLD).addMeshInstances([drawn]);
      const { floor, solids } = this.given;
      this.cells = floor ? floor.cells : 1;
      this.shade = this.texture(this.cells, this.cells, pc.PIXELFORMAT_R32F);
      this.places = this.texture(5, Math.max(solids.length, 1), pc.PIXELFORMAT_RGBA32F);
      this.set('uShade', this.shade);
      this.set('uPicture', this.shade);
      if (solids.length) this.entity.gsplat.setWorkBufferModifier({ glsl: TINTING });
      this.behind(this.given);
      if (this.given.picture) this.load(this.given.picture);
    }

    texture(width, height, format) {
      return new pc.Texture(this.device, { width, height, format, mipmaps: false, minFilter: pc.FILTER_NEAREST, magFilter: pc.FILTER_NEAREST,
        addressU: pc.ADDRESS_CLAMP_TO_EDGE, addressV: pc.ADDRESS_CLAMP_TO_EDGE });
    }

    set(name, value) { this.material.setParameter(name, value); }

    /** Set a parameter that the shader of the Gaussians also reads. */
    share(name, value) { this.set(name, value); if (this.given.solids.length) this.entity.gsplat.setParameter(name, value); }

    /** Set the colours of the backdrop's first and last row, or its picture; `clear`: draw no backdrop. */
    behind({ top, bottom, picture }, clear = false) {
      this.set('uClear', clear ? 1 : 0);
      this.clear = clear;
      this.set('uTop', top);
      this.set('uBottom', bottom);
      this.set('uHasPicture', picture && this.image ? 1 : 0);
    }

    async load(address) {
      const image = this.image = new Image();
      image.src = address;
      await image.decode();
      const made = this.texture(image.width, image.height, pc.PIXELFORMAT_RGBA8);
      made.minFilter = made.magFilter = pc.FILTER_LINEAR;
      made.setSource(image);
      this.set('uPicture', made);
      this.behind(this.given, this.clear);
      if (this.size) this.fill();
    }

    /** Let the middle of the backdrop's picture fill the frame. */
    fill() {
      const [width, height] = this.size, { image } = this;
      if (!image) return;
      const scale = Math.max(width / image.width, height / image.height);
      const part = [width / scale / image.width, height / scale / image.height];
      this.set('uFill', [...part, (1 - part[0]) / 2, (1 - part[1]) / 2]);
    }

    /** Show the surroundings at a fractional frame. */
    show(frame) {
      const { pack } = this, k = Math.min(Math.floor(frame), pack.t - 1), next = Math.min(k + 1, pack.t - 1), f = frame - k;
      const at = (index) => (pack.frames ? { stage: pack.frames[index].stage, shades: pack.frames[index].shades, i: 0 } : { stage: this.given, shades: pack.shades, i: index });
      const [a, b] = [at(k), at(next)];
      this.placeFloor(a, b, f);
      this.placeSolids(a, b, f);
    }

    placeFloor(a, b, f) {
      const { floor } = a.stage;
      if (!floor) { this.height = null; return; }
      this.height = floor.heights[a.i] * (1 - f) + b.stage.floor.heights[b.i] * f;
      const cells = this.cells ** 2, out = this.shade.lock();
      for (let i = 0; i < cells; i++) out[i] = (a.shades[a.i * cells + i] * (1 - f) + b.shades[b.i * cells + i] * f) / 255;
      this.shade.unlock();
      this.set('uMap', [...floor.middle, floor.reach, this.cells]);
      if (this.size) this.level();
    }

    placeSolids(a, b, f) {
      const out = this.places.lock();
      let count = 0;
      a.stage.solids.forEach((solid, s) => {
        if (!solid.present[a.i]) return;
        const [from, to] = [solid.centres[a.i], b.stage.solids[s].centres[b.i]];
        const row = [[...from.map((v, c) => v * (1 - f) + to[c] * f), solid.radius], [...solid.half, 0], ...solid.axes.map((axis) => [...axis, 0])];
        out.set(row.flat(), 20 * count++);
      });
      this.places.unlock();
      this.share('uSolids', this.places);
      this.share('uCount', count);
      this.tinted();
    }

    /** Request a new computation of the Gaussians' colours. */
    tinted() { if (this.given.solids.length) this.entity.gsplat.workBufferUpdate = pc.WORKBUFFER_UPDATE_ONCE; }

    /** Set the camera: position, axes to the right, down and ahead, focal length and size in pixels. */
    look(eye, [right, down, ahead], focal, size) {
      this.size = size;
      this.share('uEye', eye);
      this.share('uAhead', ahead);
      this.share('uFocal', focal);
      this.set('uRight', right);
      this.set('uDown', down);
      this.level();
      this.fill();
      this.tinted();
    }

    /** Pass the height of the floor, if there is one, to the shader. */
    level() { this.set('uFloor', [this.height === null ? 0 : 1, this.height ?? 0, ...this.size]); }
  }

  return Stage;
})();
