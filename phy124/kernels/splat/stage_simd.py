"""The stage for CPUs: `stage.draw_setting` in C++ whose runs of 16 pixels are vectorised."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.screen import View
from phy124.kernels.splat.stage import Setting

DRAW_ROW = r"""
    const int width = view.width, cells = setting.cells;
    const float pool_most = setting.pool, tint[3] = {0.36f, 0.44f, 0.52f};
    const float down = ((float)y + 0.5f) / (float)view.height;
    float plain[3], right[3], first[3];
    for (int c = 0; c < 3; ++c) {
        plain[c] = (1.0f - down) * setting.top[c] + down * setting.bottom[c];
        right[c] = view.rotation.data[0][c] / view.focal;
        first[c] = view.rotation.data[2][c]
            + (0.5f - view.centre[0]) * right[c]
            + ((float)y + 0.5f - view.centre[1]) / view.focal * view.rotation.data[1][c];
    }
    const float above = view.eye[2] - setting.height;
    const bool floored = setting.floor == 1 && above > 0.0f;
    const bool pictured = picture.shape[0] > 0, glazed = glass.shape[0] > 0;
    const float scale = 0.5f * (float)cells / setting.reach, last = (float)(cells - 1);
    const float ex = view.eye[0] - setting.middle[0], ey = view.eye[1] - setting.middle[1];
    const float* __restrict shades = shade.data;
    float light[16], pool[16];

    for (int left = 0; left < width; left += 16) {
        const int count = left + 16 < width ? 16 : width - left, pixel = y * width + left;
        const float* __restrict covered = coverage.data + pixel;
        float most = 0.0f;
        for (int x = 0; x < count; ++x) most = 1.0f - covered[x] > most ? 1.0f - covered[x] : most;
        if (most <= 1e-3f) continue;
        const float rz = first[2] + (float)left * right[2], end = rz + 15.0f * right[2];
        const bool seen = floored && (rz < 0.0f || end < 0.0f);
        if (seen) {
            #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
            for (int x = 0; x < 16; ++x) {
                const float at = (float)(left + x), z = first[2] + at * right[2];
                const float limit = -above / (z < -1e-12f ? z : -1e-12f);
                const float u = ex + limit * (first[0] + at * right[0]);
                const float v = ey + limit * (first[1] + at * right[1]);
                const float far_u = u / setting.reach, far_v = v / setting.reach;
                float rest = 1.0f - 0.5f * (far_u * far_u + far_v * far_v);
                rest = rest > 0.0f ? rest : 0.0f;
                const float cu = (u + setting.reach) * scale - 0.5f;
                const float cv = (v + setting.reach) * scale - 0.5f;
                const bool inside = cu >= 0.0f && cv >= 0.0f && cu < last && cv < last && z < 0.0f;
                const int i = inside ? (int)cu : 0, j = inside ? (int)cv : 0;
                const float a = cu - (float)i, b = cv - (float)j;
                const int cell = i * cells + j;
                const float nearer = shades[cell] + a * (shades[cell + cells] - shades[cell]);
                const float farther = shades[cell + 1]
                    + a * (shades[cell + cells + 1] - shades[cell + 1]);
                light[x] = inside ? 1.0f - (nearer + b * (farther - nearer)) : 1.0f;
                pool[x] = z < 0.0f ? pool_most * rest * rest : 0.0f;
            }
        }
        for (int x = 0; x < count; ++x) {
            const float open = 1.0f - covered[x];
            if (open <= 1e-3f) continue;
            const float veil = glazed ? glass.data[pixel + x] : 0.0f;
            for (int c = 0; c < 3; ++c) {
                float colour = pictured ? picture.data[pixel + x][c] : plain[c];
                if (seen) colour = light[x] * (colour + pool[x] * colour * (1.0f - colour));
                colour += veil * (tint[c] - colour);
                const float value = image_out.data[pixel + x][c] + open * colour;
                image_out.data[pixel + x][c] = value < 1.0f ? value : 1.0f;
            }
        }
    }
"""


@wp.func_native(DRAW_ROW)
def draw_row(
    y: int,
    view: View,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    glass: wp.array(dtype=float),
    coverage: wp.array(dtype=float),
    image_out: wp.array(dtype=wp.vec3),
):
    """Draw one row of pixels."""
    ...


@kernel("phy124_stage_simd")
def draw_setting_simd(
    # model
    view: View,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    # state in
    glass: wp.array(dtype=float),
    coverage: wp.array(dtype=float),
    # in place: light of the Gaussians, then the picture
    image_out: wp.array(dtype=wp.vec3),
):
    """One thread per row."""
    draw_row(wp.tid(), view, setting, shade, picture, glass, coverage, image_out)
