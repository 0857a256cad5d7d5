"""The stage for CPUs: `stage.draw_setting` and `stage.tint_splats` in C++, sixteen at a time.

Each tile is drawn with its Gaussians, before they are stored. Where the corners of a tile see the
same two faces of a box, away from its edges, so does all of the tile, since faces are convex: its
opacity is one number there.
"""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.blend_simd import STORE_TILE, SUM_TILE
from phy124.kernels.splat.glass import Outline, Solid
from phy124.kernels.splat.glass_simd import GLASS
from phy124.kernels.splat.screen import Splat, View
from phy124.kernels.splat.stage import Setting

OPEN = r"""
    typedef float Row __attribute__((vector_size(64), aligned(4)));
    // How much of what is behind is seen; Gaussians may let through less than a byte can tell.
    const Row none = {0.0f};
    Row open[16], widest = none;
    for (int y = 0; y < 16; ++y) {
        const Row t = *(const Row*)(T + 16 * y), rest = t < none ? -t : t;
        open[y] = rest > 1e-3f ? rest : none;
        widest = open[y] > widest ? open[y] : widest;
    }
    const float most_open = __builtin_reduce_max(widest);
    if (most_open == 0.0f && setting.before == 0) return;
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
    Row clear[16], lens[16];  // what solids let through, all and those before the Gaussians
    for (int y = 0; y < 16; ++y) clear[y] = lens[y] = none + 1.0f;
    bool laid = false;
    const float middle_x = 0.5f * (float)(left + right), middle_y = 0.5f * (float)(top + bottom);
    const float half_x = 0.5f * (float)(count - 1), half_y = 0.5f * (float)(rows - 1);
    const int shown = most_open == 0.0f ? setting.before : solids.shape[0];
    for (int k = 0; k < shown; ++k) {
        if (k == setting.before) for (int y = 0; y < 16; ++y) lens[y] = clear[y];
        if (beside(outlines.data[k], middle_x, middle_y, half_x, half_y)) continue;
        laid = laid || k < setting.before;
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
    if (shown == setting.before) for (int y = 0; y < 16; ++y) lens[y] = clear[y];
    if (most_open == 0.0f && !laid) return;
"""

LIGHT = r"""
    const float* __restrict shades = shade.data;
    const int cells = setting.cells;
    const float last = (float)(cells - 1), nearer = 1.0f / setting.reach;
    const float scale = 0.5f * (float)cells * nearer, middle = 0.5f * last;
    const float ex = view.eye[0] - setting.middle[0], ey = view.eye[1] - setting.middle[1];
    float light[16] = {0.0f}, pool[16] = {0.0f}, at_i[16], at_j[16];
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
    const bool pictured = picture.shape[0] > 0;
    for (int i = 0; i < 16; ++i) xs[i] = (float)(left + i) + 0.5f;
    for (int y = 0; y < rows; ++y) {
        const float at = (float)(top + y) + 0.5f, down = at / (float)view.height;
        const bool some = __builtin_reduce_max(open[y]) > 0.0f;
        if (!some && !laid) continue;
        if (some) {
            for (int i = 0; i < 16; ++i) ys[i] = at;
            aim(rays, xs, ys);
            shine();
        }
        const Row seen = open[y] * clear[y] * *(const Row*)light, added = seen * *(const Row*)pool;
        const Row hidden = open[y] * (1.0f - clear[y]) + (1.0f - open[y]) * (1.0f - lens[y]);
        for (int c = 0; c < 3; ++c) {
            Row behind = none + (setting.top[c] + down * (setting.bottom[c] - setting.top[c]));
            if (pictured) {
                const auto* photo = picture.data + (top + y) * view.width + left;
                for (int x = 0; x < count; ++x) behind[x] = photo[x][c];
            }
            Row& drawn = *(Row*)((c == 0 ? R : c == 1 ? G : B) + 16 * y);
            drawn = lens[y] * drawn + seen * behind + added * behind * (1.0f - behind)
                + hidden * TINT[c];
        }
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


DRAW_STAGE = f"const auto draw_stage = [&]() {{ {GLASS + OPEN + AIM + CLEAR + LIGHT + DRAW} }};"


@wp.func_native(SUM_TILE + DRAW_STAGE + "draw_stage();" + STORE_TILE)
def blend_staged_tile(
    tile: int,
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    view: View,
    background: wp.vec3,
    setting: Setting,
    shade: wp.array2d(dtype=float),
    picture: wp.array(dtype=wp.vec3),
    solids: wp.array(dtype=Solid),
    outlines: wp.array(dtype=Outline),
    image_out: wp.array(dtype=wp.vec3),
    alpha_out: wp.array(dtype=float),
):
    """Blend one tile of 16 x 16 pixels, and draw the stage around it."""
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
    """One thread per tile: its splats, and the stage around them before they are stored."""
    tile = first + wp.tid()
    blend_staged_tile(
        tile, starts, ends, pairs, splats, view, background, setting, shade, picture, solids,
        outlines, image_out, alpha_out,
    )  # fmt: skip


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
