// Sums over the nodes of a surface point in float32. The nine numbers of three nodes in a row are
// consecutive in memory: eight of them fill the lanes of a register, and one remains.
// Python version: `moved_by`, `yielding` and `strike` of lattice/rows.py.
// Test: tests/test_lattice_kernels.py, test_simd_and_plain_contact_agree.

typedef float Eight __attribute__((vector_size(32), aligned(4)));
typedef float Three __attribute__((vector_size(16)));
#define EACH_TWICE(a) __builtin_shufflevector(a, a, 0, 0, 0, 1, 1, 1, 2, 2)
const int count = weights.shape[1] / 3;
const int* const node = (const int*)nodes.data + 3L * count * s;
const float* const weight = (const float*)weights.data + 3L * count * s;

//: moved
const float* const of = (const float*)values.data;
Eight sum = {}, other = {};
float last = 0.0f;
for (int r = 0; r < count; ++r) {
    const float* const a = of + 3L * node[3 * r];
    const float* const w = weight + 3 * r;
    const Three three = {w[0], w[1], w[2], 0.0f};
    (r % 2 ? other : sum) += EACH_TWICE(three) * *(const Eight*)a;
    last += w[2] * a[8];
}
sum += other;
return wp::vec3(sum[0] + sum[3] + sum[6], sum[1] + sum[4] + sum[7], sum[2] + sum[5] + last);

//: yielding
const float* const of = (const float*)inverse.data;
float sum = 0.0f;
for (int r = 0; r < count; ++r)
    for (int k = 0; k < 3; ++k) {
        const float w = weight[3 * r + k];
        sum += w * w * of[node[3 * r] + k];
    }
return sum;

//: strike
const float x = impulse[0], y = impulse[1], z = impulse[2];
const Eight J = {x, y, z, x, y, z, x, y};
for (int r = 0; r < count; ++r) {
    float* const to = (float*)v.data + 3L * node[3 * r];
    const float* const w = weight + 3 * r;
    const float* const g = (const float*)inverse.data + node[3 * r];
    const Three gain = {w[0] * g[0], w[1] * g[1], w[2] * g[2], 0.0f};
    *(Eight*)to += EACH_TWICE(gain) * J;
    to[8] += gain[2] * z;
}
