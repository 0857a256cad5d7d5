// Stress of neo-Hookean bodies on their lattice, sixteen cells at a time: one AVX-512, two AVX2 or
// four NEON registers hold the same number of sixteen cells. The eight points of the cells are
// processed in turn; the forces of all points on the 27 nodes of a cell are added up before they are
// written. Lanes beyond the last cell repeat it, with points of no volume.
// Plain form: `lattice_stress` and `lattice_measure` of lattice/stress.py.
// Test: tests/test_lattice.py, test_simd_and_plain_stress_agree.

typedef float Lanes __attribute__((vector_size(64)));
typedef int Ints16 __attribute__((vector_size(64)));
const auto lesser = [](Lanes a, Lanes b) { return a < b ? a : b; };
const auto larger = [](Lanes a, Lanes b) { return a > b ? a : b; };
// log x for x > 0, to 1e-7 near 1: exponent, and the series of artanh for the rest.
const auto logarithm = [](Lanes x) {
    const Ints16 bits = (Ints16)x, exponent = (bits - 0x3f3504f3) >> 23;
    const Lanes m = (Lanes)(bits - (exponent << 23)), t = (m - 1.0f) / (m + 1.0f), t2 = t * t;
    const Lanes series = 1.0f + t2 * (1.0f / 3 + t2 * (0.2f + t2 * (1.0f / 7 + t2 / 9)));
    return __builtin_convertvector(exponent, Lanes) * 0.69314718f + 2.0f * t * series;
};
const int begin = start_cell + 16 * thread;
const int cells = end_cell - begin < 16 ? end_cell - begin : 16;
const int* const row = (const int*)rows.data;
const float* const place = (const float*)packed.data + (long)(begin - start_cell) * 40;
const float* const laws = (const float*)theta.data;
const bool alike = theta.shape[0] == 1;
const float per_dx = 1.0f / dx;
// Values of the cells' nodes: three components of three nodes of nine rows.
alignas(64) Lanes U[81];
const auto collect = [&](const float* values, Lanes* out) {
    for (int lane = 0; lane < 16; ++lane) {
        const int* const of = row + 9L * (begin + (lane < cells ? lane : cells - 1));
        for (int r = 0; r < 9; ++r) {
            const float* const from = values + 3L * of[r];
            for (int k = 0; k < 9; ++k) ((float*)(out + 9 * r + k))[lane] = from[k];
        }
    }
};
collect((const float*)u.data, U);
struct Weights {
    Lanes w[3][3], s[3][3];  // weights and slopes of three nodes along each axis
};
const auto weigh = [&](int point) {
    Weights a;
    for (int axis = 0; axis < 3; ++axis) {
        const Lanes f = *(const Lanes*)(place + (point * 5 + axis) * 16);
        a.w[axis][0] = 0.5f * (1.5f - f) * (1.5f - f);
        a.w[axis][1] = 0.75f - (f - 1.0f) * (f - 1.0f);
        a.w[axis][2] = 0.5f * (f - 0.5f) * (f - 0.5f);
        a.s[axis][0] = f - 1.5f;
        a.s[axis][1] = 2.0f - 2.0f * f;
        a.s[axis][2] = f - 0.5f;
    }
    return a;
};
// Row-major matrix of slopes, per cell: entry 3 d + axis.
const auto differentiate = [](const Lanes* values, const Weights& a, Lanes* slopes) {
    for (int d = 0; d < 3; ++d) {
        Lanes by_x = {}, by_y = {}, by_z = {};
        for (int i = 0; i < 3; ++i) {
            Lanes mean = {}, rise = {}, turn = {};
            for (int j = 0; j < 3; ++j) {
                const Lanes* const n = values + 9 * (3 * i + j) + d;
                const Lanes z = a.w[2][0] * n[0] + a.w[2][1] * n[3] + a.w[2][2] * n[6];
                const Lanes dz = a.s[2][0] * n[0] + a.s[2][1] * n[3] + a.s[2][2] * n[6];
                mean += a.w[1][j] * z;
                rise += a.s[1][j] * z;
                turn += a.w[1][j] * dz;
            }
            by_x += a.s[0][i] * mean;
            by_y += a.w[0][i] * rise;
            by_z += a.w[0][i] * turn;
        }
        slopes[3 * d] = by_x;
        slopes[3 * d + 1] = by_y;
        slopes[3 * d + 2] = by_z;
    }
};
const auto deform = [&](const Weights& a, Lanes* F) {
    differentiate(U, a, F);
    for (int k = 0; k < 9; ++k) F[k] = F[k] * per_dx + (k % 4 ? 0.0f : 1.0f);
};
const auto cofactors = [](const Lanes* F, Lanes* c) {
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
const auto parameter = [&](int point, int column) {
    Lanes value;
    for (int lane = 0; lane < 16; ++lane) {
        const int cell = begin + (lane < cells ? lane : cells - 1);
        const long at = alike ? 0 : 8L * cell + point - first;
        value[lane] = laws[at * width + column];
    }
    return value;
};
const float FLOOR = 1.0e-4f;  // `safe_volume` of lattice/points.py

//: rates
alignas(64) Lanes W[81];
collect((const float*)v.data, W);
// Row-major velocity gradient C = dF/dt F^-1, from the cofactors of F and 1 / J.
const auto strain_rate = [&](const Weights& a, const Lanes* c, Lanes per_J, Lanes* C) {
    Lanes rate[9];
    differentiate(W, a, rate);
    const Lanes scale = per_J * per_dx;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const Lanes sum = rate[3 * i] * c[3 * j] + rate[3 * i + 1] * c[3 * j + 1];
            C[3 * i + j] = (sum + rate[3 * i + 2] * c[3 * j + 2]) * scale;
        }
};

