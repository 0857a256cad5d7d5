// Sums over the neighbours of a cell's low faces in float32: one lane for each of the three faces.
// Python version: `around` of liquid/spread.py.
// Test: tests/test_liquid_spread.py, test_simd_and_plain_sums_over_neighbours_agree.

typedef float Quad __attribute__((vector_size(16), aligned(4)));
typedef int Mask __attribute__((vector_size(16)));
const auto where = [](Mask mask, Quad values) { return (Quad)(mask & (Mask)values); };
const Mask bits = {1, 2, 4, 0};
const Quad unit = {1.0f, 1.0f, 1.0f, 1.0f};
const int steps[6] = {-layer, layer, -row, row, -1, 1};
Quad total = {}, count = {}, gain = {}, mass = {};
for (int k = 0; k < 6; ++k) {
    const long m = n + steps[k];
    const Mask open = (known.data[m] & bits) != 0;
    const Quad v = *(const Quad*)((const float*)velocity.data + 4 * m);
    total += where(open, v);
    count += where(open, unit);
    if (cells.data == nullptr) continue;
    const float* const cell = (const float*)cells.data + 8 * m;
    const Quad momentum = *(const Quad*)cell, heavy = *(const Quad*)(cell + 4);
    const Mask moving = open & (heavy > 0.0f);
    gain += where(moving, heavy * v - momentum);
    mass += where(moving, heavy);
}
return wp::mat_t<4, 4, wp::float32>(
    total[0], total[1], total[2], 0.0f, count[0], count[1], count[2], 0.0f,
    gain[0], gain[1], gain[2], 0.0f, mass[0], mass[1], mass[2], 0.0f);
