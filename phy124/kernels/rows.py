"""Rows of nodes in a box of the grid, and where a copy of the box has them."""

import warp as wp


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
