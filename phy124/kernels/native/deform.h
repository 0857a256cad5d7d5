// Deforms eight Gaussians in float64. Gaussians of torn material, with axes of zero length, or with
// axes that change order are not changed; a bit is set for each such Gaussian.
// Python version: `deform_shape` of deform.py.
// Test: tests/test_deform.py, test_eight_at_a_time_are_deformed_as_one_by_one.

enum { N = 8 };
const int begin = N * thread, total = quats0.shape[0];
const int count = begin + N < total ? N : total - begin;
double f[9][N], start[9][N], v[9][N], before[9][N], a[9][N], u[9][N];
double rest[3][N], last[4][N], inside[4][N], home[4][N], most[N], hold[N], ball[N];
for (int i = 0; i < N; ++i) {
    const int g = begin + (i < count ? i : count - 1);
    const auto& F = deformation.data[g];
    for (int k = 0; k < 9; ++k) f[k][i] = F.data[k / 3][k % 3];
    for (int k = 0; k < 3; ++k) rest[k][i] = scales0.data[g][k];
    for (int k = 0; k < 4; ++k) {
        home[k][i] = quats0.data[g][k];
        last[k][i] = quats.data[g][k];
        inside[k][i] = inner_out.data[g][k];
    }
    most[i] = limits.data[g];
    hold[i] = holds.data[g];
    ball[i] = rounds.data[g] ? 1.0 : 0.0;
}
const auto root = [](double x) { return __builtin_elementwise_sqrt(x); };
const auto size = [](double x) { return __builtin_elementwise_abs(x); };
const auto larger = [](double x, double y) { return x > y ? x : y; };
const auto smaller = [](double x, double y) { return x < y ? x : y; };

const auto turned = [](const double (&q)[4][N], double (&r)[9][N], int i) {
    const double w = q[0][i], x = q[1][i], y = q[2][i], z = q[3][i];
    const double s = 2.0 / (w * w + x * x + y * y + z * z);
    r[0][i] = 1.0 - s * (y * y + z * z);
    r[1][i] = s * (x * y - w * z);
    r[2][i] = s * (x * z + w * y);
    r[3][i] = s * (x * y + w * z);
    r[4][i] = 1.0 - s * (x * x + z * z);
    r[5][i] = s * (y * z - w * x);
    r[6][i] = s * (x * z - w * y);
    r[7][i] = s * (y * z + w * x);
    r[8][i] = 1.0 - s * (x * x + y * y);
};
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)

for (int i = 0; i < N; ++i) {
    turned(home, start, i);
    turned(last, before, i);
    turned(inside, v, i);
    // F R0 S0 V
    for (int r = 0; r < 9; r += 3) {
        const double x = f[r][i], y = f[r + 1][i], z = f[r + 2][i];
        const double p = rest[0][i] * (x * start[0][i] + y * start[3][i] + z * start[6][i]);
        const double q = rest[1][i] * (x * start[1][i] + y * start[4][i] + z * start[7][i]);
        const double s = rest[2][i] * (x * start[2][i] + y * start[5][i] + z * start[8][i]);
        a[r][i] = p * v[0][i] + q * v[3][i] + s * v[6][i];
        a[r + 1][i] = p * v[1][i] + q * v[4][i] + s * v[7][i];
        a[r + 2][i] = p * v[2][i] + q * v[5][i] + s * v[8][i];
    }
}


