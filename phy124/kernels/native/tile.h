// A tile of 16 x 16 pixels, with three numbers R, G, B for each pixel. A row of a tile is 16
// floats: one AVX-512, two AVX2 or four NEON registers. The code for a row has no branch; a
// finished pixel (T < 0) and a skipped splat contribute with weight zero instead.
// Python version: `blend_tiles` of splat/blend.py.
// Test: tests/test_render.py, test_the_forms_agree_with_each_other.

const int tile = first + thread;
// Transmittance of each pixel; negative: the pixel is finished.
alignas(64) float T[256], R[256], G[256], B[256];
const int left = tile % view.columns * 16, top = tile / view.columns * 16;
const int right = left + 16 < view.width ? left + 16 : view.width, count = right - left;
const int bottom = top + 16 < view.height ? top + 16 : view.height, rows = bottom - top;
for (int j = 0; j < 256; ++j) {
    // Pixels beyond the image's edge are finished from the start.
    T[j] = j % 16 < count && j / 16 < rows ? 1.0f : -1.0f;
    R[j] = G[j] = B[j] = 0.0f;
}

//: light
#define ON_SPLAT const float red = splat.colour[0], green = splat.colour[1], blue = splat.colour[2];
#define ON_ROW ((Row*)R)[y] += weight * red; ((Row*)G)[y] += weight * green; \
    ((Row*)B)[y] += weight * blue;
#define AFTER_SPLAT

//: splats
// Loops over the splats from front to back, until all pixels are finished. Macros define what is
// done: ON_SPLAT for splat `index`; ON_ROW for each row `y` within the splat's reach, with the
// splat's `weight` at the row's pixels; AFTER_SPLAT after the splat.
{
    typedef float Row __attribute__((vector_size(64)));
    typedef bool Flags __attribute__((ext_vector_type(16)));
    Row centres, lines;
    for (int j = 0; j < 16; ++j) {
        centres[j] = (float)(left + j) + 0.5f;
        lines[j] = (float)(top + j) + 0.5f;
    }
    const Row none = {0.0f}, nearest = none + centres[0], farthest = none + centres[15];
    const float HALF_LOG2_E = 0.72134752f;
    const auto power_of_2_for_row = [&](Row power) {
        typedef int Bits __attribute__((vector_size(64)));
        const Row shifted = power + 12582912.0f;
        return (Row)((Bits)power_near_0(power - (shifted - 12582912.0f)) + ((Bits)shifted << 23));
    };
    unsigned open = 0xffff;  // one bit for each row that has unfinished pixels
    const int begin = starts.data[tile], end = ends.data[tile];

    for (int k = begin; k < end; ++k) {
        // Splats of a tile are scattered in memory, so the splats that are needed next are
        // prefetched.
        if (k + 6 < end) __builtin_prefetch(&splats.data[pairs.data[k + 6]]);
        const int index = pairs.data[k];
        const auto& splat = splats.data[index];
        const float cx = -HALF_LOG2_E * splat.precision_x;
        const float cy = -HALF_LOG2_E * splat.precision_y;
        const float opacity = splat.opacity, least = splat.least - 0.01f;
        // All rows at once: the splat's middle, and the exponent there. Rows whose nearest pixel is
        // out of reach are not changed.
        const Row dy = lines - splat.mean[1];
        const Row middles = splat.mean[0] + splat.shear * dy, powers = cy * dy * dy;
        Row aside = middles < nearest ? nearest : middles;
        aside = (aside > farthest ? farthest : aside) - middles;
        const Flags reached = __builtin_convertvector(cx * aside * aside + powers >= least, Flags);
        unsigned short bits;  // one for each row
        __builtin_memcpy(&bits, &reached, 2);
        ON_SPLAT
        for (unsigned rest = bits & open; rest; rest &= rest - 1) {
            const int y = __builtin_ctz(rest);
            const Row dx = centres - middles[y];
            const Row power = cx * dx * dx + powers[y];      // exponent of 2, never positive
            Row alpha = opacity * power_of_2_for_row(power > -30.0f ? power : none - 30.0f);  // also if NaN
            alpha = alpha < MAX_ALPHA ? alpha : none + MAX_ALPHA;
            const Row t = ((Row*)T)[y], left_over = t * (1.0f - alpha);
            const auto hit = (alpha >= MIN_ALPHA) & (t > 0.0f);
            const auto counts = hit & (left_over >= MIN_TRANSMITTANCE);
            const Row weight = counts ? alpha * t : none;
            ((Row*)T)[y] = counts ? left_over : (hit ? -t : t);
            ON_ROW
        }
        AFTER_SPLAT
        if ((k - begin) % 8 == 7) {
            for (int r = 0; r < 16; ++r)
                if (!__builtin_reduce_or(((const Row*)T)[r] > 0.0f)) open &= ~(1u << r);
            if (!open) break;
        }
    }
}

