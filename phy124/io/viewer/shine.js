/* Highlights and reflections on fluids and metal, computed for each camera by the shader that reads the
 * Gaussians. The code is a translation of `reflect` in phy124/rendering/shine.py. The header of a pack states
 * which Gaussians shine, and how. The normal of a Gaussian is its shortest axis. A fluid's surface consists of
 * discs whose z axis points outwards; the surface of metal consists of Gaussians that are seen from both sides.
 */
'use strict';
globalThis.Phy124Shine = (() => {
  const PLAIN = 'vec4 getColor() { return loadPhyColour(); }';

  /** Return the shader. Packs of older versions lack the last number of each gloss, and the refraction. */
  const lit = ({ lamp, refraction = 1.33, laws }) => `
    uniform vec3 uSeenFrom;
    struct Gloss { float least, most, tint, highlight, sharpness, ground, glow; bool outwards; };

    Gloss glossOf(int law) {
      ${laws.map(({ gloss, outwards }, k) => `if (law == ${k + 1}) return Gloss(${[...gloss, 0].slice(0, 7).map((v) => v.toFixed(4))}, ${outwards});`).join('\n')}
      return Gloss(0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, false);
    }

    /** The shortest axis; zero for the balls of a fluid, which are below its surface. */
    vec3 normalOf(vec3 scale, vec4 q, bool outwards) {
      if (outwards && scale.z > 0.6 * min(scale.x, scale.y)) return vec3(0.0);
      vec3 axis = scale.z <= min(scale.x, scale.y) ? vec3(0.0, 0.0, 1.0)
        : scale.y <= scale.x ? vec3(0.0, 1.0, 0.0) : vec3(1.0, 0.0, 0.0);
      return axis + 2.0 * cross(q.yzw, cross(q.yzw, axis) + q.x * axis);
    }

    vec4 getColor() {
      vec4 colour = loadPhyColour(), centre = loadPhyCentre();
      int law = int(centre.w + 0.5);
      if (law == 0) return colour;
      Gloss gloss = glossOf(law);
      vec3 towards = normalize(uSeenFrom - centre.xyz);
      vec3 n = normalOf(loadPhyScale().xyz, loadPhyRotation(), gloss.outwards);
      float along = dot(n, towards);
      if (along < 0.0 && !gloss.outwards) { n = -n; along = -along; }
      if (along <= 0.0) return colour;
      float grazing = 1.0 - min(along, 1.0), g = grazing * grazing;
      float amount = gloss.least + (gloss.most - gloss.least) * g * g * grazing;
      float sky = mix(gloss.ground, 1.0, smoothstep(-0.35, 0.75, 2.0 * along * n.z - towards.z));
      vec3 lamp = vec3(${lamp.map((v) => v.toFixed(4))});
      float light = pow(max(dot(n, normalize(towards + lamp)), 0.0), gloss.sharpness);
      float k = ${(1 / refraction).toFixed(6)}, into = sqrt(1.0 - (1.0 - along * along) * k * k);
      float through = max(-dot((along * k - into) * n - towards * k, lamp), 0.0);
      colour.rgb *= 1.0 - gloss.glow / 3.0 + gloss.glow * through * through * through;
      vec3 seen = 1.15 * gloss.tint * sky * colour.rgb + (1.0 - gloss.tint) * mix(colour.rgb, vec3(1.0), sky);
      colour.rgb = clamp(mix(colour.rgb, seen, amount) + gloss.highlight * light, 0.0, 1.0);
      return colour;
    }`;

  /** Return the shader code that reads the colour of a splat. */
  const reads = (shine) => (shine ? lit(shine) : PLAIN);

  /** Return the number of each splat's law, from 1; 0 for splats that do not shine. */
  function laws({ n, shine }) {
    const found = new Uint8Array(n);
    if (shine) shine.laws.forEach(({ runs }, k) => runs.forEach(([first, end]) => found.fill(k + 1, first, end)));
    return found;
  }

  return { reads, laws };
})();