// Makes columns m and n of A W orthogonal; returns the number of Gaussians that were changed.
const auto rotated = [&](int m, int n) {
    double turning = 0.0;
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)

    for (int i = 0; i < N; ++i) {
        const double a0 = a[m][i], a1 = a[m + 3][i], a2 = a[m + 6][i];
        const double b0 = a[n][i], b1 = a[n + 3][i], b2 = a[n + 6][i];
        const double p = a0 * a0 + a1 * a1 + a2 * a2, q = b0 * b0 + b1 * b1 + b2 * b2;
        const double c = a0 * b0 + a1 * b1 + a2 * b2;
        const bool turns = c * c > TOLERANCE * TOLERANCE * p * q;
        const double zeta = (q - p) / (turns ? 2.0 * c : 1.0);
        const double tangent = 1.0 / (size(zeta) + root(1.0 + zeta * zeta));
        const double t = turns ? zeta < 0.0 ? -tangent : tangent : 0.0;
        const double x = 1.0 / root(1.0 + t * t), y = x * t;
        a[m][i] = x * a0 - y * b0;
        a[m + 3][i] = x * a1 - y * b1;
        a[m + 6][i] = x * a2 - y * b2;
        a[n][i] = y * a0 + x * b0;
        a[n + 3][i] = y * a1 + x * b1;
        a[n + 6][i] = y * a2 + x * b2;
        for (int r = 0; r < 9; r += 3) {
            const double e = v[r + m][i];
            v[r + m][i] = x * e - y * v[r + n][i];
            v[r + n][i] = y * e + x * v[r + n][i];
        }
        turning += turns ? 1.0 : 0.0;
    }
    return turning;
};
double turning = 1.0;
for (int sweep = 0; turning > 0.0 && sweep < SWEEPS; ++sweep) {
    turning = rotated(0, 1);
    turning += rotated(0, 2);
    turning += rotated(1, 2);
}


// Shepperd's method: of four equivalent forms, use the form with the largest divisor.
const auto quaternion = [&](const double (&r)[9][N], double (&q)[4][N], int i) {
    const double r0 = r[0][i], r1 = r[4][i], r2 = r[8][i], t = r0 + r1 + r2;
    const double x = r[7][i] - r[5][i], y = r[2][i] - r[6][i], z = r[3][i] - r[1][i];
    const double xy = r[1][i] + r[3][i], xz = r[2][i] + r[6][i], yz = r[5][i] + r[7][i];
    double w0 = 1.0 + t, w1 = x, w2 = y, w3 = z, best = t;
    bool more = r0 > best;
    best = more ? r0 : best;
    w0 = more ? x : w0, w1 = more ? 1.0 + r0 - r1 - r2 : w1;
    w2 = more ? xy : w2, w3 = more ? xz : w3;
    more = r1 > best;
    best = more ? r1 : best;
    w0 = more ? y : w0, w1 = more ? xy : w1;
    w2 = more ? 1.0 + r1 - r0 - r2 : w2, w3 = more ? yz : w3;
    more = r2 > best;
    w0 = more ? z : w0, w1 = more ? xz : w1;
    w2 = more ? yz : w2, w3 = more ? 1.0 + r2 - r0 - r1 : w3;
    const double s = 1.0 / root(w0 * w0 + w1 * w1 + w2 * w2 + w3 * w3);
    q[0][i] = s * w0, q[1][i] = s * w1, q[2][i] = s * w2, q[3][i] = s * w3;
};
double quat[4][N], scale[3][N], unusual[N];
#pragma clang loop vectorize(enable) interleave(disable) unroll(disable)

