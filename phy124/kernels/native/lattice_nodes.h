// Kicks and drifts of 256 nodes of a lattice.
// Python version: `kick` and `drift` of lattice/nodes.py.
// Test: tests/test_lattice_kernels.py, test_simd_and_plain_contact_agree.

//: kick
// Python version: `kick` of lattice/nodes.py, for one node. The uniform acceleration also acts on
// tied nodes, but tied nodes take the velocity of their donors in `drift`.
const long first = start + 256L * thread, last = first + 256 < stop ? first + 256 : stop;
float* const to = (float*)v_out.data;
const float* const uniform = (const float*)values.data;
const float* const one = (const float*)inverse.data;
const float* const weights = (const float*)donors.weights.data;
const int *const starts = (const int*)donors.starts.data, *const lists = (const int*)donors.nodes.data;
const float dt = ((const float*)clock.data)[0], ax = uniform[0], ay = uniform[1], az = uniform[2];
__builtin_memcpy((float*)v_before_out.data + 3 * first, to + 3 * first, 12 * (last - first));
for (long n = first; n < last; ++n) {
    const float free = one[n] > 0 ? dt : 0;
    to[3 * n] += free * ax, to[3 * n + 1] += free * ay, to[3 * n + 2] += free * az;
}
for (int w = 0; w < spans.shape[0]; ++w) {
    const int* const span = (const int*)spans.data + 3 * w;
    const long from = span[0], end = span[1];
    const float* const force = (const float*)pool.data + 3 * (span[2] - from);
    for (long n = first; n < last; ++n) {
        float x = 0, y = 0, z = 0;
        if (n >= from && n < end) x = force[3 * n], y = force[3 * n + 1], z = force[3 * n + 2];
        for (int k = starts[n]; k < starts[n + 1]; ++k) {
            const long m = lists[k];
            if (m < from || m >= end) continue;
            const float part = weights[k];
            x += part * force[3 * m], y += part * force[3 * m + 1], z += part * force[3 * m + 2];
        }
        const float gain = dt * one[n];
        to[3 * n] += gain * x, to[3 * n + 1] += gain * y, to[3 * n + 2] += gain * z;
    }
}

//: drift
// Python version: `drift` of lattice/nodes.py, for one node.
const long first = start + 256L * thread, last = first + 256 < stop ? first + 256 : stop;
float *const v = (float*)v_out.data, *const u = (float*)u_out.data;
float *const residue = (float*)residue_out.data, *const lagging = (float*)lagging_out.data;
const float* const before_kick = (const float*)v_before.data;
const float dt = ((const float*)clock.data)[1];
const int* const starts = (const int*)tied.starts.data;
for (long n = first; n < last; ++n) {
    if (starts[n + 1] == starts[n]) continue;
    float sum[3] = {};
    for (int k = starts[n]; k < starts[n + 1]; ++k)
        for (int d = 0; d < 3; ++d)
            sum[d] += ((const float*)tied.weights.data)[k] * v[3L * ((const int*)tied.nodes.data)[k] + d];
    for (int d = 0; d < 3; ++d) v[3 * n + d] = sum[d];
}
for (long k = 3 * first; k < 3 * last; ++k) {
    const float step = dt * v[k] + residue[k], before = u[k], after = before + step;
    residue[k] = step - (after - before);
    u[k] = after;
    lagging[k] = 0.75f * v[k] + 0.25f * before_kick[k];  // `RECENT` of lattice/nodes.py
}
