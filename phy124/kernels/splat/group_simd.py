"""Sixteen Gaussians that lie side by side in memory, as C++ for CPUs reads them.

`GROUP` is put before the code of a native function that has a `group` and the arrays of a cloud of
Gaussians. Fewer than sixteen, at the end, are followed by zeros.
"""

GROUP = r"""
    const int begin = 16 * group, total = means.shape[0];
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
"""
