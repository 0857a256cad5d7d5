"""Finds and mends deformations that no law can handle, F_total that overflows, torn material."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import kernel
from phy124.kernels.elastic import largest_stretch_squared


@cache
def make_reset(real: Any):
    """Kernel: deformations that no law can handle become the identity.

    Sound are volume ratios between `min_J` and `max_J`, norms up to `max_norm`, and a smallest
    stretch of at least the fraction `narrowest` of the largest, compared as J / |cof F| and |F|.
    `found_out` is the number of others, and the lowest index of one.
    """
    t = types(real)

    @kernel(f"phy124_reset_{real.__name__}", real, seconds=0.2)
    def reset(min_J: real, max_J: real, max_norm: real, narrowest: real, F_out, C_out, found_out):
        p = wp.tid()
        deformation = F_out[p]
        a = wp.cross(deformation[1], deformation[2])
        b = wp.cross(deformation[2], deformation[0])
        c = wp.cross(deformation[0], deformation[1])
        J = wp.dot(deformation[0], a)
        size = wp.sqrt(wp.ddot(deformation, deformation))
        cofactor = wp.sqrt(wp.dot(a, a) + wp.dot(b, b) + wp.dot(c, c))
        # A comparison with NaN is false, so the condition is written for sound ones.
        if not (
            J >= min_J and J <= max_J and size <= max_norm and J >= narrowest * size * cofactor
        ):
            F_out[p] = wp.identity(3, dtype=real)
            C_out[p] = t.mat33()
            wp.atomic_add(found_out, 0, 1)
            wp.atomic_min(found_out, 1, p)

    return reset


@cache
def make_limit_total(real: Any):
    """Kernel: scales down the F_total of flowing material before it overflows."""

    @kernel(f"phy124_limit_total_{real.__name__}", real, seconds=0.15)
    def limit_total(max_norm: real, F, total_out):
        p = wp.tid()
        size = wp.sqrt(wp.ddot(total_out[p], total_out[p]))
        if not wp.isfinite(size):
            total_out[p] = F[p]
        elif size > max_norm:
            total_out[p] = (max_norm / size) * total_out[p]

    return limit_total


@cache
def make_apart(real: Any):
    """Kernel: finds particles that are stretched apart from their neighbours.

    `most` is the square of the stretch at which each is: at rest it fills a cube, whose side is the
    distance of its neighbours. `found_out` is the number of those that are stretched more and their
    lowest index, `max_out` the largest stretch.
    """
    t = types(real)

    @kernel(f"phy124_apart_{real.__name__}", real, seconds=0.2)
    def apart(most: t.reals, start: int, F, found_out, max_out: t.reals):
        p = wp.tid()
        square = largest_stretch_squared(F[p])
        if square > most[p]:
            wp.atomic_add(found_out, 0, 1)
            wp.atomic_min(found_out, 1, start + p)
            wp.atomic_max(max_out, 0, wp.sqrt(square))

    return apart
