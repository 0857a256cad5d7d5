"""Updates the grid between scatter and gather, and provides operations on rows of nodes.

On a CPU, the operations on rows are vectorised (native/reduction.h).
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Box, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.native import code
from phy124.kernels.reduction import load, raise_to


@wp.func
def row_in_grid(box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i), i: int, j: int):
    """Return the index, in the window, of the first node of row (i, j) of a box."""
    low = box[0]
    size = window[1]
    return ((i + low[0]) * size[1] + j + low[1]) * size[2] + low[2]


@wp.func
def row_in_copy(box: wp.array(dtype=wp.vec3i), i: int, j: int):
    """Return the index of the first node of row (i, j) in a copy of a box of nodes."""
    count = box[1]
    return (i * count[1] + j) * count[2]


@wp.func_native(code("reduction:copy_row"))
def copy_row(
    nodes: wp.array(dtype=Any), at: int, others: wp.array(dtype=Any), start: int, count: int
):
    """Copy consecutive nodes from another array."""
    ...


@wp.func_native(code("reduction:clear_row"))
def clear_row(nodes: wp.array(dtype=Any), at: int, count: int):
    """Set consecutive nodes to zero."""
    ...


@wp.func_native(code("reduction:add_row"))
def add_row(
    nodes: wp.array(dtype=Any), at: int, others: wp.array(dtype=Any), start: int, count: int
):
    """Add the nodes of another array to consecutive nodes."""
    ...


# Warp loses the return type of a generic native function, so each precision has an overload.
for vec4 in (wp.vec4, wp.vec4d):

    @wp.func_native(code("reduction:next_changed"))
    def next_changed(
        nodes: wp.array(dtype=vec4),
        at: int,
        others: wp.array(dtype=vec4),
        start: int,
        first: int,
        end: int,
    ) -> int:
        """Return the first index from `first` on at which the velocities in two rows of nodes
        differ.

        If the rows are equal, the result is `end`.
        """
        ...


@wp.func
def velocity_of(q: Any, kick: Any, a: Any):
    """Return (velocity, mass) of a node with (momentum, mass) q after an acceleration a [m/s^2].

    The acceleration acts for the time `kick` [s]. A node without mass is returned unchanged.
    """
    m = q[3]
    if m > type(m)(0.0):
        return wp.vector(q[0] / m + kick * a[0], q[1] / m + kick * a[1], q[2] / m + kick * a[2], m)
    return q


@build_once
def make_update(real: Any):
    """Kernel: converts (momentum, mass) to (velocity, mass); applies the uniform acceleration."""

    @kernel(f"phy124_grid_{real.__name__}", real, seconds=0.15)
    def update(clock, values, grid, grid_out):
        n = wp.tid()
        # Slot 0 of the tracks is the sum of all uniform accelerations, including gravity.
        grid_out[n] = velocity_of(load(grid, n), clock[0], values[0])

    return update


@build_once
def make_merge(real: Any):
    """Kernel over rows of nodes: sums the workers' separate copies of the nodes after the scatter.

    `boxes` contains the lowest node and the extent of each worker's box, and `starts` the index in
    `pool` of the box's first node. The boxes are always added in the same order.
    """
    t = types(real)

    @kernel(f"phy124_merge_{real.__name__}", real)
    def merge(layer: int, window, boxes: Box, starts: Ints, pool: t.vec4s, grid_out):
        i, j = wp.tid()
        size = window[1]
        row = ((layer + i) * size[1] + j) * size[2]
        added = int(0)
        for b in range(starts.shape[0]):
            low = boxes[2 * b] - window[0]
            extent = boxes[2 * b + 1]
            across = layer + i - low[0]
            along = j - low[1]
            if across >= 0 and across < extent[0] and along >= 0 and along < extent[1]:
                start = starts[b] + (across * extent[1] + along) * extent[2]
                if added == 0:
                    clear_row(grid_out, row, low[2])
                    copy_row(grid_out, row + low[2], pool, start, extent[2])
                    clear_row(grid_out, row + low[2] + extent[2], size[2] - low[2] - extent[2])
                else:
                    add_row(grid_out, row + low[2], pool, start, extent[2])
                added += 1
        if added == 0:
            clear_row(grid_out, row, size[2])

    return merge


@build_once
def make_grid_speed(real: Any):
    """Kernel: computes the largest squared speed of nodes with mass, to check a substep."""
    t = types(real)

    @kernel(f"phy124_grid_speed_{real.__name__}", real)
    def grid_speed(grid, fastest_out: t.reals):
        q = grid[wp.tid()]
        if q[3] > real(0.0):
            square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2]
            # A comparison with NaN is false, so NaN must be handled separately.
            if not wp.isfinite(square):
                square = real(1.0e38)
            raise_to(fastest_out, 0, square)

    return grid_speed
