// Stress of neo-Hookean bodies on lattices, for sixteen cells at a time: one AVX-512, two AVX2 or
// four NEON registers contain one number per cell. The forces of a cell's eight points on the
// cell's 27 nodes are added up before they are written. `order` lists the cells of each block, full
// cells first. In a full cell the points are a product of two points per axis, so that values and
// slopes are interpolated along one axis after another. Speeds are measured at the cells' centres.
// Python version: `lattice_stress` and `lattice_measure` of lattice/stress.py.
// Test: tests/test_lattice_kernels.py, test_simd_and_plain_stress_agree.

typedef float Lanes __attribute__((vector_size(64)));
typedef int Ints16 __attribute__((vector_size(64)));
typedef float Eight __attribute__((vector_size(32), aligned(4)));
const auto larger = [](Lanes a, Lanes b) { return a > b ? a : b; };
const int* const cells = (const int*)order.data + 16L * thread;
const int* const row = (const int*)rows.data;
const float* const place = (const float*)packed.data + 512L * thread;
const bool full = thread < full_blocks;
const float per_dx = 1.0f / dx;
// Transposes eight registers with two rows of eight each to eight columns of sixteen; applied to
// the columns, it returns the rows.
const auto transpose = [](Lanes* m) {
    for (int k = 0; k < 8; k += 2) {
        const Lanes a = m[k], b = m[k + 1];
        m[k] = __builtin_shufflevector(a, b, 0, 16, 2, 18, 4, 20, 6, 22, 8, 24, 10, 26, 12, 28, 14, 30);
        m[k + 1] = __builtin_shufflevector(a, b, 1, 17, 3, 19, 5, 21, 7, 23, 9, 25, 11, 27, 13, 29, 15, 31);
    }
    for (int h = 0; h < 8; h += 4)
        for (int k = h; k < h + 2; ++k) {
            const Lanes a = m[k], b = m[k + 2];
            m[k] = __builtin_shufflevector(a, b, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
            m[k + 2] = __builtin_shufflevector(a, b, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
        }
    for (int k = 0; k < 4; ++k) {
        const Lanes a = m[k], b = m[k + 4];
        m[k] = __builtin_shufflevector(a, b, 0, 1, 2, 3, 16, 17, 18, 19, 8, 9, 10, 11, 24, 25, 26, 27);
        m[k + 4] = __builtin_shufflevector(a, b, 4, 5, 6, 7, 20, 21, 22, 23, 12, 13, 14, 15, 28, 29, 30, 31);
    }
};
// Along an axis, the value at a distance t from a cell's centre is (a + 4 t (b + t c)) / 8, and its
// slope is (b + 2 t c) / 2. `expand` replaces the values at three nodes by a, b and c; `contract`
// is the transpose of `expand`.
const auto each_triple = [](Lanes* values, auto change) {
    for (int i = 0; i < 27; i += 9)
        for (int d = 0; d < 3; ++d) {
            Lanes m[9];
            for (int k = 0; k < 9; ++k) m[k] = values[3 * i + 3 * k + d];
            for (int k = 0; k < 9; k += 3) change(m[k], m[k + 1], m[k + 2]);
            for (int k = 0; k < 3; ++k) change(m[k], m[k + 3], m[k + 6]);
            for (int k = 0; k < 9; ++k) values[3 * i + 3 * k + d] = m[k];
        }
    for (int k = 0; k < 27; ++k) change(values[k], values[k + 27], values[k + 54]);
};
const auto expand = [&](Lanes* values) {
    each_triple(values, [](Lanes& a, Lanes& b, Lanes& c) {
        const Lanes sum = a + c, rise = c - a;
        a = sum + 6.0f * b;
        c = sum - 2.0f * b;
        b = rise;
    });
};
const auto contract = [&](Lanes* values) {
    each_triple(values, [](Lanes& a, Lanes& b, Lanes& c) {
        const Lanes sum = a + c, rise = b;
        b = 6.0f * a - 2.0f * c;
        a = sum - rise;
        c = sum + rise;
    });
};
// Values of the cells' nodes: three components of three nodes of nine rows. The values are expanded
// unless the cells are full.
const auto collect = [&](const float* values, Lanes* out) {
    for (int r = 0; r < 9; ++r) {
        Lanes m[8];
        for (int k = 0; k < 8; ++k) {
            const float* const a = values + 3L * row[9L * cells[k] + r];
            const float* const b = values + 3L * row[9L * cells[k + 8] + r];
            m[k] = __builtin_shufflevector(*(const Eight*)a, *(const Eight*)b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            ((float*)(out + 9 * r + 8))[k] = a[8];
            ((float*)(out + 9 * r + 8))[k + 8] = b[8];
        }
        transpose(m);
        for (int k = 0; k < 8; ++k) out[9 * r + k] = m[k];
    }
    if (!full) expand(out);
};
alignas(64) Lanes U[81];
collect((const float*)u.data, U);
// Distances of a point from the centres of its cells.
struct Place {
    Lanes x, y, z;
};
const auto locate = [&](int point) {
    const Lanes* const f = (const Lanes*)(place + point * 64);
    return Place{f[0] - 1.0f, f[1] - 1.0f, f[2] - 1.0f};
};
// Gauss points of a full cell: distance from its centre, and 6 times the means and twice the slopes
// of three values at the two points.
const float GAUSS = 0.28867513459f;
struct Two {
    Lanes low, high;
};
struct Three {
    Lanes a, b, c;
};
const auto means = [&](Lanes a, Lanes b, Lanes c) {
    const Lanes even = (a + c) + 4.0f * b, odd = 3.0f * GAUSS * (a - c);
    return Two{even + odd, even - odd};
};
const auto rises = [&](Lanes a, Lanes b, Lanes c) {
    const Lanes even = c - a, odd = 2.0f * GAUSS * ((a + c) - 2.0f * b);
    return Two{even - odd, even + odd};
};
// Transposes of the two functions above.
const auto spread_means = [&](Lanes low, Lanes high) {
    const Lanes even = low + high, odd = 3.0f * GAUSS * (low - high);
    return Three{even + odd, 4.0f * even, even - odd};
};
const auto spread_rises = [&](Lanes low, Lanes high) {
    const Lanes even = low + high, odd = 2.0f * GAUSS * (low - high);
    return Three{-even - odd, 2.0f * odd, even - odd};
};
// Units of the slopes that `differentiate` returns, and of the values that `interpolate` returns.
const float SLOPE = per_dx / (full ? 72.0f : 128.0f), VALUE = 1.0f / (full ? 216.0f : 512.0f);
// Row-major matrices of slopes at the eight points: entry 3 d + axis.
const auto differentiate = [&](const Lanes* values, Lanes (*slopes)[9]) {
    if (full) {
        for (int d = 0; d < 3; ++d) {
            Lanes mean[9][2], turn[9][2], across[3][3][4];
            for (int r = 0; r < 9; ++r) {
                const Lanes* const n = values + 9 * r + d;
                const Two m = means(n[0], n[3], n[6]), t = rises(n[0], n[3], n[6]);
                mean[r][0] = m.low, mean[r][1] = m.high, turn[r][0] = t.low, turn[r][1] = t.high;
            }
            for (int i = 0; i < 3; ++i)
                for (int z = 0; z < 2; ++z) {
                    const Lanes a = mean[3 * i][z], b = mean[3 * i + 1][z], c = mean[3 * i + 2][z];
                    const Two m = means(a, b, c), s = rises(a, b, c);
                    const Two t = means(turn[3 * i][z], turn[3 * i + 1][z], turn[3 * i + 2][z]);
                    across[0][i][z] = m.low, across[0][i][2 + z] = m.high;
                    across[1][i][z] = s.low, across[1][i][2 + z] = s.high;
                    across[2][i][z] = t.low, across[2][i][2 + z] = t.high;
                }
            for (int k = 0; k < 4; ++k) {
                const Two x = rises(across[0][0][k], across[0][1][k], across[0][2][k]);
                const Two y = means(across[1][0][k], across[1][1][k], across[1][2][k]);
                const Two z = means(across[2][0][k], across[2][1][k], across[2][2][k]);
                slopes[k][3 * d] = x.low, slopes[4 + k][3 * d] = x.high;
                slopes[k][3 * d + 1] = y.low, slopes[4 + k][3 * d + 1] = y.high;
                slopes[k][3 * d + 2] = z.low, slopes[4 + k][3 * d + 2] = z.high;
            }
        }
        return;
    }
    for (int point = 0; point < 8; ++point) {
        const Place t = locate(point);
        const Lanes x = 4.0f * t.x, y = 4.0f * t.y, z = 4.0f * t.z;
        for (int d = 0; d < 3; ++d) {
            Lanes mean[3], rise[3], turn[3];
            for (int i = 0; i < 3; ++i) {
                Lanes by_z[3], up[3];
                for (int j = 0; j < 3; ++j) {
                    const Lanes* const n = values + 9 * (3 * i + j) + d;
                    const Lanes m = n[3] + t.z * n[6];
                    by_z[j] = n[0] + z * m, up[j] = m + t.z * n[6];
                }
                const Lanes m = by_z[1] + t.y * by_z[2];
                mean[i] = by_z[0] + y * m, rise[i] = m + t.y * by_z[2];
                turn[i] = up[0] + y * (up[1] + t.y * up[2]);
            }
            Lanes* const out = slopes[point] + 3 * d;
            out[0] = mean[1] + 2.0f * t.x * mean[2];
            out[1] = rise[0] + x * (rise[1] + t.x * rise[2]);
            out[2] = turn[0] + x * (turn[1] + t.x * turn[2]);
        }
    }
};
// Values at the eight points: entry d.
const auto interpolate = [&](const Lanes* values, Lanes (*out)[3]) {
    for (int d = 0; d < 3 && full; ++d) {
        Lanes mean[9][2], across[3][4];
        for (int r = 0; r < 9; ++r) {
            const Lanes* const n = values + 9 * r + d;
            const Two m = means(n[0], n[3], n[6]);
            mean[r][0] = m.low, mean[r][1] = m.high;
        }
        for (int i = 0; i < 3; ++i)
            for (int z = 0; z < 2; ++z) {
                const Two m = means(mean[3 * i][z], mean[3 * i + 1][z], mean[3 * i + 2][z]);
                across[i][z] = m.low, across[i][2 + z] = m.high;
            }
        for (int k = 0; k < 4; ++k) {
            const Two m = means(across[0][k], across[1][k], across[2][k]);
            out[k][d] = m.low * VALUE, out[4 + k][d] = m.high * VALUE;
        }
    }
    for (int point = 0; point < 8 && !full; ++point) {
        const Place t = locate(point);
        for (int d = 0; d < 3; ++d) {
            Lanes by_y[3];
            for (int i = 0; i < 3; ++i) {
                Lanes by_z[3];
                for (int j = 0; j < 3; ++j) {
                    const Lanes* const n = values + 9 * (3 * i + j) + d;
                    by_z[j] = n[0] + 4.0f * t.z * (n[3] + t.z * n[6]);
                }
                by_y[i] = by_z[0] + 4.0f * t.y * (by_z[1] + t.y * by_z[2]);
            }
            const Lanes m = by_y[0] + 4.0f * t.x * (by_y[1] + t.x * by_y[2]);
            out[point][d] = m * VALUE;
        }
    }
};

//: strains
alignas(64) Lanes F_all[8][9];
differentiate(U, F_all);
for (int point = 0; point < 8; ++point)
    for (int k = 0; k < 9; ++k)
        F_all[point][k] = F_all[point][k] * SLOPE + (k % 4 ? 0.0f : 1.0f);
const auto cofactors = [](const auto* F, auto* c) {
    c[0] = F[4] * F[8] - F[5] * F[7];
    c[1] = F[5] * F[6] - F[3] * F[8];
    c[2] = F[3] * F[7] - F[4] * F[6];
    c[3] = F[2] * F[7] - F[1] * F[8];
    c[4] = F[0] * F[8] - F[2] * F[6];
    c[5] = F[1] * F[6] - F[0] * F[7];
    c[6] = F[1] * F[5] - F[2] * F[4];
    c[7] = F[2] * F[3] - F[0] * F[5];
    c[8] = F[0] * F[4] - F[1] * F[3];
    return F[0] * c[0] + F[1] * c[1] + F[2] * c[2];
};
const float FLOOR = 1.0e-4f;  // `safe_volume` of elastic.py
const float FLAT = 0.05f;  // `FLAT` of lattice/stress.py

//: rates
alignas(64) Lanes W[81], rates[8][9];
collect((const float*)v.data, W);
differentiate(W, rates);
// Row-major velocity gradient C = dF/dt F^-1, from the cofactors of F and 1 / J.
const auto strain_rate = [&](const Lanes* rate, const Lanes* c, Lanes per_J, Lanes* C) {
    const Lanes scale = per_J * SLOPE;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const Lanes sum = rate[3 * i] * c[3 * j] + rate[3 * i + 1] * c[3 * j + 1];
            C[3 * i + j] = (sum + rate[3 * i + 2] * c[3 * j + 2]) * scale;
        }
};

//: survey
Lanes fastest = {}, steepest = {}, closing = {}, doubt = {};
for (int d = 0; d < 3; ++d) {
    Lanes speed = W[d] * VALUE;
    if (full) speed = Lanes{};
    for (int r = 0; r < 9 && full; ++r) {
        const Lanes* const n = W + 9 * r + d;
        const float weight = (r % 3 == 1 ? 0.75f : 0.125f) * (r / 3 == 1 ? 0.75f : 0.125f);
        speed += weight * (0.125f * (n[0] + n[6]) + 0.75f * n[3]);
    }
    fastest += speed * speed;
}
const auto root = [](Lanes x) {
    for (int lane = 0; lane < 16; ++lane) x[lane] = __builtin_sqrtf(x[lane]);
    return x;
};
// Upper bound of the rate of compression (`compression` of lattice/stress.py), and closing rate.
const auto survey = [&](const Lanes* C, Lanes J) {
    const Lanes flat = larger(J, Lanes{} + FLOOR) / larger(J, Lanes{} + FLAT);
    const Lanes mean = (C[0] + C[4] + C[8]) * (1.0f / 3);
    const Lanes a = C[0] - mean, b = C[4] - mean, c = C[8] - mean;
    const Lanes d = C[1] + C[3], e = C[2] + C[6], f = C[5] + C[7];
    const Lanes square = a * a + b * b + c * c + 0.5f * (d * d + e * e + f * f);
    const Lanes rate = (root(square * (2.0f / 3)) - mean) * flat;
    steepest = larger(steepest, rate);
    closing = larger(closing, rate * (J < 1.0f ? J : Lanes{} + 1.0f));
    doubt += (rate + J) * 0.0f;
};
const auto report = [&]() {
    float* const most = (float*)maxima_out.data;
    for (int lane = 0; lane < 16; ++lane) {
        if (!(doubt[lane] == 0.0f)) ((int*)stray_out.data)[0] += 1;
        const float here[3] = {__builtin_sqrtf(fastest[lane]), steepest[lane], closing[lane]};
        for (int k = 0; k < 3; ++k) most[k] = here[k] > most[k] ? here[k] : most[k];
    }
};

//: laws
const float* const laws = (const float*)theta.data;
const bool alike = theta.shape[0] == 1;
const auto parameter = [&](int point, int column) {
    if (alike) return Lanes{} + laws[column];
    Lanes value;
    for (int lane = 0; lane < 16; ++lane)
        value[lane] = laws[(8L * cells[lane] + point - first) * width + column];
    return value;
};

//: stress
// log x for x > 0, to 1e-7 near 1: exponent, and the series of artanh for the rest.
const auto logarithm = [](Lanes x) {
    const Ints16 bits = (Ints16)x, exponent = (bits - 0x3f3504f3) >> 23;
    const Lanes m = (Lanes)(bits - (exponent << 23)), t = (m - 1.0f) / (m + 1.0f), t2 = t * t;
    const Lanes series = 1.0f + t2 * (1.0f / 3 + t2 * (0.2f + t2 * (1.0f / 7 + t2 / 9)));
    return __builtin_convertvector(exponent, Lanes) * 0.69314718f + 2.0f * t * series;
};
for (int point = 0; point < 8; ++point) {
    Lanes c[9], P[9];
    const Lanes* const F = F_all[point];
    const Lanes J = cofactors(F, c), safe = larger(J, Lanes{} + FLOOR), per_J = 1.0f / safe;
    const Lanes mu = parameter(point, 0), lam = parameter(point, 1);
    const Lanes log_J = logarithm(safe) + (J < FLOOR ? (J - FLOOR) / FLOOR : Lanes{});
    const Lanes scale = *(const Lanes*)(place + (point * 4 + 3) * 16) * -SLOPE;
    const Lanes shear = scale * mu * J * per_J, pressure = scale * (lam * log_J - mu) * per_J;
    for (int k = 0; k < 9; ++k) P[k] = shear * F[k] + pressure * c[k];
    ADD_VISCOUS
    for (int k = 0; k < 9; ++k) F_all[point][k] = P[k];
}
REPORT

//: shock
// Python version: `lattice_shock` of lattice/stress.py. Test: test_simd_and_plain_shock_agree.
const float stopping = dx / (STEEPEST * ((const float*)clock.data)[0]);
const auto smaller = [](Lanes a, Lanes b) { return a < b ? a : b; };
for (int point = 0; point < 8; ++point) {
    Lanes c[9], m;
    const Lanes J = cofactors(F_all[point], c), per_J = 1.0f / larger(J, Lanes{} + FLOOR);
    for (int lane = 0; lane < 16; ++lane)
        m[lane] = ((const float*)mass.data)[8L * cells[lane] + point];
    m = *(const Lanes*)(place + (point * 4 + 3) * 16) > 0.0f ? m : Lanes{};
    Lanes rate = {}, square = {};
    for (int k = 0; k < 9; ++k) rate += rates[point][k] * c[k], square += c[k] * c[k];
    rate *= dx * SLOPE * per_J;
    square *= per_J * per_J;
    const Lanes shorter = larger(square - 2.0f, Lanes{} + 1.0f);
    const Lanes strength = smaller(-QUADRATIC * rate / shorter, stopping / square);
    const Lanes energy = rate < 0.0f ? -strength * m * rate : Lanes{};
    for (int k = 0; k < 9; ++k) F_all[point][k] = energy * SLOPE * per_J * c[k];
}

//: scatter
// Adds the forces of P, in `F_all`, to the nodes.
alignas(64) Lanes sums[81];
if (full)
    for (int d = 0; d < 3; ++d) {
        Lanes across[3][3][4];
        for (int k = 0; k < 4; ++k) {
            const Lanes* const low = F_all[k] + 3 * d;
            const Lanes* const high = F_all[4 + k] + 3 * d;
            const Three x = spread_rises(low[0], high[0]), y = spread_means(low[1], high[1]);
            const Three z = spread_means(low[2], high[2]);
            across[0][0][k] = x.a, across[0][1][k] = x.b, across[0][2][k] = x.c;
            across[1][0][k] = y.a, across[1][1][k] = y.b, across[1][2][k] = y.c;
            across[2][0][k] = z.a, across[2][1][k] = z.b, across[2][2][k] = z.c;
        }
        for (int i = 0; i < 3; ++i) {
            Lanes mean[3][2], turn[3][2];
            for (int z = 0; z < 2; ++z) {
                const Three m = spread_means(across[0][i][z], across[0][i][2 + z]);
                const Three s = spread_rises(across[1][i][z], across[1][i][2 + z]);
                const Three t = spread_means(across[2][i][z], across[2][i][2 + z]);
                mean[0][z] = m.a + s.a, mean[1][z] = m.b + s.b, mean[2][z] = m.c + s.c;
                turn[0][z] = t.a, turn[1][z] = t.b, turn[2][z] = t.c;
            }
            for (int j = 0; j < 3; ++j) {
                const Three m = spread_means(mean[j][0], mean[j][1]);
                const Three t = spread_rises(turn[j][0], turn[j][1]);
                Lanes* const n = sums + 9 * (3 * i + j) + d;
                n[0] = m.a + t.a, n[3] = m.b + t.b, n[6] = m.c + t.c;
            }
        }
    }
else {
    for (int k = 0; k < 81; ++k) sums[k] = Lanes{};
    for (int point = 0; point < 8; ++point) {
        const Place t = locate(point);
        const Lanes x = 4.0f * t.x, y = 4.0f * t.y, z = 4.0f * t.z;
        for (int d = 0; d < 3; ++d) {
            const Lanes* const P = F_all[point] + 3 * d;
            const Lanes mean[3] = {Lanes{}, P[0], 2.0f * t.x * P[0]};
            const Lanes rise[3] = {P[1], x * P[1], t.x * (x * P[1])};
            const Lanes turn[3] = {P[2], x * P[2], t.x * (x * P[2])};
            for (int i = 0; i < 3; ++i) {
                const Lanes m = y * mean[i] + rise[i], up = y * turn[i];
                const Lanes along[3] = {mean[i], m, t.y * (m + rise[i])};
                const Lanes across[3] = {turn[i], up, t.y * up};
                for (int j = 0; j < 3; ++j) {
                    Lanes* const n = sums + 9 * (3 * i + j) + d;
                    const Lanes g = z * along[j] + across[j];
                    n[0] += along[j];
                    n[3] += g;
                    n[6] += t.z * (g + across[j]);
                }
            }
        }
    }
    contract(sums);
}
float* const forces = (float*)force_out.data - 3L * low;
for (int r = 0; r < 9; ++r) {
    Lanes* const m = sums + 9 * r;
    transpose(m);
    for (int k = 0; k < 16; ++k) {
        float* const to = forces + 3L * row[9L * cells[k] + r];
        const float* const of = (const float*)(m + k % 8) + k / 8 * 8;
        *(Eight*)to += *(const Eight*)of;
        to[8] += ((const float*)(m + 8))[k];
    }
}

//: elastic
#define ADD_VISCOUS
#define REPORT

//: viscous
#define REPORT report();
#define ADD_VISCOUS { \
    Lanes C[9]; \
    strain_rate(rates[point], c, per_J, C); \
    survey(C, J); \
    const Lanes inside = J < 0.0f ? Lanes{} : J > 1.0f ? Lanes{} + 1.0f : J; \
    const Lanes eta = scale * inside * parameter(point, 2) * per_J; \
    for (int i = 0; i < 3; ++i) \
        for (int k = i; k < 3; ++k) C[3 * i + k] = C[3 * k + i] = eta * (C[3 * i + k] + C[3 * k + i]); \
    for (int i = 0; i < 3; ++i) \
        for (int j = 0; j < 3; ++j) \
            for (int k = 0; k < 3; ++k) P[3 * i + j] += C[3 * i + k] * c[3 * k + j]; \
}
