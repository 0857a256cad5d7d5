"""The shadow's layers for CPUs: `shadow.cover` in C++, sixteen Gaussians or cells at a time."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.elementary_simd import FUNCTIONS
from phy124.kernels.splat.group_simd import GROUP

CAST = r"""
    const int cells_x = layers_out.shape[1], cells_y = layers_out.shape[2];
    const float extent = (float)(cells_x > cells_y ? cells_x : cells_y);
    const float last = (float)(layers_out.shape[0] - 1);
    const float NARROW = 0.9f, REACH = 3.0f, LARGEST = 3e38f;
    const auto root = [](float a) { return __builtin_elementwise_sqrt(a); };
    const auto least = [](float a, float b) { return a < b ? a : b; };
    const float widen = root(weight) / cell;
    enum { NONE, POINT, DISC };
    float x[16], y[16], a[16], b[16], c[16], reach_x[16], reach_y[16], level[16], amount[16];
    int kind[16];
    #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
    for (int i = 0; i < 16; ++i) {
        const float px = place[3 * i], py = place[3 * i + 1], pz = place[3 * i + 2];
        const float w = quat[4 * i], qx = quat[4 * i + 1];
        const float qy = quat[4 * i + 2], qz = quat[4 * i + 3];
        const float norm = w * w + qx * qx + qy * qy + qz * qz;
        const float s = norm > 0.0f ? 2.0f / norm : 0.0f;
        const float turned_x = s * (qx * qz - w * qy), turned_y = s * (qy * qz + w * qx);
        const float turned_z = 1.0f - s * (qx * qx + qy * qy);
        const float rx = widen * size[3 * i], ry = widen * size[3 * i + 1];
        const float rz = widen * size[3 * i + 2];
        const float ax = rx * (1.0f - s * (qy * qy + qz * qz) + slope[0] * turned_x);
        const float ay = ry * (s * (qx * qy - w * qz) + slope[0] * turned_y);
        const float az = rz * (s * (qx * qz + w * qy) + slope[0] * turned_z);
        const float bx = rx * (s * (qx * qy + w * qz) + slope[1] * turned_x);
        const float by = ry * (1.0f - s * (qx * qx + qz * qz) + slope[1] * turned_y);
        const float bz = rz * (s * (qy * qz - w * qx) + slope[1] * turned_z);
        const float aa = ax * ax + ay * ay + az * az, bb = ax * bx + ay * by + az * bz;
        const float cc = bx * bx + by * by + bz * bz, above = pz - origin[2];
        const float height = above > 0.0f ? above : 0.0f;
        const float up = height < tallest ? height / tallest : 1.0f;
        const float at_x = (px - origin[0] + height * slope[0]) / cell - 0.5f;
        const float at_y = (py - origin[1] + height * slope[1]) / cell - 0.5f;
        const float o = opaque[i] > 0.99f ? 0.99f : opaque[i];
        // Lagrange's identity: the determinant without cancellation.
        const float nx = ay * bz - az * by, ny = az * bx - ax * bz, nz = ax * by - ay * bx;
        const float area = root(nx * nx + ny * ny + nz * nz);
        const bool narrow = (aa > cc ? aa : cc) < NARROW * NARROW;
        // A needle is as wide as a cell's fraction, as in project.py; its depth shrinks with that.
        const float sa = aa + 0.1f, sc = cc + 0.1f, det = area * area + 0.1f * (aa + cc) + 0.01f;
        // Not a number fails every test.
        const bool seen = o > 0.004f && pz > -LARGEST && pz < LARGEST && aa + cc < LARGEST
            && at_x > -extent && at_y > -extent && at_x < 2.0f * extent && at_y < 2.0f * extent;
        const float thickness = 6.2831853f * o
            * (1.0f + o * (0.25f + o * (0.1111f + o * (0.0625f + o * (0.04f + o * 0.12f)))));
        kind[i] = !seen ? NONE : narrow ? POINT : det < LARGEST ? DISC : NONE;
        amount[i] = narrow ? thickness * area : o * least(area / root(det), 1.0f);
        level[i] = last * root(up);
        x[i] = at_x;
        y[i] = at_y;
        a[i] = sa / det;
        b[i] = bb / det;
        c[i] = sc / det;
        reach_x[i] = least(REACH * root(sa), 2.0f * extent);
        reach_y[i] = least(REACH * root(sc), 2.0f * extent);
    }
