/* Draws Gaussians that move in every frame. The shader receives their covariances, so that
 * no axes must be computed. Quads are not instanced, because software WebGL would draw instances one by one.
 *
 *   const splats = new Phy124Splats(canvas, lattice); splats.look(pose); splats.draw(count);
 */
'use strict';
globalThis.Phy124Splats = (() => {
  const ROW = 256, TEXELS = 3, KEYS = 4096, NEAR = 0.05, REACH = 2.8, GROWN = 0.9;

  const SPLATS = `#version 300 es
    uniform highp usampler2D uData;
    uniform mat3 uAxes;      // rows: right, up, ahead
    uniform vec3 uEye;
    uniform float uFocal, uGrown;
    uniform vec2 uSize;
    out vec2 at;
    out vec4 colour;
    void main() {
      int k = gl_VertexID >> 2;
      ivec2 place = ivec2(${TEXELS} * (k & ${ROW - 1}), k / ${ROW});
      uvec4 one = texelFetch(uData, place, 0), two = texelFetch(uData, place + ivec2(1, 0), 0), three = texelFetch(uData, place + ivec2(2, 0), 0);
      vec3 centre = uintBitsToFloat(one.xyz), t = (centre - uEye) * uAxes;
      float xx = uintBitsToFloat(one.w);
      vec4 more = uintBitsToFloat(two);
      float zz = uintBitsToFloat(three.x);
      mat3 sigma = uGrown * mat3(xx, more.x, more.y, more.x, more.z, more.w, more.y, more.w, zz);
      colour = vec4(uvec4(three.y, three.y >> 8, three.y >> 16, three.y >> 24) & 255u) / 255.0;
      // Rows of the projection's derivative, in the world's axes.
      vec3 right = uFocal / t.z * (uAxes[0] - t.x / t.z * uAxes[2]), up = uFocal / t.z * (uAxes[1] - t.y / t.z * uAxes[2]);
      float a = dot(right, sigma * right) + 0.3, b = dot(right, sigma * up), c = dot(up, sigma * up) + 0.3;
      float middle = 0.5 * (a + c), apart = sqrt(max(0.25 * (a - c) * (a - c) + b * b, 1e-8));
      vec2 axis = abs(b) > 1e-6 ? normalize(vec2(b, middle + apart - a)) : (a >= c ? vec2(1.0, 0.0) : vec2(0.0, 1.0));
      vec2 corner = vec2(gl_VertexID & 1, (gl_VertexID >> 1) & 1) * 2.0 - 1.0;
      float reach = min(sqrt(2.0 * log(255.0 * max(colour.a, 1.0 / 255.0))), ${REACH});
      at = reach * corner;
      vec2 pixel = at.x * sqrt(middle + apart) * axis + at.y * sqrt(max(middle - apart, 0.1)) * vec2(-axis.y, axis.x);
      gl_Position = t.z < ${NEAR} ? vec4(2.0, 2.0, 2.0, 1.0) : vec4((uFocal * t.xy / t.z + pixel) / (0.5 * uSize), 0.0, 1.0);
    }`;

  const COVER = `#version 300 es
    precision mediump float;
    in vec2 at;
    in vec4 colour;
    out vec4 seen;
    void main() {
      float alpha = min(colour.a * exp(-0.5 * dot(at, at)), 0.99);
      if (alpha < 1.0 / 255.0) discard;
      seen = vec4(colour.rgb * alpha, alpha);
    }`;

  const ALL = `#version 300 es
    void main() { gl_Position = vec4(vec2((gl_VertexID & 1) * 4, (gl_VertexID >> 1) * 4) - 1.0, 0.0, 1.0); }`;

  const GROUND = `#version 300 es
    precision highp float;
    uniform mat3 uAxes;
    uniform vec3 uEye, uBack, uSpread, uHand;
    uniform float uFocal, uGround, uLift, uCell, uHolds;
    uniform vec2 uSize, uMiddle;
    out vec4 seen;
    void main() {
      vec2 pixel = gl_FragCoord.xy - 0.5 * uSize;
      vec3 ray = uAxes * vec3(pixel, uFocal), colour = uBack * (1.0 - 0.06 * gl_FragCoord.y / uSize.y);
      float dark = dot(uBack, vec3(0.33)) < 0.4 ? 1.0 : -1.0;
      float t = (uGround - uEye.z) / ray.z;
      if (uGround > -1e8 && t > 0.0) {
        vec2 on = uEye.xy + t * ray.xy, cells = on / uCell, width = vec2(t / uCell * uFocal / max(-ray.z, 0.05 * uFocal));
        vec2 line = smoothstep(width * 1.5, vec2(0.0), abs(fract(cells - 0.5) - 0.5));
        float fade = exp(-dot(on - uMiddle, on - uMiddle) / (9.0 * uCell * uCell * 16.0));
        colour += dark * fade * (0.035 + 0.10 * max(line.x, line.y));
        vec2 away = on - uMiddle;
        float det = uSpread.x * uSpread.z - uSpread.y * uSpread.y;
        float far = (uSpread.z * away.x * away.x - 2.0 * uSpread.y * away.x * away.y + uSpread.x * away.y * away.y) / det;
        colour *= 1.0 - 0.45 / (1.0 + 5.0 * uLift) * exp(-0.35 * far);
      }
      seen = vec4(colour, 1.0);
    }`;

  function program(gl, vertex, fragment) {
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
    const names = new Map();
    return { made, at: (name) => { if (!names.has(name)) names.set(name, gl.getUniformLocation(made, name)); return names.get(name); } };
  }

  return class Splats {
    constructor(canvas, lattice) {
      Object.assign(this, { canvas, lattice, n: lattice.splats });
      const gl = this.gl = canvas.getContext('webgl2', { antialias: false, alpha: false, preserveDrawingBuffer: true });
      this.splats = program(gl, SPLATS, COVER);
      this.ground = program(gl, ALL, GROUND);
      this.glass = new Phy124Glass(gl, lattice.walls, program);
      this.rows = Math.ceil(this.n / ROW);
      this.data = new Uint32Array(4 * TEXELS * ROW * this.rows);
      this.floats = new Float32Array(this.data.buffer);
      this.colours = new Uint32Array(lattice.colours.slice().buffer);
      this.keys = new Uint16Array(this.n);
      this.texture = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, this.texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32UI, TEXELS * ROW, this.rows);
      for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, side, gl.NEAREST);
      const corners = new Uint32Array(6 * this.n);
      for (let i = 0; i < this.n; i++) corners.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i + 2, 4 * i + 1, 4 * i + 3], 6 * i);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    }

    /** Set the camera: azimuth, elevation [degrees], radius, target. */
    look({ azimuth, elevation, radius, target }, fov = 40) {
      const a = azimuth * Math.PI / 180, e = elevation * Math.PI / 180;
      const away = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
      this.eye = away.map((v, c) => target[c] + radius * v);
      this.right = [-Math.sin(a), Math.cos(a), 0];
      this.ahead = away.map((v) => -v);
      const [r, h] = [this.right, this.ahead];
      this.up = [r[1] * h[2] - r[2] * h[1], r[2] * h[0] - r[0] * h[2], r[0] * h[1] - r[1] * h[0]];
      this.fov = fov;
    }

    /** Return the focal length in pixels; the field of view refers to the smaller side of the picture. */
    get focal() { return Math.min(this.canvas.width, this.canvas.height) / 2 / Math.tan(this.fov * Math.PI / 360); }

    /** Convert a position in the world to coordinates right of, above and ahead of the eye. */
    seen(x, y, z) {
      const [dx, dy, dz] = [x - this.eye[0], y - this.eye[1], z - this.eye[2]];
      return [this.right, this.up, this.ahead].map((axis) => dx * axis[0] + dy * axis[1] + dz * axis[2]);
    }

    /** Sort the first `count` Gaussians from back to front, and write them into the texture's data. */
    fill(count) {
      const { lattice, keys, ahead, eye, floats, data, colours } = this, { centres, shapes } = lattice;
      let low = Infinity, high = -Infinity;
      const depths = this.depths || (this.depths = new Float32Array(this.n));
      for (let i = 0; i < count; i++) {
        const depth = (centres[3 * i] - eye[0]) * ahead[0] + (centres[3 * i + 1] - eye[1]) * ahead[1] + (centres[3 * i + 2] - eye[2]) * ahead[2];
        depths[i] = depth;
        if (depth < low) low = depth;
        if (depth > high) high = depth;
      }
      const counts = new Uint32Array(KEYS + 1), scale = (KEYS - 1) / Math.max(high - low, 1e-9);
      for (let i = 0; i < count; i++) { const key = keys[i] = ((high - depths[i]) * scale) | 0; counts[key + 1]++; }
      for (let k = 0; k < KEYS; k++) counts[k + 1] += counts[k];
      for (let i = 0; i < count; i++) {
        const o = 4 * TEXELS * counts[keys[i]]++;
        floats[o] = centres[3 * i]; floats[o + 1] = centres[3 * i + 1]; floats[o + 2] = centres[3 * i + 2];
        for (let k = 0; k < 6; k++) floats[o + 3 + k] = shapes[6 * i + k];
        data[o + 9] = colours[i];
      }
    }

    /** Return the factor by which covariances are enlarged if only some of the Gaussians are drawn. */
    grown(count) { return (this.n / count) ** GROWN; }

    draw(count) {
      const { gl } = this, { width, height } = this.canvas;
      this.fill(count);
      gl.viewport(0, 0, width, height);
      gl.disable(gl.BLEND);
      this.drawGround(width, height);
      gl.enable(gl.BLEND);
      this.glass.sort(this.eye, this.lattice.box, this.lattice.moved);
      this.drawGlass('behind', width, height);
      gl.useProgram(this.splats.made);
      this.camera(this.splats, width, height);
      gl.uniform1f(this.splats.at('uGrown'), this.grown(count));
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TEXELS * ROW, Math.ceil(count / ROW), gl.RGBA_INTEGER, gl.UNSIGNED_INT, this.data);
      gl.drawElements(gl.TRIANGLES, 6 * count, gl.UNSIGNED_INT, 0);
      this.drawGlass('before', width, height);
    }

    drawGlass(where, width, height) { this.glass.draw((program) => this.camera(program, width, height), where, this.lattice.ground ?? -1e9); }

    camera(program, width, height) {
      const { gl } = this;
      gl.uniformMatrix3fv(program.at('uAxes'), false, [...this.right, ...this.up, ...this.ahead]);
      gl.uniform3fv(program.at('uEye'), this.eye);
      gl.uniform1f(program.at('uFocal'), this.focal);
      gl.uniform2f(program.at('uSize'), width, height);
    }

    drawGround(width, height) {
      const { gl, ground, lattice } = this, { middle, spread, low } = lattice.shadow(), floor = lattice.ground ?? -1e9;
      gl.useProgram(ground.made);
      this.camera(ground, width, height);
      gl.uniform3fv(ground.at('uBack'), lattice.background);
      gl.uniform1f(ground.at('uGround'), floor);
      gl.uniform1f(ground.at('uLift'), Math.max(0, low - floor) / lattice.size);
      gl.uniform1f(ground.at('uCell'), lattice.size / 4);
      gl.uniform2fv(ground.at('uMiddle'), middle);
      gl.uniform3fv(ground.at('uSpread'), spread);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    dispose() { this.gl.getExtension('WEBGL_lose_context')?.loseContext(); }
  };
})();
