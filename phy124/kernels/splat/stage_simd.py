"""The stage for CPUs: `stage.draw_setting` and `stage.tint_splats` in C++, sixteen at a time.

Each tile is drawn right after its Gaussians. Where the corners of a tile see the same two faces of
a box, away from its edges, so does all of the tile, since faces are convex: its opacity is one
number there.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.blend_simd import blend_tile
from phy124.kernels.splat.glass import Outline, Solid
from phy124.kernels.splat.glass_simd import GLASS
from phy124.kernels.splat.screen import Splat, View
from phy124.kernels.splat.stage import Setting

OPEN = r"""
    typedef float Row __attribute__((vector_size(64), aligned(4)));
    const int width = view.width;
    const int left = tile % view.columns * 16, top = tile / view.columns * 16;
    const int right = left + 16 < width ? left + 16 : width, count = right - left;
    const int bottom = top + 16 < view.height ? top + 16 : view.height, rows = bottom - top;
    // How much of what is behind is seen; Gaussians may let through less than a byte can tell.
    const Row none = {0.0f};
    Row open[16], widest = none;
    for (int y = 0; y < rows; ++y) {
        const float* covered = coverage.data + (top + y) * width + left;
        Row rest = none;
        if (count == 16) rest = 1.0f - *(const Row*)covered;
        else for (int x = 0; x < count; ++x) rest[x] = 1.0f - covered[x];
        open[y] = rest > 1e-3f ? rest : none;
        widest = open[y] > widest ? open[y] : widest;
    }
    float most_open = 0.0f;
    for (int x = 0; x < 16; ++x) most_open = widest[x] > most_open ? widest[x] : most_open;
    if (most_open == 0.0f) return;
"""

AIM = r"""
    const float step = 1.0f / view.focal, above = view.eye[2] - setting.height;
    const bool floored = setting.floor == 1 && above > 0.0f;
    const auto& turn = view.rotation.data;
    const auto aim = [&](Rays& rays, const float* xs, const float* ys) {
        #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
        for (int i = 0; i < 16; ++i) {
            const float u = (xs[i] - view.centre[0]) * step, v = (ys[i] - view.centre[1]) * step;
            rays.x[i] = turn[0][0] * u + turn[1][0] * v + turn[2][0];
            rays.y[i] = turn[0][1] * u + turn[1][1] * v + turn[2][1];
            const float z = turn[0][2] * u + turn[1][2] * v + turn[2][2];
            rays.z[i] = z;
            rays.limit[i] = floored && z < 0.0f ? -above / (z < -1e-12f ? z : -1e-12f) : 1e30f;
            rays.pixel[i] = step;
        }
    };
    float xs[16], ys[16];
    Rays rays;
"""

CLEAR = r"""
    Row clear[16];  // what solids let through
    for (int y = 0; y < 16; ++y) clear[y] = none + 1.0f;
    const float middle_x = 0.5f * (float)(left + right), middle_y = 0.5f * (float)(top + bottom);
    const float half_x = 0.5f * (float)(count - 1), half_y = 0.5f * (float)(rows - 1);
    for (int k = 0; k < solids.shape[0]; ++k) {
        if (beside(outlines.data[k], middle_x, middle_y, half_x, half_y)) continue;
        Veil veil;
        for (int i = 0; i < 16; ++i) {
            xs[i] = middle_x + (i & 1 ? half_x : -half_x);
            ys[i] = middle_y + (i & 2 ? half_y : -half_y);
        }
        aim(rays, xs, ys);
        veil_of(solids.data[k], rays, veil);
        int faces = veil.faces[0];
        for (int i = 1; i < 4; ++i) faces = veil.faces[i] == faces ? faces : 0;
        for (int i = 0; i < 16; ++i) xs[i] = (float)(left + i) + 0.5f;
        for (int y = 0; y < rows; ++y) {
            if (faces) {
                clear[y] *= 1.0f - veil.alpha[0];
                continue;
            }
            const float at = (float)(top + y) + 0.5f;
            if (beside(outlines.data[k], middle_x, at, half_x, 0.0f)) continue;
            for (int i = 0; i < 16; ++i) ys[i] = at;
            aim(rays, xs, ys);
            veil_of(solids.data[k], rays, veil);
            clear[y] *= 1.0f - *(const Row*)veil.alpha;
        }
    }
