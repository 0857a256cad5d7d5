// Computes the centres and deformation gradients of eight Gaussians from the carrying particles.
// Python version: `carry` of deform.py.
// Test: tests/test_deform.py, test_eight_at_a_time_are_carried_as_one_by_one.

enum { N = 8 };
const int begin = N * thread, all = neighbours.shape[0], carriers = neighbours.shape[1];
const int count = begin + N < all ? N : all - begin;
double home[3][N], x[3][N] = {}, f[9][N] = {}, total[N] = {}, limited[N];
for (int i = 0; i < N; ++i) {
    const int g = begin + (i < count ? i : count - 1);
    for (int k = 0; k < 3; ++k) home[k][i] = means0.data[g][k];
    limited[i] = flows.data[g] ? 1.0 : 0.0;
}
for (int k = 0; k < carriers; ++k) {
    double w[N], at[3][N], from[3][N], g[9][N];
    for (int i = 0; i < N; ++i) {
        const int place = (begin + (i < count ? i : count - 1)) * carriers + k;
        const int j = neighbours.data[place];
        w[i] = weights.data[place];
        for (int r = 0; r < 3; ++r) at[r][i] = position.data[j][r], from[r][i] = rest.data[j][r];
        for (int r = 0; r < 9; ++r) g[r][i] = deformation.data[j].data[r / 3][r % 3];
    }
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)

    for (int i = 0; i < N; ++i) {
        const double a = home[0][i] - from[0][i], b = home[1][i] - from[1][i];
        const double c = home[2][i] - from[2][i];
        double u = g[0][i] * a + g[1][i] * b + g[2][i] * c;
        double v = g[3][i] * a + g[4][i] * b + g[5][i] * c;
        double s = g[6][i] * a + g[7][i] * b + g[8][i] * c;
        const double longest = ARM * __builtin_elementwise_sqrt(a * a + b * b + c * c);
        const double length = __builtin_elementwise_sqrt(u * u + v * v + s * s);
        const double share = limited[i] * length > longest ? longest / length : 1.0;
        u *= share, v *= share, s *= share;
        x[0][i] += w[i] * (at[0][i] + u);
        x[1][i] += w[i] * (at[1][i] + v);
        x[2][i] += w[i] * (at[2][i] + s);
        for (int r = 0; r < 9; ++r) f[r][i] += w[i] * g[r][i];
        total[i] += w[i];
    }
}
for (int i = 0; i < count; ++i) {
    const double part = 1.0 / total[i];
    for (int r = 0; r < 3; ++r) means_out.data[begin + i][r] = (float)(part * x[r][i]);
    for (int r = 0; r < 9; ++r)
        deformation_out.data[begin + i].data[r / 3][r % 3] = part * f[r][i];
}
