"""The adjoint of blending for CPUs: `gather.gather_pixels` in C++, a row of a tile at a time."""

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.splat.blend_simd import TILE, walk
from phy124.kernels.splat.elementary_simd import FUNCTIONS
from phy124.kernels.splat.screen import Splat, View

VALUES = r"""
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < count; ++x) {
            const auto& value = values.data[(top + y) * view.width + left + x];
            R[16 * y + x] = value[0];
            G[16 * y + x] = value[1];
            B[16 * y + x] = value[2];
        }
    alignas(64) float red[16], green[16], blue[16], all[16];
"""

ADD = r"""
            auto& sums = sums_out.data[index];
            for (int x = 8; x > 0; x /= 2)
                for (int j = 0; j < x; ++j) {
                    red[j] += red[j + x];
                    green[j] += green[j + x];
                    blue[j] += blue[j + x];
                    all[j] += all[j + x];
                }
            sums[0] += red[0];
            sums[1] += green[0];
            sums[2] += blue[0];
            weights_out.data[index] += all[0];
"""


@wp.func_native(
    FUNCTIONS
    + TILE
    + VALUES
    + walk(
        "for (int x = 0; x < 16; ++x) red[x] = green[x] = blue[x] = all[x] = 0.0f;",
        "const float *Rr = R + at, *Gr = G + at, *Br = B + at;",
        """
                    red[x] += weight * Rr[x];
                    green[x] += weight * Gr[x];
                    blue[x] += weight * Br[x];
                    all[x] += weight;
        """,
        ADD,
    )
)
def gather_tile(
    tile: int,
    starts: wp.array(dtype=int),
    ends: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    splats: wp.array(dtype=Splat),
    view: View,
    values: wp.array(dtype=wp.vec3),
    sums_out: wp.array(dtype=wp.vec3),
    weights_out: wp.array(dtype=float),
):
    """Add what the splats of one tile of 16 x 16 pixels show."""
    ...


@kernel("phy124_gather_simd")
def gather_tiles_simd(
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
    """One thread per tile, of which a CPU runs one after the other: a splat may be in several."""
    tile = first + wp.tid()
    gather_tile(tile, starts, ends, pairs, splats, view, values, sums_out, weights_out)
