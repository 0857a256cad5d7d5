// The opacity of a solid of glass for sixteen rays at once. A ray that misses is computed as well,
// so that no loop over rays has a branch.
// Plain form: `veil` of splat/glass.py.
// Test: tests/test_stage.py, test_every_form_of_the_renderer_draws_the_same_stage.

struct Rays {
    float x[16], y[16], z[16];  // directions
    float limit[16];            // how far along them whatever is behind the glass is
    float pixel[16];            // size of a pixel at distance 1 along them [m]
};
struct Veil {
    float alpha[16];            // opacity before the limit
    int faces[16];              // which two faces a ray meets, away from their edges; or 0
};
const auto least = [](float a, float b) { return a < b ? a : b; };
const auto most = [](float a, float b) { return a > b ? a : b; };
const auto size_of = [](float a) { return a < 0.0f ? -a : a; };
const auto clamped = [](float a) { return a < 0.0f ? 0.0f : a > 1.0f ? 1.0f : a; };
// Is a rectangle of pixels' centres outside one of an outline's half planes?
const auto beside = [&](const auto& seen, float x, float y, float half_x, float half_y) {
    for (int k = 0; k < seen.count; ++k) {
        const float* side = seen.sides.data[k];
        const float reach = size_of(side[0]) * half_x + size_of(side[1]) * half_y;
        if (side[0] * x + side[1] * y + side[2] + reach < 0.0f) return true;
    }
    return false;
};

const auto box_veil = [&](const auto& solid, const Rays& rays, Veil& veil) {
    float o[3], half[3], m[3][3];
    for (int k = 0; k < 3; ++k) {
        o[k] = 0.0f;
        half[k] = solid.half[k];
        for (int c = 0; c < 3; ++c) {
            m[k][c] = solid.axes.data[k][c];
            o[k] += m[k][c] * (view.eye[c] - solid.centre[c]);
        }
    }
    const auto edge = [&](float t, float dx, float dy, float dz, float pixel) {
        const float a = size_of(half[0] - size_of(o[0] + t * dx));
        const float b = size_of(half[1] - size_of(o[1] + t * dy));
        const float c = size_of(half[2] - size_of(o[2] + t * dz));
        const float second = most(least(a, b), least(most(a, b), c));
        return clamped(1.0f - second / (WIDTH * pixel * t));
    };
    #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
    for (int i = 0; i < 16; ++i) {
        const float x = rays.x[i], y = rays.y[i], z = rays.z[i];
        const float limit = rays.limit[i], pixel = rays.pixel[i];
        const float dx = m[0][0] * x + m[0][1] * y + m[0][2] * z;
        const float dy = m[1][0] * x + m[1][1] * y + m[1][2] * z;
        const float dz = m[2][0] * x + m[2][1] * y + m[2][2] * z;
        const float px = 1.0f / (size_of(dx) < 1e-9f ? 1e-9f : dx);
        const float py = 1.0f / (size_of(dy) < 1e-9f ? 1e-9f : dy);
        const float pz = 1.0f / (size_of(dz) < 1e-9f ? 1e-9f : dz);
        // The middle of a slab, and half of what a ray crosses of it.
        const float mx = -o[0] * px, my = -o[1] * py, mz = -o[2] * pz;
        const float hx = half[0] * size_of(px), hy = half[1] * size_of(py);
        const float hz = half[2] * size_of(pz);
        const float enters = most(most(mx - hx, my - hy), mz - hz);
        const float leaves = least(least(mx + hx, my + hy), mz + hz);
        const bool hit = leaves > most(enters, 0.0f) && enters < limit;
        const float safe = leaves > 1e-9f ? leaves : 1e-9f;
        const bool outside = enters > 0.0f, above = leaves < NEARLY * limit;
        const float first = edge(outside ? enters : safe, dx, dy, dz, pixel);
        const float second = edge(safe, dx, dy, dz, pixel);
        const float clear = (outside ? 1.0f - FACE - (LINE - FACE) * first : 1.0f)
            * (above ? 1.0f - FACE - (LINE - FACE) * second : 1.0f);
        const float length = __builtin_elementwise_sqrt(x * x + y * y + z * z);
        const float chord = leaves - most(enters, 0.0f), least_chord = WIDTH * pixel * safe;
        veil.alpha[i] = hit ? (1.0f - clear) * least(chord * length / least_chord, 1.0f) : 0.0f;
        const int in = mx - hx == enters ? 1 : my - hy == enters ? 2 : 3;
        const int out = mx + hx == leaves ? (dx < 0.0f ? 4 : 8)
            : my + hy == leaves ? (dy < 0.0f ? 12 : 16) : (dz < 0.0f ? 20 : 24);
        const bool plain = hit && outside && chord >= least_chord && first == 0.0f
            && (second == 0.0f || !above);
        veil.faces[i] = plain ? in + out + (above ? 32 : 0) : 0;
    }
};

