// The adjoint of blending: adds to each splat how much of the pixels' values it makes up.
// Plain form: `gather_pixels` of splat/gather.py.
// Test: tests/test_compose.py, test_both_forms_of_the_sums_agree_gaussian_by_gaussian.

for (int y = 0; y < rows; ++y)
    for (int x = 0; x < count; ++x) {
        const auto& value = values.data[(top + y) * view.width + left + x];
        R[16 * y + x] = value[0];
        G[16 * y + x] = value[1];
        B[16 * y + x] = value[2];
    }
alignas(64) float red[16], green[16], blue[16], all[16];
const auto add = [&](int index) {
    auto& sums = sums_out.data[index];
    for (int x = 8; x > 0; x /= 2)
        for (int j = 0; j < x; ++j) {
            red[j] += red[j + x];
            green[j] += green[j + x];
            blue[j] += blue[j + x];
            all[j] += all[j + x];
        }
    sums[0] += red[0];
    sums[1] += green[0];
    sums[2] += blue[0];
    weights_out.data[index] += all[0];
};
#define ON_SPLAT for (int x = 0; x < 16; ++x) red[x] = green[x] = blue[x] = all[x] = 0.0f;
#define ON_ROW const float *Rr = R + at, *Gr = G + at, *Br = B + at;
#define ON_PIXEL red[x] += weight * Rr[x]; green[x] += weight * Gr[x]; \
    blue[x] += weight * Br[x]; all[x] += weight;
#define AFTER_SPLAT add(index);