"""

LIGHT = r"""
    const float* __restrict shades = shade.data;
    const int cells = setting.cells;
    const float last = (float)(cells - 1), nearer = 1.0f / setting.reach;
    const float scale = 0.5f * (float)cells * nearer, middle = 0.5f * last;
    const float ex = view.eye[0] - setting.middle[0], ey = view.eye[1] - setting.middle[1];
    float light[16], pool[16], at_i[16], at_j[16];
    // What the floor takes of the backdrop's light along rays, and adds to it in the middle.
    const auto shine = [&]() {
        #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
        for (int i = 0; i < 16; ++i) {
            const float limit = rays.limit[i] < 1e30f ? rays.limit[i] : 0.0f;
            const float u = ex + limit * rays.x[i], v = ey + limit * rays.y[i];
            const float rest = 1.0f - 0.5f * (u * u + v * v) * nearer * nearer;
            const bool on = rays.limit[i] < 1e30f;
            pool[i] = on && rest > 0.0f ? setting.pool * rest * rest : 0.0f;
            at_i[i] = on ? u * scale + middle : -1.0f;
            at_j[i] = on ? v * scale + middle : -1.0f;
            light[i] = 1.0f;
        }
        const auto outside = [&](const float* at) {
            return (at[0] < 0.0f && at[15] < 0.0f) || (at[0] >= last && at[15] >= last);
        };
        if (outside(at_i) || outside(at_j)) return;
        #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
        for (int x = 0; x < 16; ++x) {
            const float u = at_i[x], v = at_j[x];
            const bool inside = u >= 0.0f && v >= 0.0f && u < last && v < last;
            const int i = inside ? (int)u : 0, j = inside ? (int)v : 0, cell = i * cells + j;
            const float a = u - (float)i, b = v - (float)j;
            const float one = shades[cell] + a * (shades[cell + cells] - shades[cell]);
            const float two = shades[cell + 1]
                + a * (shades[cell + cells + 1] - shades[cell + 1]);
            light[x] = inside ? 1.0f - (one + b * (two - one)) : 1.0f;
        }
    };
"""

DRAW = r"""
    // Three colours of sixteen pixels lie side by side in three rows.
    #define SPREAD(a, ...) __builtin_shufflevector(a, a, __VA_ARGS__)
    #define FIRST(a) SPREAD(a, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 5)
    #define SECOND(a) SPREAD(a, 5, 5, 6, 6, 6, 7, 7, 7, 8, 8, 8, 9, 9, 9, 10, 10)
    #define THIRD(a) SPREAD(a, 10, 11, 11, 11, 12, 12, 12, 13, 13, 13, 14, 14, 14, 15, 15, 15)
    const bool pictured = picture.shape[0] > 0;
    float first[48], change[48], tints[48];
    for (int j = 0; j < 16; ++j)
        for (int c = 0; c < 3; ++c) {
            first[3 * j + c] = setting.top[c];
            change[3 * j + c] = setting.bottom[c] - setting.top[c];
            tints[3 * j + c] = TINT[c];
        }
    for (int i = 0; i < 16; ++i) xs[i] = (float)(left + i) + 0.5f;
    for (int y = 0; y < rows; ++y) {
        const float at = (float)(top + y) + 0.5f, down = at / (float)view.height;
        for (int i = 0; i < 16; ++i) ys[i] = at;
        aim(rays, xs, ys);
        shine();
        const Row seen = open[y] * clear[y] * *(const Row*)light, added = seen * *(const Row*)pool;
        const Row hidden = open[y] * (1.0f - clear[y]);
        const int start = (top + y) * width + left;
        float* image = (float*)(image_out.data + start);
        const float* photo = (const float*)(picture.data + start);
        float part[48], shown[48];
        if (count < 16) {  // at the right border
            for (int j = 0; j < 3 * count; ++j) part[j] = image[j];
            if (pictured) for (int j = 0; j < 3 * count; ++j) shown[j] = photo[j];
            photo = shown;
        }
        float* drawn = count < 16 ? part : image;
        const auto draw = [&](int k, Row a, Row b, Row d) {
            const Row plain = *(const Row*)(first + k) + down * *(const Row*)(change + k);
            const Row behind = pictured ? *(const Row*)(photo + k) : plain;
            const Row now = *(const Row*)(drawn + k) + a * behind
                + b * behind * (1.0f - behind) + d * *(const Row*)(tints + k);
            *(Row*)(drawn + k) = now < 1.0f ? now : none + 1.0f;
        };
        draw(0, FIRST(seen), FIRST(added), FIRST(hidden));
        draw(16, SECOND(seen), SECOND(added), SECOND(hidden));
        draw(32, THIRD(seen), THIRD(added), THIRD(hidden));
        if (count < 16) for (int j = 0; j < 3 * count; ++j) image[j] = part[j];
    }
