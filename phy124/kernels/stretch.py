"""How far apart stretching has moved neighbouring particles, in cells of the grid."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.elastic import largest_stretch_squared
from phy124.kernels.transfer import types


@wp.func
def spacing(F: Any, volume: Any):
    """Distance of neighbours along the largest stretch [m]; at rest each particle fills a cube."""
    return wp.sqrt(largest_stretch_squared(F)) * wp.cbrt(volume)


@cache
def make_apart(real: Any):
    """Kernel: finds particles whose neighbours are further away than `limit` [m].

    `found_out` is their number and their lowest index, `max_out` the largest stretch.
    """
    t = types(real)

    @kernel(f"phy124_apart_{real.__name__}", seconds=0.2)
    def apart(
        # model
        volume: wp.array(dtype=real), limit: real, start: int,
        # state in
        F: wp.array(dtype=t.mat33),
        # out
        found_out: wp.array(dtype=int), max_out: wp.array(dtype=real),
    ):  # fmt: skip
        p = wp.tid()
        if spacing(F[p], volume[p]) > limit:
            wp.atomic_add(found_out, 0, 1)
            wp.atomic_min(found_out, 1, start + p)
            wp.atomic_max(max_out, 0, wp.sqrt(largest_stretch_squared(F[p])))

    return apart