for (int i = 0; i < N; ++i) {
    const double l0 = root(a[0][i] * a[0][i] + a[3][i] * a[3][i] + a[6][i] * a[6][i]);
    const double l1 = root(a[1][i] * a[1][i] + a[4][i] * a[4][i] + a[7][i] * a[7][i]);
    const double l2 = root(a[2][i] * a[2][i] + a[5][i] * a[5][i] + a[8][i] * a[8][i]);
    // The longest column comes first, followed by the others in cyclic order.
    const bool second = l1 > l0, third = l2 > (second ? l1 : l0);
    const auto first_of = [&](double x, double y, double z) {
        return third ? z : second ? y : x;
    };
    const double longest = first_of(l0, l1, l2);
    const double after = first_of(l1, l2, l0), final = first_of(l2, l0, l1);
    const bool swapped = final > after;
    const double length = swapped ? final : after, e = 1.0 / longest;
    const double ex = e * first_of(a[0][i], a[1][i], a[2][i]);
    const double ey = e * first_of(a[3][i], a[4][i], a[5][i]);
    const double ez = e * first_of(a[6][i], a[7][i], a[8][i]);
    const auto wanted = [&](double x, double y, double z) {
        return swapped ? first_of(z, x, y) : first_of(y, z, x);
    };
    double mx = wanted(a[0][i], a[1][i], a[2][i]), my = wanted(a[3][i], a[4][i], a[5][i]);
    double mz = wanted(a[6][i], a[7][i], a[8][i]);
    const double along = ex * mx + ey * my + ez * mz;
    mx -= along * ex, my -= along * ey, mz -= along * ez;
    const double across = root(mx * mx + my * my + mz * mz), m = 1.0 / across;
    mx *= m, my *= m, mz *= m;
    const double sign = swapped ? -1.0 : 1.0;
    const double sx = sign * (ey * mz - ez * my), sy = sign * (ez * mx - ex * mz);
    const double sz = sign * (ex * my - ey * mx);
    const auto placed = [&](int r, double x, double y, double z) {
        const double next = swapped ? z : y, end = swapped ? y : z;
        u[r][i] = third ? next : second ? end : x;
        u[r + 1][i] = third ? end : second ? x : next;
        u[r + 2][i] = third ? x : second ? next : end;
    };
    placed(0, ex, mx, sx);
    placed(3, ey, my, sy);
    placed(6, ez, mz, sz);
    double trace = 0.0, square = 0.0;
    for (int k = 0; k < 9; ++k) {
        trace += before[k][i] * u[k][i];
        square += f[k][i] * f[k][i];
    }
    const bool usual = square <= hold[i] * hold[i] && longest > 1e-150
        && length > 1e-15 * longest && across > 1e-3 * length && trace >= IDENTITY_ZONE;
    unusual[i] = usual ? 0.0 : 1.0;
    quaternion(u, quat, i);
    const double facing = quat[0][i] * last[0][i] + quat[1][i] * last[1][i]
        + quat[2][i] * last[2][i] + quat[3][i] * last[3][i];
    const double side = facing < 0.0 ? -1.0 : 1.0;
    for (int k = 0; k < 4; ++k) quat[k][i] *= side;
    // Axes of Gaussians in plastic and fluid material.
    const double shortest = smaller(smaller(l0, l1), l2);
    const double thin = larger(shortest, TINY * longest);
    const double middle = l0 + l1 + l2 - longest - shortest;
    const double wide = larger(larger(rest[0][i], rest[1][i]), rest[2][i]);
    const double narrow = smaller(smaller(rest[0][i], rest[1][i]), rest[2][i]);
    const double drawn = longest / thin * narrow / wide;
    const double part = (drawn - SOUND_SHAPE) / (ROUND_SHAPE - SOUND_SHAPE);
    const double w = ball[i] * smaller(larger(part, 0.0), 1.0);
    const double even = root(longest * larger(middle, thin));
    const double limit = smaller(LARGEST, most[i] * wide);
    scale[0][i] = smaller(w > 0.0 ? (1.0 - w) * l0 + w * even : l0, limit);
    scale[1][i] = smaller(w > 0.0 ? (1.0 - w) * l1 + w * even : l1, limit);
    scale[2][i] = smaller(w > 0.0 ? (1.0 - w) * l2 + w * even : l2, limit);
    quaternion(v, inside, i);
}

int left = 0;
for (int i = 0; i < count; ++i) {
    if (unusual[i] != 0.0) {
        left |= 1 << i;
        continue;
    }
    const int g = begin + i;
    for (int k = 0; k < 4; ++k) {
        inner_out.data[g][k] = (float)inside[k][i];
        quats_out.data[g][k] = (float)quat[k][i];
    }
    for (int k = 0; k < 3; ++k) scales_out.data[g][k] = (float)scale[k][i];
}
return left;
