// Adds sixteen Gaussians to the layers of a shadow, sixteen cells of a row at a time.
// Python version: `cover` of splat/shadow.py.
// Test: tests/test_stage_shadow.py, test_both_forms_of_the_kernel_cover_the_same_cells.

const int cells_x = layers_out.shape[1], cells_y = layers_out.shape[2];
const int plane = cells_x * cells_y, below_last = layers_out.shape[0] - 2;
const float extent = (float)(cells_x > cells_y ? cells_x : cells_y);
const float last = (float)(layers_out.shape[0] - 1);
const float end_x = (float)(cells_x - 1), end_y = (float)(cells_y - 1);
const float LARGEST = 3e38f;
const auto root = [](float a) { return __builtin_elementwise_sqrt(a); };
const auto least = [](float a, float b) { return a < b ? a : b; };
const float per_cell = 1.0f / cell, per_height = 1.0f / tallest;
const float widen = root(weight) * per_cell;
enum { NONE, POINT, DISC };
struct Cast {
    int kind[16], layer[16];
    float x[16], y[16], aa[16], bb[16], cc[16], area[16], opacity[16];
    float upper[16];     // the fraction of the depth that is added to the layer above
    int first[16];       // the first of a point's four cells
    float parts[4 * 16]; // the amounts added to these four cells
};
Cast made;
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
for (int i = 0; i < 16; ++i) {
    const float px = place[3 * i], py = place[3 * i + 1], pz = place[3 * i + 2];
    const float w = quat[4 * i], qx = quat[4 * i + 1];
    const float qy = quat[4 * i + 2], qz = quat[4 * i + 3];
    const float norm = w * w + qx * qx + qy * qy + qz * qz;
    const float s = norm > 0.0f ? 2.0f / norm : 0.0f;
    const float turned_x = s * (qx * qz - w * qy), turned_y = s * (qy * qz + w * qx);
    const float turned_z = 1.0f - s * (qx * qx + qy * qy);
    const float rx = widen * size[3 * i], ry = widen * size[3 * i + 1];
    const float rz = widen * size[3 * i + 2];
    const float ax = rx * (1.0f - s * (qy * qy + qz * qz) + slope[0] * turned_x);
    const float ay = ry * (s * (qx * qy - w * qz) + slope[0] * turned_y);
    const float az = rz * (s * (qx * qz + w * qy) + slope[0] * turned_z);
    const float bx = rx * (s * (qx * qy + w * qz) + slope[1] * turned_x);
    const float by = ry * (1.0f - s * (qx * qx + qz * qz) + slope[1] * turned_y);
    const float bz = rz * (s * (qy * qz - w * qx) + slope[1] * turned_z);
    const float aa = ax * ax + ay * ay + az * az, cc = bx * bx + by * by + bz * bz;
    // Lagrange's identity gives the determinant without cancellation.
    const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
    const float area = root(nx * nx + ny * ny + nz * nz);
    const float above = pz - origin[2], height = above > 0.0f ? above : 0.0f;
    const float level = last * root(height < tallest ? height * per_height : 1.0f);
    const float x = (px - origin[0] + height * slope[0]) * per_cell - 0.5f;
    const float y = (py - origin[1] + height * slope[1]) * per_cell - 0.5f;
    const float o = opaque[i] > 0.99f ? 0.99f : opaque[i];
    // Any comparison with NaN is false.
    const bool seen = o > 0.004f && pz > -LARGEST && pz < LARGEST && aa + cc < LARGEST
        && x > -extent && y > -extent && x < 2.0f * extent && y < 2.0f * extent;
    const bool narrow = (aa > cc ? aa : cc) < NARROW * NARROW;
    const bool point = narrow && x >= 0.0f && y >= 0.0f && x < end_x && y < end_y;
    const int up = seen ? (int)level : 0, layer = up < below_last ? up : below_last;
    const int row = point ? (int)x : 0, column = point ? (int)y : 0;
    const float u = x - (float)row, v = y - (float)column;
    const float amount = area * 6.2831853f * o
        * (1.0f + o * (0.25f + o * (0.1111f + o * (0.0625f + o * (0.04f + o * 0.12f)))));
    made.kind[i] = !seen ? NONE : point ? POINT : narrow ? NONE : DISC;
    made.layer[i] = layer;
    made.upper[i] = level - (float)layer;
    made.first[i] = row * cells_y + column;
    made.parts[4 * i] = amount * (1.0f - u) * (1.0f - v);
    made.parts[4 * i + 1] = amount * (1.0f - u) * v;
    made.parts[4 * i + 2] = amount * u * (1.0f - v);
    made.parts[4 * i + 3] = amount * u * v;
    made.x[i] = x;
    made.y[i] = y;
    made.aa[i] = aa;
    made.bb[i] = ax * bx + ay * by + az * bz;
    made.cc[i] = cc;
    made.area[i] = area;
    made.opacity[i] = o;
}

