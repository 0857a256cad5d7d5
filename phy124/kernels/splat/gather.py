"""The adjoint of blending: how much of each pixel a splat's colour makes up, summed by splat."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.native import code, native_kernel
from phy124.kernels.splat.blend import OPEN_TILE, PIXELS
from phy124.kernels.splat.screen import MIN_TRANSMITTANCE, TILE, Splat, View, alpha_at


@kernel("phy124_gather")
def gather_pixels(
    # model
    view: View,
    first: int,
    values: wp.array(dtype=wp.vec3),
    # state in
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    # in place
    sums_out: wp.array(dtype=wp.vec3),
    weights_out: wp.array(dtype=float),
):
    """One thread per pixel, as in `blend.blend_pixels`: adds its value and 1, as it shows it."""
    thread = wp.tid()
    tile = first + thread / PIXELS
    x = (tile % view.columns) * TILE + thread % TILE
    y = (tile / view.columns) * TILE + (thread % PIXELS) / TILE
    if x >= view.width or y >= view.height:
        return
    value = values[y * view.width + x]
    transmittance = float(1.0)
    for k in range(starts[tile], ends[tile]):
        i = pairs[k]
        alpha = alpha_at(splats[i], x, y)
        if alpha > 0.0:
            rest = transmittance * (1.0 - alpha)
            if rest < MIN_TRANSMITTANCE:
                break
            wp.atomic_add(sums_out, i, alpha * transmittance * value)
            wp.atomic_add(weights_out, i, alpha * transmittance)
            transmittance = rest


gather_tiles_simd = native_kernel(
    "phy124_gather_simd", OPEN_TILE + code("gather", "tile:splats"), name="gather_tiles_simd"
)(gather_pixels.func)
"""`gather_pixels` for CPUs, one tile per thread; tiles run in turn since they share splats."""