"""

TINT_GROUP = (
    GLASS
    + r"""
    typedef float Row __attribute__((vector_size(64), aligned(4)));
    const int first = 16 * group, total = means.shape[0];
    const int count = first + 16 < total ? 16 : total - first;
    const auto& turn = view.rotation.data;
    Rays rays;
    for (int i = 0; i < 16; ++i) {
        const auto& mean = means.data[first + (i < count ? i : 0)];
        rays.x[i] = mean[0] - view.eye[0];
        rays.y[i] = mean[1] - view.eye[1];
        rays.z[i] = mean[2] - view.eye[2];
        rays.limit[i] = 1.0f;
    }
    const Row x = *(const Row*)rays.x, y = *(const Row*)rays.y, z = *(const Row*)rays.z;
    const Row depth = turn[2][0] * x + turn[2][1] * y + turn[2][2] * z, scale = view.focal / depth;
    const Row at_x = scale * (turn[0][0] * x + turn[0][1] * y + turn[0][2] * z) + view.centre[0];
    const Row at_y = scale * (turn[1][0] * x + turn[1][1] * y + turn[1][2] * z) + view.centre[1];
    *(Row*)rays.pixel = depth / view.focal;
    const float low_x = __builtin_reduce_min(at_x), high_x = __builtin_reduce_max(at_x);
    const float low_y = __builtin_reduce_min(at_y), high_y = __builtin_reduce_max(at_y);
    const float middle_x = 0.5f * (low_x + high_x), half_x = 0.5f * (high_x - low_x);
    const float middle_y = 0.5f * (low_y + high_y), half_y = 0.5f * (high_y - low_y);
    const float farthest = __builtin_reduce_max(depth);
    Row clear = depth * 0.0f + 1.0f;
    bool glazed = false;
    for (int k = 0; k < solids.shape[0]; ++k) {
        const auto& outline = outlines.data[k];
        if (farthest < outline.nearest) continue;
        if (beside(outline, middle_x, middle_y, half_x, half_y)) continue;
        Veil veil;
        veil_of(solids.data[k], rays, veil);
        clear *= 1.0f - *(const Row*)veil.alpha;
        glazed = true;
    }
    for (int i = 0; i < count && glazed; ++i)
        if (clear[i] < 1.0f)
            for (int c = 0; c < 3; ++c) {
                float& colour = splats_out.data[first + i].colour[c];
                colour = clear[i] * colour + (1.0f - clear[i]) * TINT[c];
            }
"""
)


@wp.func_native(GLASS + OPEN + AIM + CLEAR + LIGHT + DRAW)
def draw_tile(
    tile: int,
    view: View,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    coverage: wp.array(dtype=float),
    image_out: wp.array(dtype=wp.vec3),
):
    """Draw what is behind the Gaussians of one tile of 16 x 16 pixels."""
    ...


@kernel("phy124_stage_simd")
def blend_staged_simd(
    # model
    view: View,
    background: wp.vec3,
    first: int,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    # state in
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    # out
    image_out: wp.array(dtype=wp.vec3),
    alpha_out: wp.array(dtype=float),
):
    """One thread per tile: its splats, and the stage behind them while it is in the cache."""
    tile = first + wp.tid()
    blend_tile(tile, starts, ends, pairs, splats, view, background, image_out, alpha_out)
    draw_tile(tile, view, setting, shade, picture, solids, outlines, alpha_out, image_out)


@wp.func_native(TINT_GROUP)
def tint_group(
    group: int,
    view: View,
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    means: wp.array(dtype=wp.vec3),
    splats_out: wp.array(dtype=Splat),
):
    """Tint sixteen Gaussians that lie side by side in memory."""
    ...


@kernel("phy124_stage_simd")
def tint_splats_simd(
    # model
    view: View,
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    # state in
    means: wp.array(dtype=wp.vec3),
    # in place
    splats_out: wp.array(dtype=Splat),
):
    """One thread per sixteen Gaussians: the colour of what is seen through glass."""
    tint_group(wp.tid(), view, solids, outlines, means, splats_out)
