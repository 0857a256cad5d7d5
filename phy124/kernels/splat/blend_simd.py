"""Blending by tile for CPUs: `blend.blend_tiles` in C++ whose pixel rows the compiler vectorises.

A row of a tile is 16 floats: one AVX-512, two AVX2 or four NEON registers. The loop over a row has
no branch; a finished pixel (T < 0) and a skipped splat contribute a weight of zero instead.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.elementary_simd import FUNCTIONS
from phy124.kernels.splat.screen import Splat, View

BLEND_TILE = (
    FUNCTIONS
    + r"""
    alignas(64) float T[256], R[256], G[256], B[256], centres[16];
    const int left = tile % view.columns * 16, top = tile / view.columns * 16;
    for (int j = 0; j < 256; ++j) {
        // Beyond the image's edge a pixel counts as done from the start.
        T[j] = left + j % 16 < view.width && top + j / 16 < view.height ? 1.0f : -1.0f;
        R[j] = G[j] = B[j] = 0.0f;
    }
    for (int j = 0; j < 16; ++j) centres[j] = (float)(left + j) + 0.5f;
    const float nearest = centres[0], farthest = centres[15];
    const float HALF_LOG2_E = 0.72134752f;
    int open = 0xffff;  // rows with pixels that are not done, a bit each
    const int begin = starts.data[tile], end = ends.data[tile];

    for (int k = begin; k < end; ++k) {
        // Splats of a tile lie anywhere in memory: fetch one that comes soon.
        if (k + 6 < end) __builtin_prefetch(&splats.data[pairs.data[k + 6]]);
        const auto& splat = splats.data[pairs.data[k]];
        const int y0 = splat.box[1] > top ? splat.box[1] : top;
        const int y1 = splat.box[3] < top + 16 ? splat.box[3] : top + 16;
        const float cx = -HALF_LOG2_E * splat.precision_x, cy = -HALF_LOG2_E * splat.precision_y;
        const float opacity = splat.opacity, least = splat.least - 0.01f;
        const float red = splat.colour[0], green = splat.colour[1], blue = splat.colour[2];
        for (int y = y0; y < y1; ++y) {
            if (!(open >> (y - top) & 1)) continue;
            const float dy = (float)y + 0.5f - splat.mean[1];
            const float middle = splat.mean[0] + splat.shear * dy, row = cy * dy * dy;
            // A row whose nearest pixel is out of reach stays as it is.
            const float inside = middle < nearest ? nearest : middle > farthest ? farthest : middle;
            if (cx * (inside - middle) * (inside - middle) + row < least) continue;
            const int at = (y - top) * 16;
            float* __restrict Tr = T + at;
            float* __restrict Rr = R + at;
            float* __restrict Gr = G + at;
            float* __restrict Br = B + at;
            #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
            for (int x = 0; x < 16; ++x) {
                const float dx = centres[x] - middle;
                float power = cx * dx * dx + row;            // in powers of 2, never positive
                power = power > -30.0f ? power : -30.0f;     // also where it is NaN
                float alpha = opacity * power_of_2(power);
                alpha = alpha < 0.99f ? alpha : 0.99f;
                const float t = Tr[x], left_over = t * (1.0f - alpha);
                const bool hit = alpha >= 0.00392156863f && t > 0.0f;
                const bool counts = hit && left_over >= 1e-4f;
                const float weight = counts ? alpha * t : 0.0f;
                Tr[x] = counts ? left_over : (hit ? -t : t);
                Rr[x] += weight * red;
                Gr[x] += weight * green;
                Br[x] += weight * blue;
            }
        }
        if ((k - begin) % 8 == 7) {
            for (int r = 0; r < 16; ++r) {
                float most = -1.0f;
                for (int j = 16 * r; j < 16 * r + 16; ++j) most = T[j] > most ? T[j] : most;
                if (most <= 0.0f) open &= ~(1 << r);
            }
            if (!open) break;
        }
    }

    const int right = left + 16 < view.width ? left + 16 : view.width;
    const int bottom = top + 16 < view.height ? top + 16 : view.height;
    for (int y = top; y < bottom; ++y)
        for (int x = left; x < right; ++x) {
            const int j = (y - top) * 16 + x - left, pixel = y * view.width + x;
            const float t = T[j] < 0.0f ? -T[j] : T[j];
            const float light[3] = {R[j], G[j], B[j]};
            for (int c = 0; c < 3; ++c) {
                const float value = light[c] + t * background[c];
                image_out.data[pixel][c] = value < 1.0f ? value : 1.0f;
            }
            alpha_out.data[pixel] = 1.0f - t;
        }
"""
)


@wp.func_native(BLEND_TILE)
def blend_tile(
    tile: int,
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    view: View,
    background: wp.vec3,
    image_out: wp.array(dtype=wp.vec3),
    alpha_out: wp.array(dtype=float),
):
    """Blend one tile of 16 x 16 pixels."""
    ...


@kernel("phy124_blend_simd")
def blend_tiles_simd(
    # model
    view: View,
    background: wp.vec3,
    first: int,
    # state in
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    # out
    image_out: wp.array(dtype=wp.vec3),
    alpha_out: wp.array(dtype=float),
):
    """One thread per tile."""
    tile = first + wp.tid()
    blend_tile(tile, starts, ends, pairs, splats, view, background, image_out, alpha_out)
