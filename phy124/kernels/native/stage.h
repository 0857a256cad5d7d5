// Draws the surroundings of a tile around its Gaussians, before the Gaussians are stored. If the
// same two faces of a box are visible at all corners of a tile, away from the box's edges, they are
// visible in the whole tile, because faces are convex. The box then has one opacity over the tile.
// Python version: `draw_setting` and `tint_splats` of splat/stage.py.
// Test: tests/test_stage.py, test_every_form_of_the_renderer_draws_the_same_stage.

typedef float Row __attribute__((vector_size(64), aligned(4)));
// Transmittance of the Gaussians; a transmittance below one grey level of a byte is ignored.
const Row none = {0.0f};
Row open[16], widest = none;
for (int y = 0; y < 16; ++y) {
    const Row t = *(const Row*)(T + 16 * y), rest = t < none ? -t : t;
    open[y] = rest > 1e-3f ? rest : none;
    widest = open[y] > widest ? open[y] : widest;
}
const float most_open = __builtin_reduce_max(widest);
if (most_open == 0.0f && before == 0) return;

const float step = 1.0f / view.focal, above = view.eye[2] - setting.height;
const bool floored = setting.floor == 1 && above > 0.0f;
const auto& turn = view.rotation.data;
const auto aim = [&](Rays& rays, const float* xs, const float* ys) {
    #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
    for (int i = 0; i < 16; ++i) {
        const float u = (xs[i] - view.centre[0]) * step, v = (ys[i] - view.centre[1]) * step;
        rays.x[i] = turn[0][0] * u + turn[1][0] * v + turn[2][0];
        rays.y[i] = turn[0][1] * u + turn[1][1] * v + turn[2][1];
        const float z = turn[0][2] * u + turn[1][2] * v + turn[2][2];
        rays.z[i] = z;
        rays.limit[i] = floored && z < 0.0f ? -above / (z < -1e-12f ? z : -1e-12f) : 1e30f;
        rays.pixel[i] = step;
    }
};
float xs[16], ys[16];
Rays rays;

Row clear[16], lens[16];  // transmittance of all solids, and of those in front of the Gaussians
bool laid = false, glazed = false;
const float middle_x = 0.5f * (float)(left + right), middle_y = 0.5f * (float)(top + bottom);
const float half_x = 0.5f * (float)(count - 1), half_y = 0.5f * (float)(rows - 1);
const int shown = most_open == 0.0f ? before : solids.shape[0];
for (int k = 0; k < shown; ++k) {
    if (glazed && k == before) for (int y = 0; y < 16; ++y) lens[y] = clear[y];
    if (beside(outlines.data[k], middle_x, middle_y, half_x, half_y)) continue;
    if (!glazed) for (int y = 0; y < 16; ++y) clear[y] = lens[y] = none + 1.0f;
    glazed = true;
    laid = laid || k < before;
    Veil veil;
    for (int i = 0; i < 16; ++i) {
        xs[i] = middle_x + (i & 1 ? half_x : -half_x);
        ys[i] = middle_y + (i & 2 ? half_y : -half_y);
    }
    aim(rays, xs, ys);
    veil_of(solids.data[k], rays, veil);
    int faces = veil.faces[0];
    for (int i = 1; i < 4; ++i) faces = veil.faces[i] == faces ? faces : 0;
    for (int i = 0; i < 16; ++i) xs[i] = (float)(left + i) + 0.5f;
    for (int y = 0; y < rows; ++y) {
        if (faces) {
            clear[y] *= 1.0f - veil.alpha[0];
            continue;
        }
        const float at = (float)(top + y) + 0.5f;
        if (beside(outlines.data[k], middle_x, at, half_x, 0.0f)) continue;
        for (int i = 0; i < 16; ++i) ys[i] = at;
        aim(rays, xs, ys);
        veil_of(solids.data[k], rays, veil);
        clear[y] *= 1.0f - *(const Row*)veil.alpha;
    }
}
if (glazed && shown == before) for (int y = 0; y < 16; ++y) lens[y] = clear[y];
if (most_open == 0.0f && !laid) return;

