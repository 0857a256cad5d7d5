"""Lists the active cells: the cells that particles may reach or change in this step.

Cells whose B-spline lies inside fixed walls are not listed, nor are cells at the border of the
window. Cells that are not listed contain no liquid, and their velocities are unknown.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_at, entry, inner, local
from phy124.kernels.liquid.listed import share

REACH = wp.constant(4)
"""Number of active cells on each side of a particle's cell: a step moves a particle by up to two
cells, and the particle's B-splines reach two cells further.
"""
EMPTY = wp.constant(1.5)
"""Value that is stored as the distance to the surface in cells without liquid [cells]."""
NONE = 1 << 30
"""Stands for the index of the lowest cell with particles in a column that has no particles."""


@build_once
def make_sweep(real: Any):
    """Kernel over particles: extends each column's range of cells to include the particles'
    cells.
    """

    @kernel(f"phy124_liquid_sweep_{real.__name__}", real, seconds=0.2)
    def sweep(lattice, window, x, lowest_out: Ints, highest_out: Ints):
        size = window[1]
        cell = cell_at(local(x[wp.tid()], lattice, window))
        if inner(cell, size, 1):
            column = cell[0] * size[1] + cell[1]
            wp.atomic_min(lowest_out, column, cell[2])
            wp.atomic_max(highest_out, column, cell[2])

    return sweep


@kernel("phy124_liquid_widen", seconds=0.2)
def widen(
    part: int,
    copies: int,
    window: wp.array(dtype=wp.vec3i),
    lowest: Ints,
    highest: Ints,
    counts: Ints,
    below_out: Ints,
    above_out: Ints,
):
    """Merge the workers' ranges of cells, and the ranges of all columns within `REACH` along y.

    `counts` contains one number for each group of columns.
    """
    size = window[1]
    columns = size[0] * size[1]
    span = share(columns, part + wp.tid(), counts.shape[0])
    for c in range(span[0], span[1]):
        j = c % size[1]
        low = int(size[2])
        high = int(-1)
        for copy in range(copies):
            first = copy * columns + c - j
            for b in range(wp.max(j - REACH, 0), wp.min(j + REACH + 1, size[1])):
                low = wp.min(low, item(lowest, first + b))
                high = wp.max(high, item(highest, first + b))
        below_out[c] = low
        above_out[c] = high


@build_once
def make_count_active(real: Any):
    """Kernel over groups of columns of cells: extends the ranges along x and z, and counts the
    cells.

    Cells whose B-spline lies inside walls are counted only if `all` is set.
    """

    @kernel(f"phy124_liquid_count_active_{real.__name__}", real, seconds=0.2)
    def count_active(
        part, all: int, window, shares, below: Ints, above: Ints, begins_out, ends_out, counts_out
    ):
        p = part + wp.tid()
        size = window[1]
        span = share(size[0] * size[1], p, counts_out.shape[0])
        count = int(0)
        for c in range(span[0], span[1]):
            i = c // size[1]
            j = c - i * size[1]
            low = int(size[2])
            high = int(-1)
            for a in range(wp.max(i - REACH, 0), wp.min(i + REACH + 1, size[0])):
                low = wp.min(low, item(below, a * size[1] + j))
                high = wp.max(high, item(above, a * size[1] + j))
            begin = int(0)
            end = int(0)
            if high >= low and inner(wp.vec3i(i, j, 1), size, 1):
                begin = wp.max(low - REACH, 1)
                end = wp.min(high + REACH + 1, size[2] - 1)
            begins_out[c] = begin
            ends_out[c] = end
            for k in range(begin, end):
                if all > 0 or item(shares, c * size[2] + k)[1] < real(1.0):
                    count += 1
        counts_out[p] = count

    return count_active


@build_once
def make_list_active(real: Any):
    """Kernel over groups of columns: lists the active cells, and divides them among the workers."""

    @kernel(f"phy124_liquid_list_active_{real.__name__}", real, seconds=0.2)
    def list_active(
        part, all: int, window, shares, begins, ends, counts, active_out, shares_out: Ints
    ):
        p = part + wp.tid()
        size = window[1]
        at = int(0)
        total = int(0)
        for k in range(counts.shape[0]):
            if k == p:
                at = total
            total += counts[k]
        span = share(size[0] * size[1], p, counts.shape[0])
        for c in range(span[0], span[1]):
            for k in range(begins[c], ends[c]):
                n = c * size[2] + k
                if all > 0 or item(shares, n)[1] < real(1.0):
                    active_out[at] = n
                    at += 1
        if p == 0:
            workers = shares_out.shape[0] - 1
            for w in range(workers + 1):
                shares_out[w] = share(total, w, workers)[0]

    return list_active


@build_once
def make_forget(real: Any):
    """Kernel over cells: resets the cells that were active in the previous step."""

    @kernel(f"phy124_liquid_forget_{real.__name__}", real, seconds=0.2)
    def forget(worker, active, ends, phi_out, known_out, also_out: Ints, liquid_out):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        phi_out[n] = real(EMPTY)
        known_out[n] = 0
        also_out[n] = 0
        liquid_out[n] = 0

    return forget
