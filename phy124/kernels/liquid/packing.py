"""Computes displacements of particles from crowded to empty cells, to restore the rest density.

The displacements are the gradient of a field that solves a linear system. The system has the matrix
of the pressure equation, and the density error as its right-hand side (Kugelstadt et al. 2019,
"Implicit density projection for volume conserving liquids"). Below the surface, only an excess of
density is corrected. In the first layer of cells below the surface, the error is the difference
from a flat surface.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_of, entry, inner, stride
from phy124.kernels.liquid.surface import opening

RATE = wp.constant(0.75)
"""Fraction of a cell's density error that is removed in a step."""
MOST = 0.5
"""Upper limit of a cell's relative density error, and of a displacement [cells]."""


@wp.func
def is_wall(open: wp.array(dtype=Any), liquid: wp.array(dtype=int), n: int, size: wp.vec3i):
    """Return whether a cell is inside a wall."""
    if item(liquid, n) == 1:
        return False
    return opening(open, n, size) <= type(item(open, n)[0])(0.0)


@wp.func
def leads_behind(step: int, low: int, high: int):
    """Return True if a step along an axis is 0 or leads into a wall.

    `low` and `high` are 1 if the neighbours on the two sides are walls.
    """
    return step == 0 or (step < 0 and low > 0) or (step > 0 and high > 0)


@build_once
def make_excess(real: Any):
    """Kernel over cells: computes the part of each cell's density error that this step corrects.

    Cells inside a wall have no unknown in the linear system, so their error is added to the cell in
    front of the wall, or in front of all walls at an edge or corner.
    """

    @kernel(f"phy124_liquid_excess_{real.__name__}", real, seconds=0.4)
    def excess(
        worker, active, ends, window, open, shares, hats, phi, liquid, right_out, x_out: Doubles
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        error = real(0.0)
        if item(liquid, n) == 1 and inner(cell_of(n, size), size, 2):
            # The loop count is not a constant, so that the compiler does not unroll the loops.
            last = int(2)
            near = int(0)
            layer = stride(0, size)
            row = stride(1, size)
            for a in range(-1, last):
                for b in range(-1, last):
                    for c in range(-1, last):
                        m = n + a * layer + b * row + c
                        if near == 0 and item(liquid, m) == 0:
                            if opening(open, m, size) > real(0.0):
                                near = int(1)
            hat = item(hats, n)
            error = hat - real(1.0)
            if item(shares, n)[1] > real(0.0):
                low = wp.vec3i()
                high = wp.vec3i()
                for axis in range(3):
                    low[axis] = int(is_wall(open, liquid, n - stride(axis, size), size))
                    high[axis] = int(is_wall(open, liquid, n + stride(axis, size), size))
                for a in range(-1, last):
                    if leads_behind(a, low[0], high[0]):
                        for b in range(-1, last):
                            if leads_behind(b, low[1], high[1]):
                                for c in range(-1, last):
                                    if leads_behind(c, low[2], high[2]):
                                        m = n + a * layer + b * row + c
                                        if m != n and is_wall(open, liquid, m, size):
                                            error += item(hats, m) - real(1.0)
            if near > 0:
                deep = wp.clamp(-item(phi, n), real(-1.0), real(1.0))
                solid = item(shares, n)[0]
                flat = real(1.0) - real(0.5) * (real(1.0) - deep) * (real(1.0) - deep)
                below = hat - solid - (real(1.0) - solid) * flat
                least = real(0.0)
                if deep > real(0.5):
                    least = wp.min(below, real(0.0))
                error = wp.max(error, least)
            error = wp.clamp(error, real(-wp.static(MOST)), real(wp.static(MOST)))
        right_out[n] = wp.float64(real(RATE) * error)
        x_out[n] = wp.float64(0.0)

    return excess
