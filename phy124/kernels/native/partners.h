// The next sampled point that may touch a sampled point; sixteen points are compared at a time.
// `places` contains six rows of numbers: the components of the current positions, and those of the
// positions at rest. `places` is filled up to a multiple of sixteen points with infinite positions. The
// bounds are slightly widened, since the caller compares the distances again.
// Python version: `touches` of lattice/partners.py.
// Test: tests/test_meetings.py, test_simd_and_plain_flags_agree.

//: next
typedef float Lanes __attribute__((vector_size(64), aligned(4)));
typedef int Mask __attribute__((vector_size(64)));
const float* const of = (const float*)places.data;
const long count = places.shape[1];
const float widest = 1.0001f * far * far, nearest = 1.0001f * nearer * nearer;
const Mask always = Mask{} - (loose ? 1 : 0);
for (long k = first / 16 * 16; k < count; k += 16) {
    Lanes now = {}, still = {};
    for (int d = 0; d < 3; ++d) {
        const float *const x = of + d * count, *const rest = x + 3 * count;
        const Lanes a = *(const Lanes*)(x + k) - x[i], b = *(const Lanes*)(rest + k) - rest[i];
        now += a * a, still += b * b;
    }
    const Mask near = (now < widest) & ((now < nearest * still) | always);
    if (!__builtin_reduce_or(near)) continue;
    for (int lane = 0; lane < 16; ++lane)
        if (near[lane] && k + lane >= first && k + lane != i) return k + lane;
}
return count;
