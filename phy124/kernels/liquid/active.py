"""Lists the active cells: those that particles may reach or change in this step.

Columns of cells along z store how far particles extend. Kernels over cells visit the listed cells
only. All other cells hold no liquid, and their velocity is not known.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.liquid.conjugate import share
from phy124.kernels.liquid.faces import cell_at, entry, inner, local

REACH = wp.constant(4)
"""Cells around a particle's cell that are active: a step moves it by two cells, and its kernels
reach two cells further.
"""
EMPTY = wp.constant(1.5)
"""Distance to the surface of a cell without liquid [cells]."""
NONE = 1 << 30
"""Lowest cell of a column without particles."""


@cache
def make_sweep(real: Any):
    """Kernel over particles: extends the columns of cells that they are in."""

    @kernel(f"phy124_liquid_sweep_{real.__name__}", real, seconds=0.2)
    def sweep(lattice, window, x, lowest_out: Ints, highest_out: Ints):
        size = window[1]
        cell = cell_at(local(x[wp.tid()], lattice, window))
        if inner(cell, size, 1):
            column = cell[0] * size[1] + cell[1]
            wp.atomic_min(lowest_out, column, cell[2])
            wp.atomic_max(highest_out, column, cell[2])

    return sweep


@kernel("phy124_liquid_count_active", seconds=0.2)
def count_active(
    part: int,
    copies: int,
    window: wp.array(dtype=wp.vec3i),
    lowest: Ints,
    highest: Ints,
    begins_out: Ints,
    ends_out: Ints,
    counts_out: Ints,
):
    """Combine the columns of all copies and widen them; count the cells of a part of them."""
    p = part + wp.tid()
    size = window[1]
    columns = size[0] * size[1]
    span = share(columns, p, counts_out.shape[0])
    found = int(0)
    for c in range(span[0], span[1]):
        i = c // size[1]
        j = c - i * size[1]
        low = int(size[2])
        high = int(-1)
        for a in range(wp.max(i - REACH, 0), wp.min(i + REACH + 1, size[0])):
            for b in range(wp.max(j - REACH, 0), wp.min(j + REACH + 1, size[1])):
                for copy in range(copies):
                    m = copy * columns + a * size[1] + b
                    low = wp.min(low, lowest[m])
                    high = wp.max(high, highest[m])
        begin = int(0)
        end = int(0)
        if high >= low:
            begin = wp.max(low - REACH, 0)
            end = wp.min(high + REACH + 1, size[2])
        begins_out[c] = begin
        ends_out[c] = end
        found += end - begin
    counts_out[p] = found


@kernel("phy124_liquid_list_active", seconds=0.2)
def list_active(
    part: int,
    window: wp.array(dtype=wp.vec3i),
    begins: Ints,
    ends: Ints,
    counts: Ints,
    active_out: Ints,
    shares_out: Ints,
):
    """List the cells of a part of the columns, and divide all listed cells among the workers."""
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
            active_out[at] = c * size[2] + k
            at += 1
    if p == 0:
        workers = shares_out.shape[0] - 1
        for w in range(workers + 1):
            shares_out[w] = share(total, w, workers)[0]


@cache
def make_forget(real: Any):
    """Kernel over cells: clears those that were active in the step before."""
    t = types(real)

    @kernel(f"phy124_liquid_forget_{real.__name__}", real, seconds=0.2)
    def forget(
        worker: int,
        active: Ints,
        ends: Ints,
        phi_out: t.reals,
        known_out: Ints,
        also_out: Ints,
        liquid_out: Ints,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        phi_out[n] = real(EMPTY)
        known_out[n] = 0
        also_out[n] = 0
        liquid_out[n] = 0

    return forget