const unsigned short* __restrict shades = shade.data;
typedef unsigned Pair __attribute__((aligned(2)));
const int cells = setting.cells;
const float last = (float)(cells - 1), nearer = 1.0f / setting.reach;
const float scale = 0.5f * (float)cells * nearer, middle = 0.5f * last;
const float ex = view.eye[0] - setting.middle[0], ey = view.eye[1] - setting.middle[1];
// The shadow lies between the centres of these cells, which have no shadow.
const float first_i = (float)setting.shaded[0] - 1.0f, end_i = (float)setting.shaded[1] + 1.0f;
const float first_j = (float)setting.shaded[2] - 1.0f, end_j = (float)setting.shaded[3] + 1.0f;
// Directions of a row's rays, without the term from the row's height.
Row column;
for (int i = 0; i < 16; ++i) column[i] = ((float)(left + i) + 0.5f - view.centre[0]) * step;
const Row along_x = turn[0][0] * column + turn[2][0];
const Row along_y = turn[0][1] * column + turn[2][1];
const Row along_z = turn[0][2] * column + turn[2][2];
const auto look_up = [&](const float* at_i, const float* at_j, float* __restrict light) {
    #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
    for (int x = 0; x < 16; ++x) {
        const float u = at_i[x], v = at_j[x];
        const bool inside = u >= 0.0f && v >= 0.0f && u < last && v < last;
        const int i = inside ? (int)u : 0, j = inside ? (int)v : 0, cell = i * cells + j;
        const float a = u - (float)i, b = v - (float)j;
        // Two neighbouring cells are read in one access, since reading takes most of the time in
        // this loop.
        const unsigned near = *(const Pair*)(shades + cell);
        const unsigned far = *(const Pair*)(shades + (cell + cells));
        const float p = (float)(int)(near & 0xffff), q = (float)(int)(near >> 16);
        const float one = p + a * ((float)(int)(far & 0xffff) - p);
        const float two = q + a * ((float)(int)(far >> 16) - q);
        light[x] = inside ? 1.0f - (one + b * (two - one)) * (1.0f / 65535.0f) : 1.0f;
    }
};
// Fraction of the backdrop's light after the floor's shadow, and light spot on the floor.
const auto shine = [&](float at, Row& light, Row& pool) {
    const float v = (at - view.centre[1]) * step;
    const Row z = along_z + turn[1][2] * v;
    light = none + 1.0f;
    pool = none;
    if (!floored || (z[0] >= 0.0f && z[15] >= 0.0f)) return;
    const Row limit = -above / (z < -1e-12f ? z : none - 1e-12f);
    const Row x = ex + limit * (along_x + turn[1][0] * v);
    const Row y = ey + limit * (along_y + turn[1][1] * v);
    const Row rest = z < none ? 1.0f - (0.5f * nearer * nearer) * (x * x + y * y) : none;
    pool = rest > none ? setting.pool * rest * rest : none;
    const Row at_i = z < none ? x * scale + middle : none - 2.0f;
    const Row at_j = z < none ? y * scale + middle : none - 2.0f;
    const auto outside = [&](const Row& at, float low, float high) {
        return (at[0] < low && at[15] < low) || (at[0] > high && at[15] > high);
    };
    if (outside(at_i, first_i, end_i) || outside(at_j, first_j, end_j)) return;
    look_up((const float*)&at_i, (const float*)&at_j, (float*)&light);
};

