// Transfers of a liquid in float32. Rows of four cells along z, with three low faces and the centre
// of each cell, fill one AVX-512 or two AVX2 registers. Sums of eight numbers per cell fill twice
// as many registers. The weights of faces and centres differ only by a shift of half a cell.
// Python version: `scatter`, `scatter_volume`, `gather` and `flow` of liquid/transfer.py.
// Test: tests/test_liquid.py, test_simd_and_plain_transfers_agree.

typedef float Row __attribute__((vector_size(64), aligned(4)));
typedef float Half __attribute__((vector_size(32), aligned(4)));
typedef float Quad __attribute__((vector_size(16), aligned(4)));
const long along_y = size[2], along_x = along_y * size[1];
// Weights of four cells for their centres, low faces and linear functions.
struct Weights { float c[4], f[4], h[4]; };
const auto weigh = [](float t) {
    const float a = 1.0f - t, b = t - 0.5f, g = b < 0.0f ? t : t - 1.0f;
    const float s0 = 0.5f * (0.5f - g) * (0.5f - g), s1 = 0.75f - g * g;
    const float s2 = 0.5f * (0.5f + g) * (0.5f + g);
    Weights w = {{0.5f * a * a, 0.75f - b * b, 0.5f * t * t, 0.0f}};
    if (b < 0.0f) {
        w.f[0] = s0, w.f[1] = s1, w.f[2] = s2, w.f[3] = 0.0f;
        w.h[0] = -b, w.h[1] = 1.0f + b, w.h[2] = 0.0f, w.h[3] = 0.0f;
    } else {
        w.f[0] = 0.0f, w.f[1] = s0, w.f[2] = s1, w.f[3] = s2;
        w.h[0] = 0.0f, w.h[1] = 1.0f - b, w.h[2] = b, w.h[3] = 0.0f;
    }
    return w;
};
const Weights wx = weigh(t[0]), wy = weigh(t[1]), wz = weigh(t[2]);

//: scatter
#define TWICE(a) __builtin_shufflevector(a, a, 0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7)
const auto spread = [](const Weights& w, int k, int axis) {
    const float c = w.c[k], f = w.f[k];
    const float x = axis == 0 ? f : c, y = axis == 1 ? f : c, z = axis == 2 ? f : c;
    return Half{x, y, z, c, x, y, z, w.h[k]};
};
const Half start = {base[0], base[1], base[2], base[3], mass, mass, mass, base[3]};
const Half cx = {column_x[0], column_x[1], column_x[2]};
const Half cy = {column_y[0], column_y[1], column_y[2]};
const Half cz = {column_z[0], column_z[1], column_z[2]};
const Half z0 = spread(wz, 0, 2), z1 = spread(wz, 1, 2), z2 = spread(wz, 2, 2);
const Half z3 = spread(wz, 3, 2), b0 = z0 * start, b1 = z1 * (start + cz);
const Half b2 = z2 * (start + 2.0f * cz), b3 = z3 * (start + 3.0f * cz);
#define PAIR(a, b) __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
const Row lower = PAIR(z0, z1), upper = PAIR(z2, z3);
const Row x_lower = lower * TWICE(cx), x_upper = upper * TWICE(cx);
const Row y_lower = lower * TWICE(cy), y_upper = upper * TWICE(cy);
Row near_lower = PAIR(b0, b1), near_upper = PAIR(b2, b3);
Row across[4];
for (int j = 0; j < 4; ++j) { const Half w = spread(wy, j, 1); across[j] = TWICE(w); }
float* layer = (float*)cells.data + 8 * (long)first;
for (int i = 0; i < 4; ++i, layer += 8 * along_x) {
    const Half w = spread(wx, i, 0);
    const Row along = TWICE(w);
    Row low = near_lower, high = near_upper;
    float* row = layer;
    for (int j = 0; j < 4; ++j, row += 8 * along_y) {
        const Row both = along * across[j];
        *(Row*)row += both * low;
        *(Row*)(row + 16) += both * high;
        low += y_lower;
        high += y_upper;
    }
    near_lower += x_lower;
    near_upper += x_upper;
}

