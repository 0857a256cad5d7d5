// Scatter and gather in float32, one 64-byte row of three nodes at a time. Three nodes of four
// floats, and a fourth node of weight zero, fill one AVX-512 or two AVX2 registers. The grid is one
// node longer than its window, so that the last row can be read completely.
// Python version: `scatter` and `gather` of transfer.py.
// Test: tests/test_mpm.py, test_simd_rows_and_plain_loops_are_one_algorithm.

typedef float Row __attribute__((vector_size(64), aligned(4)));
typedef float Node __attribute__((vector_size(16), aligned(4)));
#define REPEAT(a) __builtin_shufflevector(a, a, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3)
#define SUM(r) (__builtin_shufflevector(r, r, 0, 1, 2, 3) \
    + __builtin_shufflevector(r, r, 4, 5, 6, 7) + __builtin_shufflevector(r, r, 8, 9, 10, 11))
const float fx = f[0], fy = f[1], fz = f[2];
#define SPLINE(f) {0.5f*(1.5f-f)*(1.5f-f), 0.75f-(f-1.f)*(f-1.f), 0.5f*(f-0.5f)*(f-0.5f)}
const float wx[3] = SPLINE(fx), wy[3] = SPLINE(fy), wz[3] = SPLINE(fz);
const float w0 = wz[0], w1 = wz[1], w2 = wz[2], u2 = 2.f * w2;
const Row W = {w0, w0, w0, w0, w1, w1, w1, w1, w2, w2, w2, w2, 0.f, 0.f, 0.f, 0.f};
const Row K = {0.f, 0.f, 0.f, 0.f, w1, w1, w1, w1, u2, u2, u2, u2, 0.f, 0.f, 0.f, 0.f};
const long along_y = 4 * (long)size[2], along_x = along_y * size[1];
const long start = first[0] * along_x + first[1] * along_y + 4 * (long)first[2];

//: scatter
float* layer = (float*)grid.data + start;
const Node b = {base[0], base[1], base[2], base[3]};
const Node x = {column_x[0], column_x[1], column_x[2], 0.f};
const Node y = {column_y[0], column_y[1], column_y[2], 0.f};
const Node z = {column_z[0], column_z[1], column_z[2], 0.f};
const Row X = W * REPEAT(x), Y = W * REPEAT(y);
Row low = W * REPEAT(b) + K * REPEAT(z);
for (int i = 0; i < 3; ++i, layer += along_x, low += X) {
    const Row middle = low + Y, high = middle + Y;
    *(Row*)layer += (wx[i] * wy[0]) * low;
    *(Row*)(layer + along_y) += (wx[i] * wy[1]) * middle;
    *(Row*)(layer + 2 * along_y) += (wx[i] * wy[2]) * high;
}

//: gather
const float* layer = (const float*)grid.data + start;
Row sum[3], rise[3];
for (int i = 0; i < 3; ++i, layer += along_x) {
    const Row low = *(const Row*)layer, middle = *(const Row*)(layer + along_y);
    const Row high = *(const Row*)(layer + 2 * along_y);
    sum[i] = wy[0] * low + wy[1] * middle + wy[2] * high;
    rise[i] = wy[1] * middle + (2.f * wy[2]) * high;
}
const Row mean = wx[0] * sum[0] + wx[1] * sum[1] + wx[2] * sum[2];
const Row by_x = wx[1] * sum[1] + (2.f * wx[2]) * sum[2];
const Row by_y = wx[0] * rise[0] + wx[1] * rise[1] + wx[2] * rise[2];
const Row r0 = W * mean, r1 = W * by_x, r2 = W * by_y, r3 = K * mean;
const Node s0 = SUM(r0), s1 = SUM(r1), s2 = SUM(r2), s3 = SUM(r3);
return wp::mat_t<4, 4, wp::float32>(
    s0[0], s0[1], s0[2], s0[3], s1[0], s1[1], s1[2], s1[3],
    s2[0], s2[1], s2[2], s2[3], s3[0], s3[1], s3[2], s3[3]);