//: stress
alignas(64) Lanes sums[81];
for (int k = 0; k < 81; ++k) sums[k] = Lanes{};
const Lanes mu_of_all = parameter(0, 0), lam_of_all = parameter(0, 1);
for (int point = 0; point < 8; ++point) {
    const Weights a = weigh(point);
    Lanes F[9], c[9], P[9];
    deform(a, F);
    const Lanes J = cofactors(F, c), safe = larger(J, Lanes{} + FLOOR), per_J = 1.0f / safe;
    const Lanes mu = alike ? mu_of_all : parameter(point, 0);
    const Lanes lam = alike ? lam_of_all : parameter(point, 1);
    const Lanes log_J = logarithm(safe) + (J < FLOOR ? (J - FLOOR) / FLOOR : Lanes{});
    const Lanes scale = *(const Lanes*)(place + (point * 5 + 3) * 16) * -per_dx;
    const Lanes shear = scale * mu * J * per_J, pressure = scale * (lam * log_J - mu) * per_J;
    for (int k = 0; k < 9; ++k) P[k] = shear * F[k] + pressure * c[k];
    ADD_VISCOUS
    for (int d = 0; d < 3; ++d)
        for (int i = 0; i < 3; ++i) {
            const Lanes rise = a.s[0][i] * P[3 * d], turn = a.w[0][i] * P[3 * d + 1];
            const Lanes lift = a.w[0][i] * P[3 * d + 2];
            for (int j = 0; j < 3; ++j) {
                const Lanes along = a.w[1][j] * rise + a.s[1][j] * turn, up = a.w[1][j] * lift;
                Lanes* const n = sums + 9 * (3 * i + j) + d;
                n[0] += a.w[2][0] * along + a.s[2][0] * up;
                n[3] += a.w[2][1] * along + a.s[2][1] * up;
                n[6] += a.w[2][2] * along + a.s[2][2] * up;
            }
        }
}
float* const forces = (float*)force_out.data - 3L * low;
for (int lane = 0; lane < cells; ++lane) {
    const int* const of = row + 9L * (begin + lane);
    for (int r = 0; r < 9; ++r) {
        float* const to = forces + 3L * of[r];
        for (int k = 0; k < 9; ++k) to[k] += ((const float*)(sums + 9 * r + k))[lane];
    }
}

//: elastic
#define ADD_VISCOUS

//: viscous
#define ADD_VISCOUS { \
    Lanes C[9]; \
    strain_rate(a, c, per_J, C); \
    const Lanes inside = lesser(larger(J, Lanes{}), Lanes{} + 1.0f); \
    const Lanes eta = scale * inside * parameter(point, 2) * per_J; \
    for (int i = 0; i < 3; ++i) \
        for (int j = 0; j < 3; ++j) \
            for (int k = 0; k < 3; ++k) \
                P[3 * i + j] += eta * (C[3 * i + k] + C[3 * k + i]) * c[3 * k + j]; \
}