const auto capsule_veil = [&](const auto& solid, const Rays& rays, Veil& veil) {
    const float ax = solid.axes.data[0][0], ay = solid.axes.data[0][1];
    const float az = solid.axes.data[0][2], half = solid.half[0], radius = solid.radius;
    const float ox = view.eye[0] - solid.centre[0], oy = view.eye[1] - solid.centre[1];
    const float oz = view.eye[2] - solid.centre[2], start = ox * ax + oy * ay + oz * az;
    struct Span { float enters, leaves; };
    const auto ball = [&](float px, float py, float pz, float x, float y, float z) {
        const float a = x * x + y * y + z * z, middle = -(px * x + py * y + pz * z) / a;
        const float cx = px + middle * x, cy = py + middle * y, cz = pz + middle * z;
        const float rest = radius * radius - (cx * cx + cy * cy + cz * cz);
        const float reach = __builtin_elementwise_sqrt(most(rest, 0.0f) / a);
        Span span = {rest > 0.0f ? middle - reach : 1.0f, rest > 0.0f ? middle + reach : -1.0f};
        return span;
    };
    const auto joined = [&](Span a, Span b) {
        const bool first = a.leaves >= a.enters, second = b.leaves >= b.enters;
        const float low = least(a.enters, b.enters), high = most(a.leaves, b.leaves);
        Span span = {first && second ? low : first ? a.enters : b.enters,
            first && second ? high : first ? a.leaves : b.leaves};
        return span;
    };
    const auto rim = [&](float t, float x, float y, float z, float length) {
        const float px = ox + t * x, py = oy + t * y, pz = oz + t * z;
        const float along = px * ax + py * ay + pz * az;
        const float near = along < -half ? -half : along > half ? half : along;
        const float tx = px - near * ax, ty = py - near * ay, tz = pz - near * az;
        const float away = __builtin_elementwise_sqrt(tx * tx + ty * ty + tz * tz);
        const float grazing = 1.0f - size_of(tx * x + ty * y + tz * z) / (away * length);
        return 0.6f * FACE + (RIM - 0.6f * FACE) * grazing * grazing * grazing;
    };
    #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
    for (int i = 0; i < 16; ++i) {
        const float x = rays.x[i], y = rays.y[i], z = rays.z[i], limit = rays.limit[i];
        const Span one = ball(ox + half * ax, oy + half * ay, oz + half * az, x, y, z);
        const Span other = ball(ox - half * ax, oy - half * ay, oz - half * az, x, y, z);
        const float along = x * ax + y * ay + z * az;
        const float wx = x - along * ax, wy = y - along * ay, wz = z - along * az;
        const bool across = half > 0.0f && wx * wx + wy * wy + wz * wz > 1e-12f;
        const Span disc = ball(ox - start * ax, oy - start * ay, oz - start * az,
            across ? wx : 1.0f, across ? wy : 0.0f, across ? wz : 0.0f);
        const float step = 1.0f / (size_of(along) < 1e-9f ? 1e-9f : along);
        const float middle = -start * step, reach = half * size_of(step);
        const float low = most(disc.enters, middle - reach);
        const float high = least(disc.leaves, middle + reach);
        const bool tube = across && high > low;
        const Span part = {tube ? low : 1.0f, tube ? high : -1.0f};
        const Span span = joined(joined(one, other), part);
        const float enters = span.enters, leaves = span.leaves;
        const bool hit = leaves > most(enters, 0.0f) && enters < limit;
        const float length = __builtin_elementwise_sqrt(x * x + y * y + z * z);
        const float safe = leaves > 1e-9f ? leaves : 1e-9f;
        const float first = enters > 0.0f ? rim(enters, x, y, z, length) : 0.0f;
        const float second = leaves < NEARLY * limit ? rim(leaves, x, y, z, length) : 0.0f;
        const float chord = (leaves - most(enters, 0.0f)) * length;
        const float faded = least(chord / (WIDTH * rays.pixel[i] * safe), 1.0f);
        veil.alpha[i] = hit ? (1.0f - (1.0f - first) * (1.0f - second)) * faded : 0.0f;
        veil.faces[i] = 0;
    }
};

const auto veil_of = [&](const auto& solid, const Rays& rays, Veil& veil) {
    if (solid.radius > 0.0f) capsule_veil(solid, rays, veil);
    else box_veil(solid, rays, veil);
};
