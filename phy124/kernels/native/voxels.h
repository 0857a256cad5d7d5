// Fills eight voxels up to a surface, with one voxel in each lane of a vector.
// Python version: `fill` in tests/test_voxels.py.
// Test: tests/test_voxels.py, test_kernel_fills_voxels_as_defined.

enum { N = 8 };
const int begin = N * thread, last = fractions.shape[0] - 1, count = samples.shape[0];
double x[N], y[N], z[N], u[N], v[N], w[N], sign[N], across[N], wanted[N];
for (int i = 0; i < N; ++i) {
    const int n = begin + i < last ? begin + i : last;
    const auto& middle = middles.data[n];
    const auto& axis = axes.data[n];
    x[i] = middle[0], y[i] = middle[1], z[i] = middle[2];
    u[i] = axis[0], v[i] = axis[1], w[i] = axis[2];
    sign[i] = double_sided.data[n] ? -1.0 : 1.0;
    across[i] = side * widths.data[n];
    wanted[i] = fractions.data[n] * count;
}
double scale[N], heights[MOST][N], low[N], high[N], level[N], total[N];
const auto share = [&](int n, int i) {
    const double part = (level[i] - heights[n][i]) * scale[i] + 0.5;
    return part < 0.0 ? 0.0 : part > 1.0 ? 1.0 : part;
};

for (int i = 0; i < N; ++i) low[i] = 1e9, high[i] = -1e9, scale[i] = 1.0 / across[i];
for (int n = 0; n < count; ++n) {
    const auto& sample = samples.data[n];
#pragma clang loop vectorize(enable) interleave(disable)
    for (int i = 0; i < N; ++i) {
        const double a = sample[0] - x[i], b = sample[1] - y[i], c = sample[2] - z[i];
        const double along = a * u[i] + b * v[i] + c * w[i];
        const double square = a * a + b * b + c * c - along * along;
        const double h = rods ? __builtin_elementwise_sqrt(square > 0.0 ? square : 0.0)
                                  : along > sign[i] * along ? along : sign[i] * along;
        low[i] = h < low[i] ? h : low[i];
        high[i] = h > high[i] ? h : high[i];
        heights[n][i] = h;
    }
}
for (int i = 0; i < N; ++i) low[i] -= across[i], high[i] += across[i];
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
        const double part = share(n, i);
        total[i] += part;
        for (int k = 0; k < 3; ++k) first[k][i] += part * sample[k];
        for (int k = 0; k < 9; ++k) second[k][i] += part * sample[k / 3] * sample[k % 3];
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
