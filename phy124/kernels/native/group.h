// Sixteen Gaussians that lie side by side in memory. Fewer, at the end, are followed by zeros.
// Plain form: the arrays of Gaussians.
// Test: tests/test_render.py, test_the_forms_agree_with_each_other.

const int begin = 16 * thread, total = means.shape[0];
const int count = begin + 16 < total ? 16 : total - begin;
const float* place = (const float*)(means.data + begin);
const float* quat = (const float*)(quats.data + begin);
const float* size = (const float*)(scales.data + begin);
const float* opaque = opacities.data + begin;
float spare[16 * 11];
if (count < 16) {
    float* to = spare;
    const auto copied = [&](const float* from, int width) {
        const float* start = to;
        for (int k = 0; k < 16 * width; ++k) *to++ = k < width * count ? from[k] : 0.0f;
        return start;
    };
    place = copied(place, 3);
    quat = copied(quat, 4);
    size = copied(size, 3);
    opaque = copied(opaque, 1);
}