//: volume
const Half along = {wz.c[0], wz.h[0], wz.c[1], wz.h[1], wz.c[2], wz.h[2], 0.0f, 0.0f};
float* layer = (float*)fills.data + 2 * (long)first;
for (int i = 0; i < 3; ++i, layer += 2 * along_x) {
    const float c = volume * wx.c[i], h = volume * wx.h[i];
    for (int j = 0; j < 3; ++j) {
        const float cc = c * wy.c[j], hh = h * wy.h[j];
        *(Half*)(layer + 2 * j * along_y) += Half{cc, hh, cc, hh, cc, hh, cc, hh} * along;
    }
}

//: rows
const float* const start = (const float*)velocity.data + 4 * (long)first;
#define REPEAT(a) __builtin_shufflevector(a, a, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#define SUM(r) (__builtin_shufflevector(r, r, 0, 1, 2, 3) \
    + __builtin_shufflevector(r, r, 4, 5, 6, 7) + __builtin_shufflevector(r, r, 8, 9, 10, 11) \
    + __builtin_shufflevector(r, r, 12, 13, 14, 15))

//: gather
const Quad x[4] = {
    {wx.f[0], wx.c[0], wx.c[0], wx.c[0]}, {wx.f[1], wx.c[1], wx.c[1], wx.c[1]},
    {wx.f[2], wx.c[2], wx.c[2], wx.c[2]}, {wx.f[3]}};
const Quad y[4] = {
    {wy.c[0], wy.f[0], wy.c[0], wy.c[0]}, {wy.c[1], wy.f[1], wy.c[1], wy.c[1]},
    {wy.c[2], wy.f[2], wy.c[2], wy.c[2]}, {0.0f, wy.f[3]}};
const Row z = {
    wz.c[0], wz.c[0], wz.f[0], wz.c[0], wz.c[1], wz.c[1], wz.f[1], wz.c[1],
    wz.c[2], wz.c[2], wz.f[2], wz.c[2], 0.0f, 0.0f, wz.f[3], 0.0f};
const Row steps = {0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3};
Row mean = {}, by_x = {}, by_y = {};
const Row y0 = REPEAT(y[0]), y1 = REPEAT(y[1]), y2 = REPEAT(y[2]), y3 = REPEAT(y[3]);
for (int i = 0; i < 4; ++i) {
    const float* const layer = start + 4 * i * along_x;
    const Row r1 = y1 * *(const Row*)(layer + 4 * along_y);
    const Row r2 = y2 * *(const Row*)(layer + 8 * along_y);
    const Row r3 = y3 * *(const Row*)(layer + 12 * along_y);
    const Row along = REPEAT(x[i]), sum = along * (y0 * *(const Row*)layer + r1 + r2 + r3);
    mean += sum;
    by_x += (float)i * sum;
    by_y += along * (r1 + 2.0f * r2 + 3.0f * r3);
}
mean *= z;
by_x *= z;
by_y *= z;
const Row by_z = steps * mean;
const Quad s0 = SUM(mean), s1 = SUM(by_x), s2 = SUM(by_y), s3 = SUM(by_z);
return wp::mat_t<4, 4, wp::float32>(
    s0[0], s0[1], s0[2], s0[3], s1[0], s1[1], s1[2], s1[3],
    s2[0], s2[1], s2[2], s2[3], s3[0], s3[1], s3[2], s3[3]);

//: flow
// At its low faces a cell's linear weights are (0, 1 - t, t).
Row mean = {};
for (int i = 0; i < 3; ++i) {
    const float xf = i == 0 ? 0.0f : i == 1 ? 1.0f - t[0] : t[0];
    for (int j = 0; j < 3; ++j) {
        const float yf = j == 0 ? 0.0f : j == 1 ? 1.0f - t[1] : t[1];
        const Quad w = {xf * wy.h[j], wx.h[i] * yf, wx.h[i] * wy.h[j]};
        mean += REPEAT(w) * *(const Row*)(start + 4 * (i * along_x + j * along_y));
    }
}
const Row z = {
    wz.h[0], wz.h[0], 0.0f, 0.0f, wz.h[1], wz.h[1], 1.0f - t[2], 0.0f,
    wz.h[2], wz.h[2], t[2], 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
mean *= z;
const Quad s = SUM(mean);
return wp::vec_t<3, wp::float32>(s[0], s[1], s[2]);
