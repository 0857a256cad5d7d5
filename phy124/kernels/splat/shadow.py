"""Computes the optical depth of Gaussians above the floor, along the light, in layers."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.native import code, constants, native_kernel
from phy124.kernels.reduction import finite
from phy124.kernels.splat.arguments import DRAWN

NARROW = wp.constant(0.9)
"""Width of a Gaussian [cells] below which it is treated as a point between four cells."""
REACH = wp.constant(3.0)
"""Distance up to which a wider Gaussian is evaluated [standard deviations]."""


@wp.func
def thickness(opacity: float) -> float:
    """Return the integral of -log(1 - opacity exp(-r^2 / 2)) over the plane, divided by 2 pi.

    The integral is a dilogarithm, computed by a polynomial.
    """
    o = opacity
    return o * (1.0 + o * (0.25 + o * (0.1111 + o * (0.0625 + o * (0.04 + o * 0.12)))))


@wp.func
def put(layers: wp.array3d(dtype=float), i: int, j: int, layer: int, upper: float, amount: float):
    """Distribute a value over two neighbouring layers of a cell of the shadow map."""
    if i >= 0 and j >= 0 and i < layers.shape[1] and j < layers.shape[2]:
        wp.atomic_add(layers, layer, i, j, (1.0 - upper) * amount)
        wp.atomic_add(layers, layer + 1, i, j, upper * amount)


@kernel("phy124_shadow", types=DRAWN)
def cover(
    origin: wp.vec3,
    cell: float,
    slope: wp.vec2,
    tallest: float,
    weight: float,
    opacities,
    means,
    quats,
    scales,
    layers_out: wp.array3d(dtype=float),
):
    """Add the optical depth of each Gaussian to the layers [layers, cells, cells]; one thread each.

    Layer k is at height tallest (k / last)^2 above the floor. `origin` is the corner of the map on
    the floor. `slope` is the horizontal displacement of the light's rays per metre of descent.
    `weight` is the number of Gaussians that each Gaussian represents.
    """
    n = wp.tid()
    mean = means[n]
    scale = scales[n]
    q = quats[n]
    sums = mean[0] + mean[1] + mean[2] + scale[0] + scale[1] + scale[2]
    # Normalising would turn a NaN quaternion into a finite rotation.
    sums += q[0] + q[1] + q[2] + q[3]
    # Any comparison with NaN is false.
    if not (opacities[n] > 0.004 and finite(sums)):
        return
    opacity = wp.min(opacities[n], 0.99)
    height = wp.max(mean[2] - origin[2], 0.0)
    last = float(layers_out.shape[0] - 1)
    level = last * wp.sqrt(wp.min(height / tallest, 1.0))
    layer = wp.min(int(level), layers_out.shape[0] - 2)
    upper = level - float(layer)
    turn = wp.quat_to_matrix(wp.normalize(wp.quat(q[1], q[2], q[3], q[0])))
    # Screen axes as in project.py, but in cells.
    radii = wp.sqrt(weight) / cell * scale
    across = wp.cw_mul(turn[0] + slope[0] * turn[2], radii)
    along = wp.cw_mul(turn[1] + slope[1] * turn[2], radii)
    a = wp.dot(across, across)
    b = wp.dot(across, along)
    c = wp.dot(along, along)
    x = (mean[0] - origin[0] + height * slope[0]) / cell - 0.5
    y = (mean[1] - origin[1] + height * slope[1]) / cell - 0.5
    end_x = float(layers_out.shape[1] - 1)
    end_y = float(layers_out.shape[2] - 1)
    size = wp.max(end_x, end_y) + 1.0
    if not (x > -size and y > -size and x < 2.0 * size and y < 2.0 * size):
        return
    # Lagrange's identity gives the determinant without cancellation.
    area = wp.length(wp.cross(across, along))
    if wp.max(a, c) < NARROW * NARROW:
        amount = 6.2831853 * thickness(opacity) * area
        if not (x >= 0.0 and y >= 0.0 and x < end_x and y < end_y):
            return
        i = int(x)
        j = int(y)
        u = x - float(i)
        v = y - float(j)
        put(layers_out, i, j, layer, upper, amount * (1.0 - u) * (1.0 - v))
        put(layers_out, i + 1, j, layer, upper, amount * u * (1.0 - v))
        put(layers_out, i, j + 1, layer, upper, amount * (1.0 - u) * v)
        put(layers_out, i + 1, j + 1, layer, upper, amount * u * v)
        return
    # A needle is widened to a fraction of a cell, as in project.py; its optical depth is reduced.
    det = area * area + 0.1 * (a + c) + 0.01
    a += 0.1
    c += 0.1
    if not (finite(det) and det > 0.0):
        return
    peak = opacity * wp.min(area / wp.sqrt(det), 1.0)
    reach_x = wp.min(REACH * wp.sqrt(a), 2.0 * size)
    reach_y = wp.min(REACH * wp.sqrt(c), 2.0 * size)
    for i in range(int(wp.max(wp.ceil(x - reach_x), 0.0)), int(wp.min(x + reach_x + 1.0, size))):
        for j in range(
            int(wp.max(wp.ceil(y - reach_y), 0.0)), int(wp.min(y + reach_y + 1.0, size))
        ):
            u = float(i) - x
            v = float(j) - y
            power = (c * u * u - 2.0 * b * u * v + a * v * v) / det
            alpha = peak * wp.exp(-0.5 * power)
            put(layers_out, i, j, layer, upper, -wp.log(1.0 - alpha))


cover_simd = native_kernel(
    "phy124_shadow_simd",
    code("elementary", "elementary:sixteen")
    + constants("float", NARROW=NARROW, REACH=REACH)
    + code("shadow"),
    name="cover_simd",
)(cover.func)
"""Version of `cover` with vector instructions of a CPU, for maps of at least sixteen cells.
tests/test_stage_shadow.py compares both versions.
"""