//: measure
const auto root = [](Lanes x) { return __builtin_elementwise_sqrt(x); };
const Lanes mu_of_all = parameter(0, 0), lam_of_all = parameter(0, 1);
alignas(64) Lanes sums[27];
for (int n = 0; n < 27; ++n) sums[n] = Lanes{};
Lanes steepest = {}, fastest = {}, doubt = {};
for (int point = 0; point < 8; ++point) {
    const Weights a = weigh(point);
    Lanes F[9], c[9], C[9], trace = {}, second = {}, rate = {};
    deform(a, F);
    const Lanes J = cofactors(F, c), safe = larger(J, Lanes{} + FLOOR);
    strain_rate(a, c, 1.0f / safe, C);
    Lanes square = {};
    for (int d = 0; d < 3; ++d) {
        Lanes speed = {};
        for (int r = 0; r < 9; ++r) {
            const Lanes* const n = W + 9 * r + d;
            const Lanes along = a.w[2][0] * n[0] + a.w[2][1] * n[3] + a.w[2][2] * n[6];
            speed += a.w[0][r / 3] * a.w[1][r % 3] * along;
        }
        square += speed * speed;
    }
    fastest = larger(fastest, square);
    for (int k = 0; k < 9; ++k) {
        trace += F[k] * F[k];
        second += c[k] * c[k];
        rate += C[k] * C[k];
    }
    // Newton's method from 0 approaches the least squared stretch from below.
    Lanes least = {};
    for (int step = 0; step < 10; ++step) {
        const Lanes value = ((least - trace) * least + second) * least - J * J;
        const Lanes slope = (3.0f * least - 2.0f * trace) * least + second;
        least -= value / larger(slope, Lanes{} + 1e-12f);
    }
    least = larger(least, Lanes{} + FLATTEST);
    const Lanes mu = alike ? mu_of_all : parameter(point, 0);
    const Lanes lam = larger(alike ? lam_of_all : parameter(point, 1), Lanes{});
    const Lanes log_J = logarithm(safe), denser = larger(1.0f - log_J, Lanes{} + 1.0f);
    const Lanes A = mu * (1.0f + 1.0f / least) + lam * denser / least;
    const Lanes density = *(const Lanes*)(place + (point * 5 + 4) * 16);
    Lanes stiffness = A / density;
    SHORTEN
    // Rows of the stiffness matrix are at most V A |grad w_i| sum |grad w_j|, in norms of sums.
    Lanes size[3][3], whole = {};
    for (int axis = 0; axis < 3; ++axis)
        for (int k = 0; k < 3; ++k) {
            size[axis][k] = larger(a.s[axis][k], -a.s[axis][k]);
            whole += size[axis][k];
        }
    const Lanes volume = *(const Lanes*)(place + (point * 5 + 3) * 16);
    const Lanes weight = volume * density * stiffness * whole;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            const Lanes across = a.w[0][i] * a.w[1][j] * weight;
            const Lanes along = (size[0][i] * a.w[1][j] + a.w[0][i] * size[1][j]) * weight;
            for (int k = 0; k < 3; ++k)
                sums[9 * i + 3 * j + k] += a.w[2][k] * along + size[2][k] * across;
        }
    steepest = larger(steepest, rate);
    doubt += rate * 0.0f + trace * 0.0f + square * 0.0f;
}
float* const most = (float*)maxima_out.data;
for (int lane = 0; lane < cells; ++lane) {
    if (!(doubt[lane] == 0.0f)) ((int*)stray_out.data)[0] += 1;
    const float here[2] = {__builtin_sqrtf(fastest[lane]), __builtin_sqrtf(steepest[lane])};
    for (int k = 0; k < 2; ++k) most[k] = here[k] > most[k] ? here[k] : most[k];
    const int* const of = row + 9L * (begin + lane);
    for (int r = 0; r < 9; ++r)
        for (int k = 0; k < 3; ++k)
            ((float*)bound_out.data)[of[r] - low + k] += ((const float*)(sums + 3 * r + k))[lane];
}

//: lossless
#define SHORTEN

//: shortened
#define SHORTEN { \
    const Lanes eta = parameter(point, 2); \
    const Lanes z = 2.0f * eta / (length * root(A * density) * least); \
    const Lanes shorter = root(1.0f + z * z) - z; \
    stiffness = stiffness / (shorter * shorter); \
}
