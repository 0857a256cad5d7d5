"""How far apart stretching has moved neighbouring particles, in cells of the grid."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.elastic import largest_stretch_squared
from phy124.kernels.transfer import types


@cache
def make_apart(real: Any):
    """Kernel: finds particles that are stretched apart from their neighbours.

    `most` is the square of the stretch at which each is: at rest it fills a cube, whose side is the
    distance of its neighbours. `found_out` is the number of those that are stretched more and their
    lowest index, `max_out` the largest stretch.
    """
    t = types(real)

    @kernel(f"phy124_apart_{real.__name__}", seconds=0.2)
    def apart(
        # model
        most: wp.array(dtype=real), start: int,
        # state in
        F: wp.array(dtype=t.mat33),
        # out
        found_out: wp.array(dtype=int), max_out: wp.array(dtype=real),
    ):  # fmt: skip
        p = wp.tid()
        square = largest_stretch_squared(F[p])
        if square > most[p]:
            wp.atomic_add(found_out, 0, 1)
            wp.atomic_min(found_out, 1, start + p)
            wp.atomic_max(max_out, 0, wp.sqrt(square))

    return apart