const bool pictured = picture.shape[0] > 0;
Row* const lights[3] = {(Row*)R, (Row*)G, (Row*)B};
const float per_row = 1.0f / (float)view.height;
for (int y = 0; y < rows; ++y) {
    const float at = (float)(top + y) + 0.5f, down = at * per_row;
    Row light = none, pool = none;
    if (most_open > 0.0f) shine(at, light, pool);
    Row seen = open[y] * light, dull = none;
    if (glazed) {
        seen *= clear[y];
        dull = open[y] * (1.0f - clear[y]) + (1.0f - open[y]) * (1.0f - lens[y]);
    }
    const Row added = seen * pool;
    #pragma clang loop unroll(full)
    for (int c = 0; c < 3; ++c) {
        Row& drawn = lights[c][y];
        if (glazed) drawn = lens[y] * drawn + dull * TINT[c];
        if (pictured) {
            const auto* photo = picture.data + (top + y) * view.width + left;
            Row behind = none;
            for (int x = 0; x < count; ++x) behind[x] = photo[x][c];
            drawn += seen * behind + added * behind * (1.0f - behind);
        } else {
            const float behind = setting.top[c] + down * (setting.bottom[c] - setting.top[c]);
            drawn += seen * behind + added * (behind * (1.0f - behind));
        }
    }
}


//: tint
typedef float Row __attribute__((vector_size(64), aligned(4)));
const int begin = 16 * thread, total = means.shape[0];
const int count = begin + 16 < total ? 16 : total - begin;
const auto& turn = view.rotation.data;
Rays rays;
const float* place = (const float*)(means.data + begin);
float spare[48];
for (int k = 0; k < 48 && count < 16; ++k) spare[k] = place[k < 3 * count ? k : k % 3];
if (count < 16) place = spare;
const float step = 1.0f / view.focal;
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
for (int i = 0; i < 16; ++i) {
    const float x = place[3 * i] - view.eye[0], y = place[3 * i + 1] - view.eye[1];
    const float z = place[3 * i + 2] - view.eye[2];
    const float depth = turn[2][0] * x + turn[2][1] * y + turn[2][2] * z;
    rays.x[i] = x;
    rays.y[i] = y;
    rays.z[i] = z;
    rays.limit[i] = 1.0f;
    rays.pixel[i] = depth * step;
}
const Row x = *(const Row*)rays.x, y = *(const Row*)rays.y, z = *(const Row*)rays.z;
Row clear = x * 0.0f + 1.0f;
bool glazed = false;
for (int k = first; k < last; ++k) {
    const auto& outline = outlines.data[k];
    auto within = *(const Row*)rays.pixel >= outline.nearest * step;
    for (int n = 0; n < outline.count; ++n) {
        const float* plane = outline.planes.data[n];
        within &= plane[0] * x + plane[1] * y + plane[2] * z >= 0.0f;
    }
    if (!__builtin_reduce_or(within)) continue;
    Veil veil;
    veil_of(solids.data[k], rays, veil);
    clear *= 1.0f - *(const Row*)veil.alpha;
    glazed = true;
}
for (int i = 0; i < count && glazed; ++i)
    if (clear[i] < 1.0f)
        for (int c = 0; c < 3; ++c) {
            float& colour = splats_out.data[begin + i].colour[c];
            colour = clear[i] * colour + (1.0f - clear[i]) * TINT[c];
        }

//: veil
// The opacity of a glass solid for sixteen rays. Rays that miss are computed as well, so that no
// loop over rays has a branch.
// Python version: `veil` of splat/glass.py.
// Test: tests/test_stage.py, test_every_form_of_the_renderer_draws_the_same_stage.

struct Rays {
    float x[16], y[16], z[16];  // directions
    float limit[16];            // distance along the rays to the surface behind the glass
    float pixel[16];            // size of a pixel at distance 1 along the rays [m]
};
struct Veil {
    float alpha[16];            // opacity before the limit
    int faces[16];              // the two faces that a ray meets away from their edges; otherwise 0
};
const auto least = [](float a, float b) { return a < b ? a : b; };
const auto most = [](float a, float b) { return a > b ? a : b; };
const auto size_of = [](float a) { return a < 0.0f ? -a : a; };
const auto clamped = [](float a) { return a < 0.0f ? 0.0f : a > 1.0f ? 1.0f : a; };
// Returns whether a rectangle of pixel centres is outside one of an outline's half planes.
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
        // The middle of a slab, and half of the ray's path through the slab.
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