const auto add_four = [&](float* at, const float* parts, float some) {
    at[0] += some * parts[0];
    at[1] += some * parts[1];
    at[cells_y] += some * parts[2];
    at[cells_y + 1] += some * parts[3];
};
const auto add_point = [&](float* lower, float upper, int n) {
    float* at = lower + made.first[n];
    add_four(at, made.parts + 4 * n, 1.0f - upper);
    add_four(at + plane, made.parts + 4 * n, upper);
};

const float HALF_LOG2_E = 0.72134752f;
const auto add_disc = [&](float* lower, float upper, int n) {
    // A needle is widened to a fraction of a cell, as in project.py; its optical depth is reduced.
    const float area = made.area[n], aa = made.aa[n] + 0.1f, cc = made.cc[n] + 0.1f;
    const float det = area * area + 0.1f * (made.aa[n] + made.cc[n]) + 0.01f;
    if (!(det < LARGEST)) return;
    const float a = aa / det, b = made.bb[n] / det, c = cc / det;
    const float peak = made.opacity[n] * least(area / root(det), 1.0f);
    const float reach_x = least(REACH * root(aa), 2.0f * extent);
    const float reach_y = least(REACH * root(cc), 2.0f * extent);
    const float u0 = made.x[n], v0 = made.y[n];
    const auto first = [](float at) {
        return at > 0.0f ? (int)__builtin_elementwise_ceil(at) : 0;
    };
    const auto end = [&](float at) { return (int)least(at, extent); };
    const int stop_x = end(u0 + reach_x + 1.0f), stop_y = end(v0 + reach_y + 1.0f);
    const int start_y = first(v0 - reach_y);
    for (int i = first(u0 - reach_x); i < stop_x && i < cells_x; ++i)
        for (int at = start_y; at < stop_y && at < cells_y; at += 16) {
            // Sixteen cells of a row; cells before `at` are already done.
            const int j = at + 16 < cells_y ? at : cells_y - 16;
            const float u = (float)i - u0;
            float* low = lower + i * cells_y + j;
            float* high = low + plane;
            #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
            for (int k = 0; k < 16; ++k) {
                const float v = (float)(j + k) - v0;
                const float power = -HALF_LOG2_E
                    * (c * u * u - 2.0f * b * u * v + a * v * v);
                const float alpha = peak * power_of_2(power > -60.0f ? power : -60.0f);
                const bool inside = j + k >= at && j + k < stop_y;
                const float depth = inside ? -logarithm(1.0f - alpha) : 0.0f;
                low[k] += (1.0f - upper) * depth;
                high[k] += upper * depth;
            }
        }
};

for (int i = 0; i < count; ++i) {
    float* lower = layers_out.data + made.layer[i] * plane;
    if (made.kind[i] == POINT) add_point(lower, made.upper[i], i);
    else if (made.kind[i] == DISC) add_disc(lower, made.upper[i], i);
}