//: store
for (int y = 0; y < rows; ++y) {
    const int pixel = (top + y) * view.width + left;
    float* __restrict image = (float*)(image_out.data + pixel);
    float* __restrict alpha = alpha_out.data + pixel;
    const float behind[3] = {background[0], background[1], background[2]};
    const auto stored = [&](int x) {
        const int j = 16 * y + x;
        const float t = T[j] < 0.0f ? -T[j] : T[j];
        const float red = R[j] + t * behind[0], green = G[j] + t * behind[1];
        const float blue = B[j] + t * behind[2];
        image[3 * x] = red < 1.0f ? red : 1.0f;
        image[3 * x + 1] = green < 1.0f ? green : 1.0f;
        image[3 * x + 2] = blue < 1.0f ? blue : 1.0f;
        alpha[x] = 1.0f - t;
    };
    if (count == 16) {
        #pragma clang loop vectorize(assume_safety) interleave(disable) unroll(disable)
        for (int x = 0; x < 16; ++x) stored(x);
    } else {
        for (int x = 0; x < count; ++x) stored(x);
    }
}

//: gather
// The adjoint of blending: adds the pixels' values to each splat, weighted by its contribution.
// Python version: `gather_pixels` of splat/blend.py.
// Test: tests/test_compose.py, test_both_forms_of_the_sums_agree_gaussian_by_gaussian.

for (int y = 0; y < rows; ++y)
    for (int x = 0; x < count; ++x) {
        const auto& value = values.data[(top + y) * view.width + left + x];
        R[16 * y + x] = value[0];
        G[16 * y + x] = value[1];
        B[16 * y + x] = value[2];
    }
typedef float Row __attribute__((vector_size(64)));
Row red, green, blue, all;
const auto total = [](Row values) {
    for (int x = 8; x > 0; x /= 2)
        for (int j = 0; j < x; ++j) values[j] += values[j + x];
    return values[0];
};
#define ON_SPLAT red = green = blue = all = none;
#define ON_ROW red += weight * ((const Row*)R)[y]; green += weight * ((const Row*)G)[y]; \
    blue += weight * ((const Row*)B)[y]; all += weight;
#define AFTER_SPLAT sums_out.data[index][0] += total(red); \
    sums_out.data[index][1] += total(green); sums_out.data[index][2] += total(blue); \
    weights_out.data[index] += total(all);

//: bin
// Appends every splat, front to back, to the lists of the tiles that it touches.
// Python version: `bin_parallel` of splat/project.py, whose lists are then sorted.
// Test: tests/test_render.py, test_the_forms_agree_with_each_other.

int* __restrict slots = ends_out.data;
int* __restrict lists = pairs_out.data;
const auto* __restrict boxes = tiles.data;
const int* __restrict sorted = order.data;
for (int k = 0; k < count; ++k) {
    // Splats are scattered in memory: prefetch one that is needed soon.
    if (k + 16 < count) __builtin_prefetch(&boxes[sorted[k + 16]]);
    const int i = sorted[k];
    const auto box = boxes[i];
    for (int row = box[1]; row < box[3]; ++row)
        for (int tile = row * columns + box[0]; tile < row * columns + box[2]; ++tile)
            if (tile >= first && tile < last) lists[slots[tile]++] = i;
}
