// Elementary functions for vectorised loops.
// Python version: wp.exp and wp.log.
// Test: tests/test_render.py, test_the_forms_agree_with_each_other.

// Returns 2^rest for numbers or vectors |rest| <= 1/2, by a Taylor series.
const auto power_near_0 = [](auto rest) {
    return 1.0f + rest * (0.693147181f + rest * (0.240226507f
        + rest * (0.0555041087f + rest * (0.00961812911f + rest * 0.00133335581f))));
};
// Returns 2^power for -126 < power < 127. Adding 1.5 2^23 rounds to the nearest integer; its bits
// are then added to the exponent.
const auto power_of_2 = [&](float power) {
    const float shifted = power + 12582912.0f;
    union { float value; int bits; } whole, result;
    whole.value = shifted;
    result.value = power_near_0(power - (shifted - 12582912.0f));
    result.bits += whole.bits << 23;
    return result.value;
};
// Returns the natural logarithm of a normal number above 0. The fraction f of the number is between
// sqrt(1/2) and sqrt(2), and log f is 2 artanh((f - 1) / (f + 1)).
const auto logarithm = [](float x) {
    union { float value; int bits; } given, fraction;
    given.value = x;
    const int exponent = (given.bits - 0x3f3504f3) >> 23;
    fraction.bits = given.bits - exponent * 0x800000;
    const float s = (fraction.value - 1.0f) / (fraction.value + 1.0f), t = s * s;
    return 0.693147181f * (float)exponent + 2.0f * s * (1.0f + t * (0.333333333f
        + t * (0.2f + t * (0.142857143f + t * 0.111111111f))));
};

//: sixteen
// Sixteen Gaussians that are consecutive in memory. If fewer than sixteen remain at the end, the
// rest is filled with zeros.
// Python version: the arrays of Gaussians.
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
