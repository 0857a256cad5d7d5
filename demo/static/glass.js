/* Draws the walls of a live run as glass: boxes and capsules that move without turning.
 *
 *   const glass = new Phy124Glass(gl, walls); glass.sort(eye, box, moved); glass.draw(camera, 'behind');
 *
 * Solids behind the object are drawn before its Gaussians, and solids in front of it after them. If a
 * solid encloses the object, faces that are turned away are drawn before, and all other faces after.
 */
'use strict';
globalThis.Phy124Glass = (() => {
  const RINGS = 9, SIDES = 32, FLOATS = 8, THIN = 0.2, GIVE = 0.3;

  const VERTEX = `#version 300 es
    layout(location = 0) in vec3 aAt;
    layout(location = 1) in vec3 aNormal;
    layout(location = 2) in vec2 aFace;
    uniform mat3 uAxes;
    uniform vec3 uEye, uMoved;
    uniform float uFocal;
    uniform vec2 uSize;
    out vec3 at, normal;
    out vec2 face;
    void main() {
      at = aAt + uMoved;
      normal = aNormal;
      face = aFace;
      vec3 t = (at - uEye) * uAxes;
      gl_Position = vec4(2.0 * uFocal * t.xy / uSize, t.z - 0.1, t.z);
    }`;

  const FRAGMENT = `#version 300 es
    precision highp float;
    uniform vec3 uEye;
    uniform float uGround;
    in vec3 at, normal;
    in vec2 face;
    out vec4 seen;
    const float FACE = 0.10, LINE = 0.45, RIM = 0.50, WIDTH = 1.5;
    void main() {
      if (at.z < uGround) discard;
      vec2 pixels = min(face, 1.0 - face) / max(fwidth(face), vec2(1e-6));
      float opacity = FACE + (LINE - FACE) * clamp(1.0 - min(pixels.x, pixels.y) / WIDTH, 0.0, 1.0);
      if (face.x < 0.0) {
        float grazing = 1.0 - abs(dot(normalize(normal), normalize(at - uEye)));
        opacity = 0.6 * FACE + (RIM - 0.6 * FACE) * grazing * grazing * grazing;
      }
      seen = vec4(vec3(0.36, 0.44, 0.52) * opacity, opacity);
    }`;

  const sum = (a, b) => a.map((v, c) => v + b[c]);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

  /** Convert a position along the axes of a solid to a position in the world. */
  const along = ({ axes }, [a, b, c]) => [0, 1, 2].map((k) => a * axes[0][k] + b * axes[1][k] + c * axes[2][k]);

  /** Return the triangles of a box, counter-clockwise when seen from outside. */
  function box(solid) {
    const made = [];
    for (const axis of [0, 1, 2]) for (const side of [1, -1]) {
      const corner = (u, v) => {
        const place = [0, 0, 0];
        place[axis] = side; place[(axis + 1) % 3] = 2 * u - 1; place[(axis + 2) % 3] = 2 * v - 1;
        return [...sum(solid.centre, along(solid, place.map((p, c) => p * solid.half[c]))), ...along(solid, [0, 1, 2].map((c) => (c === axis ? side : 0))), u, v];
      };
      const four = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)], turn = side > 0 ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2];
      for (const k of turn) made.push(...four[k]);
    }
    return made;
  }

  /** Return the triangles of a capsule along its first axis; a ball is a capsule of length 0. */
  function capsule(solid) {
    const rings = [];
    for (const end of [-1, 1]) for (let r = 0; r < RINGS; r++) {
      const tilt = Math.PI / 2 * (end > 0 ? r : r - RINGS + 1) / (RINGS - 1), ring = [];
      for (let s = 0; s <= SIDES; s++) {
        const turn = 2 * Math.PI * s / SIDES, normal = [Math.sin(tilt), Math.cos(tilt) * Math.cos(turn), Math.cos(tilt) * Math.sin(turn)];
        const place = normal.map((n, c) => n * solid.radius + (c ? 0 : end * solid.half[0]));
        ring.push([...sum(solid.centre, along(solid, place)), ...along(solid, normal), -1, -1]);
      }
      rings.push(ring);
    }
    const made = [];
    for (let r = 1; r < rings.length; r++) for (let s = 1; s <= SIDES; s++) {
      const [a, b, c, d] = [rings[r - 1][s - 1], rings[r - 1][s], rings[r][s], rings[r][s - 1]];
      made.push(...a, ...b, ...c, ...a, ...c, ...d);
    }
    return made;
  }

  /** Return whether a solid is 'behind', 'among' or 'before' (in front of) the content of a box, as seen by the eye. */
  function place(solid, moved, eye, [low, high]) {
    const sizes = solid.half.map((h) => h + solid.radius), widest = Math.max(...sizes), centre = sum(solid.centre, moved);
    const towards = low.map((v, c) => (v + high[c]) / 2 - centre[c]), half = low.map((v, c) => (high[c] - v) / 2), view = eye.map((v, c) => v - centre[c]);
    let found = 'among';
    for (const [k, axis] of solid.axes.entries()) {
      const way = dot(axis, towards), give = sizes[k] < THIN * widest ? 1 - GIVE : 1;
      if (Math.abs(way) - dot(axis.map(Math.abs), half) <= give * sizes[k]) continue;
      if (Math.sign(way) * dot(axis, view) > sizes[k]) return 'behind';
      found = 'before';
    }
    return found;
  }

  return class Glass {
    constructor(gl, walls, program) {
      Object.assign(this, { gl, program: program(gl, VERTEX, FRAGMENT) });
      const floats = [];
      this.solids = walls.map((wall) => {
        const triangles = wall.radius > 0 ? capsule(wall) : box(wall), first = floats.length / FLOATS;
        for (const value of triangles) floats.push(value);
        return { ...wall, first, count: triangles.length / FLOATS };
      });
      this.array = gl.createVertexArray();
      gl.bindVertexArray(this.array);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(floats), gl.STATIC_DRAW);
      for (const [at, size, from] of [[0, 3, 0], [1, 3, 3], [2, 2, 6]]) {
        gl.enableVertexAttribArray(at);
        gl.vertexAttribPointer(at, size, gl.FLOAT, false, 4 * FLOATS, 4 * from);
      }
      gl.bindVertexArray(null);
    }

    /** Sort the solids: behind, among and in front of the Gaussians; skip absent solids (displacement NaN). */
    sort(eye, box, moved) {
      this.here = this.solids.flatMap((solid, k) => {
        const by = [...moved.subarray(3 * k, 3 * k + 3)];
        return by.some(Number.isNaN) ? [] : [{ ...solid, by, where: place(solid, by, eye, box) }];
      });
    }

    /** Draw the solids that are 'behind' or 'before' (in front of) the Gaussians. */
    draw(camera, where, ground) {
      const { gl, program } = this, shown = this.here.filter((solid) => solid.where === where || solid.where === 'among');
      if (!shown.length) return;
      gl.useProgram(program.made);
      camera(program);
      gl.uniform1f(program.at('uGround'), ground);
      gl.bindVertexArray(this.array);
      for (const solid of shown) {
        if (solid.where === 'among') { gl.enable(gl.CULL_FACE); gl.cullFace(where === 'behind' ? gl.FRONT : gl.BACK); } else gl.disable(gl.CULL_FACE);
        gl.uniform3fv(program.at('uMoved'), solid.by);
        gl.drawArrays(gl.TRIANGLES, solid.first, solid.count);
      }
      gl.disable(gl.CULL_FACE);
      gl.bindVertexArray(null);
    }
  };
})();
