"""Rows of nodes in a box of the grid, where a copy of the box has them, and what is done to rows.

The loops over a row are C++ that a CPU vectorises. A GPU, where each thread has one node, takes the
part before the loop.
"""

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


COPY = """
if (count > 0) wp::array_store(nodes, at, wp::index(others, start));
for (int k = 1; k < count; ++k) nodes.data[at + k] = others.data[start + k];
"""
CLEAR = """
for (int k = 0; k < count; ++k) nodes.data[at + k] = {};
"""
ADD = """
auto* sums = &nodes.data[at].c[0];
const auto* more = &others.data[start].c[0];
for (int k = 0; k < 4 * count; ++k) sums[k] += more[k];
"""
CHANGED = """
const auto differ = [](const auto& a, const auto& b) {
    return bool((a[0] != b[0]) | (a[1] != b[1]) | (a[2] != b[2]));
};
if (first >= end || differ(wp::index(nodes, at + first), wp::index(others, start + first)))
    return first;
for (int k = first + 1; k < end; ++k)
    if (differ(nodes.data[at + k], others.data[start + k])) return k;
return end;
"""


@wp.func_native(COPY)
def copy_row(
    nodes: wp.array(dtype=wp.vec4), at: int, others: wp.array(dtype=wp.vec4), start: int,
    count: int,
):  # fmt: skip
    """Copy nodes that follow each other from others."""
    ...


@wp.func_native(COPY)
def copy_row(  # noqa: F811
    nodes: wp.array(dtype=wp.vec4d), at: int, others: wp.array(dtype=wp.vec4d), start: int,
    count: int,
):  # fmt: skip
    """Copy nodes that follow each other from others, in float64."""
    ...


@wp.func_native(CLEAR)
def clear_row(nodes: wp.array(dtype=wp.vec4), at: int, count: int):
    """Set nodes that follow each other to zero."""
    ...


@wp.func_native(CLEAR)
def clear_row(nodes: wp.array(dtype=wp.vec4d), at: int, count: int):  # noqa: F811
    """The same in float64."""
    ...


@wp.func_native(ADD)
def add_row(
    nodes: wp.array(dtype=wp.vec4), at: int, others: wp.array(dtype=wp.vec4), start: int,
    count: int,
):  # fmt: skip
    """Add others to nodes that follow each other."""
    ...


@wp.func_native(ADD)
def add_row(  # noqa: F811
    nodes: wp.array(dtype=wp.vec4d), at: int, others: wp.array(dtype=wp.vec4d), start: int,
    count: int,
):  # fmt: skip
    """Add others to nodes that follow each other, in float64."""
    ...


@wp.func_native(CHANGED)
def next_changed(
    nodes: wp.array(dtype=wp.vec4), at: int, others: wp.array(dtype=wp.vec4), start: int,
    first: int, end: int,
) -> int:  # fmt: skip
    """The first k from `first` on for which two nodes differ in velocity; `end` if none does."""
    ...


@wp.func_native(CHANGED)
def next_changed(  # noqa: F811
    nodes: wp.array(dtype=wp.vec4d), at: int, others: wp.array(dtype=wp.vec4d), start: int,
    first: int, end: int,
) -> int:  # fmt: skip
    """The same in float64."""
    ...
