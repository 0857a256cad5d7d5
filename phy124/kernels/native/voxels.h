// Fills eight voxels up to a surface, with one voxel in each lane of a vector.
// Python version: `fill` in tests/test_voxels.py.
// Test: tests/test_voxels.py, test_kernel_fills_voxels_as_defined.

enum { N = 8 };
const int begin = N * thread, last = fractions.shape[0] - 1, count = samples.shape[0];
double x[N], y[N], z[N], u[N], v[N], w[N], scale[N], wanted[N];
for (int i = 0; i < N; ++i) {
    const int n = begin + i < last ? begin + i : last;
    const auto& middle = middles.data[n];
    const auto& axis = axes.data[n];
    x[i] = middle[0], y[i] = middle[1], z[i] = middle[2];
    u[i] = axis[0], v[i] = axis[1], w[i] = axis[2];
    scale[i] = 1.0 / (side * widths.data[n]);
    wanted[i] = fractions.data[n] * count;
}
double heights[MOST][N], low[N], high[N], level[N], total[N];
// Upper end of the filled part of a sample. Heights are measured across the surface, in extents of a
// sample.
const auto top = [&](double height, int i) {
    return height + 0.5 < level[i] ? height + 0.5 : level[i];
};
const auto share = [&](int n, int i) {
    const double part = top(heights[n][i], i) - (heights[n][i] - 0.5);
    return part > 0.0 ? part : 0.0;
};

for (int i = 0; i < N; ++i) low[i] = 1e9, high[i] = -1e9;
for (int n = 0; n < count; ++n) {
    const auto& sample = samples.data[n];
#pragma clang loop vectorize(enable) interleave(disable)
    for (int i = 0; i < N; ++i) {
        const double a = sample[0] - x[i], b = sample[1] - y[i], c = sample[2] - z[i];
        const double along = a * u[i] + b * v[i] + c * w[i];
        const double square = a * a + b * b + c * c - along * along;
        const double far = __builtin_elementwise_sqrt(square > 0.0 ? square : 0.0);
        const double h = (rods ? far : along) * scale[i];
        low[i] = h < low[i] ? h : low[i];
        high[i] = h > high[i] ? h : high[i];
        heights[n][i] = h;
    }
}
for (int i = 0; i < N; ++i) low[i] -= 1.0, high[i] += 1.0;
for (int halving = 0; halving < HALVINGS; ++halving) {
    for (int i = 0; i < N; ++i) level[i] = 0.5 * (low[i] + high[i]), total[i] = 0.0;
    for (int n = 0; n < count; ++n) {
#pragma clang loop vectorize(enable) interleave(disable)
        for (int i = 0; i < N; ++i) total[i] += share(n, i);
    }
    for (int i = 0; i < N; ++i) (total[i] < wanted[i] ? low : high)[i] = level[i];
}

double first[3][N] = {}, second[9][N] = {};
for (int i = 0; i < N; ++i) total[i] = 0.0;
for (int n = 0; n < count; ++n) {
    const auto& sample = samples.data[n];
#pragma clang loop vectorize(enable) interleave(disable)
    for (int i = 0; i < N; ++i) {
        const double part = share(n, i), h = heights[n][i];
        // Direction across the surface.
        double g[3] = {u[i], v[i], w[i]};
        if (rods) {
            const double a = sample[0] - x[i], b = sample[1] - y[i], c = sample[2] - z[i];
            const double along = a * u[i] + b * v[i] + c * w[i], r = h > 1e-9 ? scale[i] / h : 0.0;
            g[0] = r * (a - along * u[i]), g[1] = r * (b - along * v[i]);
            g[2] = r * (c - along * w[i]);
        }
        // A sample at the surface counts at the centre of its filled part, and is as thick as this part.
        const double moved = (0.5 * (h - 0.5 + top(h, i)) - h) * side;
        const double thinner = part * (part * part - 1.0) * side * side / 12.0;
        const double p[3] = {sample[0] + moved * g[0], sample[1] + moved * g[1],
                             sample[2] + moved * g[2]};
        total[i] += part;
        for (int k = 0; k < 3; ++k) first[k][i] += part * p[k];
        for (int k = 0; k < 9; ++k)
            second[k][i] += part * p[k / 3] * p[k % 3] + thinner * g[k / 3] * g[k % 3];
    }
}
for (int i = 0; i < N && begin + i <= last; ++i) {
    auto& centre = centres_out.data[begin + i];
    auto& spread = spreads_out.data[begin + i];
    const double sum = total[i] > 1e-9 ? total[i] : 1e-9;
    for (int k = 0; k < 3; ++k) centre[k] = first[k][i] / sum;
    for (int k = 0; k < 9; ++k) {
        const double of_sample = k % 4 ? 0.0 : side * side / 12.0;
        spread.data[k / 3][k % 3] = second[k][i] / sum - centre[k / 3] * centre[k % 3] + of_sample;
    }
}
