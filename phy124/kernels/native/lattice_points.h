// Quantities computed from the strains and strain rates of sixteen cells, which lattice.h computes.
// Python version: `lattice_measure` of lattice/stress.py; `follow`, `locate` of lattice/points.py.
// Test: tests/test_lattice_kernels.py, test_simd_and_plain_points_agree.

//: measure
for (int point = 0; point < 8; ++point) {
    Lanes c[9], C[9];
    const Lanes J = cofactors(F_all[point], c);
    strain_rate(rates[point], c, 1.0f / larger(J, Lanes{} + FLOOR), C);
    survey(C, J);
}
report();

//: totals
// Elastic energy, power of the stress, range of J and invalid points. In double precision, because
// the energy of a small strain is a small difference of large numbers.
// Python version: `totals` of diagnostics.py. Test: test_simd_and_plain_totals_agree.
typedef double Doubles __attribute__((vector_size(128)));
typedef long long Longs __attribute__((vector_size(128)));
const auto wide = [](Lanes a) { return __builtin_convertvector(a, Doubles); };
// log x for x > 0, like `logarithm`, but exact up to rounding.
const auto wide_logarithm = [](Doubles x) {
    const Longs bits = (Longs)x, exponent = (bits - 0x3fe6a09e667f3bcd) >> 52;
    const Doubles m = (Doubles)(bits - (exponent << 52)), t = (m - 1.0) / (m + 1.0), t2 = t * t;
    Doubles series = {};
    for (int odd = 23; odd > 0; odd -= 2) series = series * t2 + 1.0 / odd;
    return __builtin_convertvector(exponent, Doubles) * 0.69314718055994531 + 2.0 * t * series;
};
Doubles elastic = {}, power = {}, least = Doubles{} + __builtin_inf(), largest = -least;
for (int point = 0; point < 8; ++point) {
    Lanes narrow[9], rate[9];
    const Lanes near = cofactors(F_all[point], narrow);
    strain_rate(rates[point], narrow, 1.0f / larger(near, Lanes{} + FLOOR), rate);
    Doubles F[9], c[9], C[9], square = {}, turned = {};
    for (int k = 0; k < 9; ++k) F[k] = wide(F_all[point][k]), C[k] = wide(rate[k]);
    for (int k = 0; k < 9; ++k) square += F[k] * F[k];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            for (int k = 0; k < 3; ++k) turned += C[3 * i + j] * F[3 * i + k] * F[3 * j + k];
    const Doubles J = cofactors(F, c), safe = J > 1.0e-4 ? J : Doubles{} + 1.0e-4;
    const Doubles log_J = wide_logarithm(safe) + (J - safe) / 1.0e-4;
    const Doubles mu = wide(parameter(point, 0)), lam = wide(parameter(point, 1));
    const Doubles volume = wide(*(const Lanes*)(place + (point * 4 + 3) * 16));
    const Doubles psi = 0.5 * mu * (square - 3.0) + (0.5 * lam * log_J - mu) * log_J;
    const Doubles work = mu * turned + (lam * log_J - mu) * (C[0] + C[4] + C[8]);
    const Longs sound = (psi + J + work) * 0.0 == 0.0;
    elastic += sound ? psi * volume : Doubles{};
    power += sound ? work * volume : Doubles{};
    least = (sound & (J < least)) ? J : least;
    largest = (sound & (J > largest)) ? J : largest;
    const Longs wrong = ~sound | (J <= 0.0);
    if (!__builtin_reduce_or(wrong)) continue;
    for (int lane = 0; lane < 16; ++lane) {
        if (!wrong[lane] || !(volume[lane] > 0)) continue;
        const int kind = sound[lane] ? 1 : 0, index = 8 * cells[lane] + point;
        int* const lowest = (int*)first_out.data + kind;
        ((int*)counts_out.data)[kind] += 1;
        *lowest = index < *lowest ? index : *lowest;
    }
}
double *const sums = (double*)sums_out.data, *const range = (double*)range_out.data;
for (int lane = 0; lane < 16; ++lane) {
    sums[ELASTIC] += elastic[lane], sums[POWER] += power[lane];
    range[0] = -least[lane] > range[0] ? -least[lane] : range[0];
    range[1] = largest[lane] > range[1] ? largest[lane] : range[1];
}

//: places
// Writes the points' positions and velocities, the latter also with `keep` (index, value).
const float* const still = (const float*)rest.data;
const auto place_points = [&](const Lanes* velocities, auto keep) {
    alignas(64) Lanes shift[8][3], speed[8][3];
    interpolate(U, shift);
    interpolate(velocities, speed);
    for (int point = 0; point < 8; ++point) {
        alignas(64) Lanes moved[8] = {};
        for (int d = 0; d < 3; ++d) moved[d] = shift[point][d], moved[3 + d] = speed[point][d];
        transpose(moved);
        for (int k = 0; k < 16; ++k) {
            const long p = 3 * (8L * cells[k] + point);
            const float* const row = (const float*)(moved + k % 8) + k / 8 * 8;
            for (int d = 0; d < 3; ++d) {
                ((float*)x_out.data)[p + d] = still[p + d] + row[d];
                ((float*)v_out.data)[p + d] = row[3 + d];
                keep(p + d, row[3 + d]);
            }
        }
    }
};

//: follow
place_points(W, [](long, float) {});
// Writes nine numbers of a point for each cell.
const auto store = [&](const Lanes* values, float* to, int point) {
    Lanes m[8];
    for (int k = 0; k < 8; ++k) m[k] = values[k];
    transpose(m);
    for (int k = 0; k < 16; ++k) {
        float* const out = to + 9 * (8L * cells[k] + point);
        *(Eight*)out = *(const Eight*)((const float*)(m + k % 8) + k / 8 * 8);
        out[8] = ((const float*)(values + 8))[k];
    }
};
for (int point = 0; point < 8; ++point) {
    Lanes c[9], C[9];
    const Lanes J = cofactors(F_all[point], c);
    strain_rate(rates[point], c, 1.0f / larger(J, Lanes{} + FLOOR), C);
    store(C, (float*)C_out.data, point);
    store(F_all[point], (float*)F_out.data, point);
}

//: locate
alignas(64) Lanes W[81];
collect((const float*)v.data, W);
place_points(W, [&](long index, float value) { ((float*)v_kept_out.data)[index] = value; });
