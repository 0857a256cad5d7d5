"""Indices and sums of the cells in a window of the staggered grid, and the particles' extent.

The values at a cell's three low faces and at its centre are stored as one vector.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item

FILL = 3
"""Index of the sum of particle volumes with quadratic weights around a cell's centre [m^3]."""
HAT = 7
"""Index of the sum of particle volumes with linear weights around a cell's centre [m^3]."""


@build_once
def sums(real: Any):
    """Return the type of a cell's sums: momenta of faces, `FILL`, masses of faces, `HAT`."""
    return wp.types.vector(8, real)


@wp.func
def cell_at(s: Any):
    """Return the cell that contains a point [cells from the window's corner]."""
    return wp.vec3i(int(wp.floor(s[0])), int(wp.floor(s[1])), int(wp.floor(s[2])))


@wp.func
def number(cell: wp.vec3i, size: wp.vec3i):
    """Return the index of a cell of the window."""
    return (cell[0] * size[1] + cell[1]) * size[2] + cell[2]


@wp.func
def cell_of(n: int, size: wp.vec3i):
    """Return the cell (i, j, k) with the index n."""
    row = n // size[2]
    i = row // size[1]
    return wp.vec3i(i, row - i * size[1], n - row * size[2])


@wp.func
def inner(cell: wp.vec3i, size: wp.vec3i, rim: int):
    """Return whether a cell is at least `rim` cells away from the window's border."""
    return (
        cell[0] >= rim
        and cell[1] >= rim
        and cell[2] >= rim
        and cell[0] < size[0] - rim
        and cell[1] < size[1] - rim
        and cell[2] < size[2] - rim
    )


@wp.func
def stride(axis: int, size: wp.vec3i):
    """Return the memory stride between neighbouring cells along an axis."""
    step = 1
    if axis == 0:
        step = size[1] * size[2]
    if axis == 1:
        step = size[2]
    return step


@wp.func
def local(x: Any, lattice: Any, window: wp.array(dtype=wp.vec3i)):
    """Convert a position [m] to cells from the window's corner."""
    low = window[0]
    dx = lattice[3]
    return wp.vector(
        (x[0] - lattice[0]) / dx - type(dx)(low[0]),
        (x[1] - lattice[1]) / dx - type(dx)(low[1]),
        (x[2] - lattice[2]) / dx - type(dx)(low[2]),
    )


@wp.func
def entry(active: wp.array(dtype=int), ends: wp.array(dtype=int), worker: int, k: int):
    """Return the k-th active cell of a worker, or -1 if the worker has fewer active cells."""
    at = item(ends, worker) + k
    if at >= item(ends, worker + 1):
        return -1
    return item(active, at)


@build_once
def make_sum_copies(real: Any, width: int):
    """Kernel over active cells: adds the sums of all other workers to the first worker's sums.

    The sums are added in a fixed order, so the result depends only on the number of workers.
    """
    vector = wp.types.vector(width, real)

    @kernel(f"phy124_liquid_sum_copies_{width}_{real.__name__}", real, seconds=0.2)
    def sum_copies(worker, active, ends, count, copies: int, cells_out: wp.array(dtype=vector)):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        total = cells_out[n]
        for c in range(1, copies):
            total += cells_out[c * count + n]
        cells_out[n] = total

    return sum_copies


@build_once
def make_extent(real: Any):
    """Kernel: computes the bounding box of the particles and their largest squared speed.

    The lowest corner is stored as the maximum of -x.
    """
    t = types(real)
    vec7 = wp.types.vector(7, real)

    @kernel(f"phy124_liquid_extent_{real.__name__}", real, seconds=0.3)
    def extent(first, each, stride, count, x, v, maxima_out: t.reals, stray_out: Ints):
        most = vec7()
        for i in range(6):
            most[i] = real(-wp.inf)
        for k in range(each):
            p = wp.tid() * first + k * stride
            if p < count:
                here = x[p]
                fast = wp.dot(v[p], v[p])
                if fast + wp.dot(here, here) < real(wp.inf):
                    for axis in range(3):
                        most[axis] = wp.max(most[axis], -here[axis])
                        most[3 + axis] = wp.max(most[3 + axis], here[axis])
                    most[6] = wp.max(most[6], fast)
                else:
                    wp.atomic_add(stray_out, 0, 1)
        for i in range(7):
            wp.atomic_max(maxima_out, i, most[i])

    return extent
