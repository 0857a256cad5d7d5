"""Rows of nodes in a box of the grid, where a copy of the box has them, and what is done to rows.

The loops over a row are C++ that a CPU vectorises. A GPU, where each thread has one node, takes the
part before the loop.
"""

from typing import Any

import warp as wp

from phy124.kernels.native import code


@wp.func
def row_in_grid(box: wp.array(dtype=wp.vec3i), window: wp.array(dtype=wp.vec3i), i: int, j: int):
    """Index of the first node of row (i, j) of a box (lowest node, extent) in a window's nodes."""
    low = box[0]
    size = window[1]
    return ((i + low[0]) * size[1] + j + low[1]) * size[2] + low[2]


@wp.func
def row_in_copy(box: wp.array(dtype=wp.vec3i), i: int, j: int):
    """Index of the first node of row (i, j) of a box in a copy of its nodes."""
    count = box[1]
    return (i * count[1] + j) * count[2]


@wp.func_native(code("rows:copy_row"))
def copy_row(
    nodes: wp.array(dtype=Any), at: int, others: wp.array(dtype=Any), start: int, count: int
):
    """Copy nodes that follow each other from others."""
    ...


@wp.func_native(code("rows:clear_row"))
def clear_row(nodes: wp.array(dtype=Any), at: int, count: int):
    """Set nodes that follow each other to zero."""
    ...


@wp.func_native(code("rows:add_row"))
def add_row(
    nodes: wp.array(dtype=Any), at: int, others: wp.array(dtype=Any), start: int, count: int
):
    """Add others to nodes that follow each other."""
    ...


# Warp forgets the result of a generic native function, so this one has an overload per precision.
for vec4 in (wp.vec4, wp.vec4d):

    @wp.func_native(code("rows:next_changed"))
    def next_changed(
        nodes: wp.array(dtype=vec4),
        at: int,
        others: wp.array(dtype=vec4),
        start: int,
        first: int,
        end: int,
    ) -> int:
        """Return the first k >= `first` whose nodes differ in velocity, or `end` if none does."""
        ...