"""

ADD_POINT = r"""
    const int plane = cells_x * cells_y, layers = layers_out.shape[0];
    const auto add_point = [&](float* lower, float upper, int n) {
        const float left = __builtin_elementwise_floor(x[n]);
        const float below = __builtin_elementwise_floor(y[n]);
        const int i = (int)left, j = (int)below;
        const float u = x[n] - left, v = y[n] - below;
        typedef float Pair __attribute__((vector_size(8), aligned(4)));
        const Pair row = {amount[n] * (1.0f - v), amount[n] * v};
        for (int k = 0; k < 2; ++k) {
            if (i + k < 0 || i + k >= cells_x) continue;
            const Pair high = (k ? u : 1.0f - u) * upper * row;
            const Pair low = (k ? u : 1.0f - u) * (1.0f - upper) * row;
            float* at = lower + (i + k) * cells_y + j;
            if (j >= 0 && j + 1 < cells_y) {
                *(Pair*)at += low;
                *(Pair*)(at + plane) += high;
            } else {
                for (int l = 0; l < 2; ++l)
                    if (j + l >= 0 && j + l < cells_y) {
                        at[l] += low[l];
                        at[l + plane] += high[l];
                    }
            }
        }
    };
"""

ADD_DISC = r"""
    const float HALF_LOG2_E = 0.72134752f;
    const auto add_disc = [&](float* lower, float upper, int n) {
        const float u0 = x[n], v0 = y[n], peak = amount[n];
        const auto first = [](float at) {
            return at > 0.0f ? (int)__builtin_elementwise_ceil(at) : 0;
        };
        const auto end = [&](float at) { return (int)least(at, extent); };
        const int end_x = end(u0 + reach_x[n] + 1.0f), end_y = end(v0 + reach_y[n] + 1.0f);
        const int start_y = first(v0 - reach_y[n]);
        for (int i = first(u0 - reach_x[n]); i < end_x && i < cells_x; ++i)
            for (int at = start_y; at < end_y && at < cells_y; at += 16) {
                // Sixteen cells of a row, of which those before `at` are done already.
                const int j = at + 16 < cells_y ? at : cells_y - 16;
                const float u = (float)i - u0;
                float* low = lower + i * cells_y + j;
                float* high = low + plane;
                #pragma clang loop vectorize(enable) interleave(disable) unroll(disable)
                for (int k = 0; k < 16; ++k) {
                    const float v = (float)(j + k) - v0;
                    const float power = -HALF_LOG2_E
                        * (c[n] * u * u - 2.0f * b[n] * u * v + a[n] * v * v);
                    const float alpha = peak * power_of_2(power > -60.0f ? power : -60.0f);
                    const bool inside = j + k >= at && j + k < end_y;
                    const float depth = inside ? -logarithm(1.0f - alpha) : 0.0f;
                    low[k] += (1.0f - upper) * depth;
                    high[k] += upper * depth;
                }
            }
    };
"""

ADD = r"""
    for (int i = 0; i < count; ++i) {
        if (kind[i] == NONE) continue;
        const int layer = (int)level[i] < layers - 2 ? (int)level[i] : layers - 2;
        const float upper = level[i] - (float)layer;
        float* lower = layers_out.data + layer * plane;
        if (kind[i] == POINT) add_point(lower, upper, i);
        else add_disc(lower, upper, i);
    }
"""


@wp.func_native(FUNCTIONS + GROUP + CAST + ADD_POINT + ADD_DISC + ADD)
def cover_group(
    group: int,
    origin: wp.vec3,
    cell: float,
    slope: wp.vec2,
    tallest: float,
    weight: float,
    opacities: wp.array(dtype=float),
    means: wp.array(dtype=wp.vec3),
    quats: wp.array(dtype=wp.vec4),
    scales: wp.array(dtype=wp.vec3),
    layers_out: wp.array3d(dtype=float),
):
    """Add sixteen Gaussians that lie side by side in memory."""
    ...


@kernel("phy124_shadow_simd")
def cover_simd(
    # model
    origin: wp.vec3,
    cell: float,
    slope: wp.vec2,
    tallest: float,
    weight: float,
    opacities: wp.array(dtype=float),
    # state in
    means: wp.array(dtype=wp.vec3),
    quats: wp.array(dtype=wp.vec4),
    scales: wp.array(dtype=wp.vec3),
    # in place: optical depth [layers, cells, cells], at least sixteen cells
    layers_out: wp.array3d(dtype=float),
):
    """One thread per sixteen Gaussians."""
    cover_group(
        wp.tid(), origin, cell, slope, tallest, weight, opacities, means, quats, scales, layers_out
    )
