"""Positions, memory indices and masses of the nodes in a window of the grid."""

from typing import Any

import warp as wp


@wp.func
def place(lattice: Any, node: wp.vec3i):
    """Return the position of a node of the grid [m]."""
    dx = lattice[3]
    return wp.vector(
        lattice[0] + dx * type(dx)(node[0]),
        lattice[1] + dx * type(dx)(node[1]),
        lattice[2] + dx * type(dx)(node[2]),
    )


@wp.func
def holds(size: wp.vec3i, span: wp.vec2i, node: wp.vec3i):
    """Return whether a node is inside the window and in the layers that this launch may change."""
    return (
        node[0] >= span[0]
        and node[1] >= 0
        and node[2] >= 0
        and node[0] < span[1]
        and node[1] < size[1]
        and node[2] < size[2]
    )


@wp.func
def node_at(n: int, size: wp.vec3i):
    """Return the n-th node of a window."""
    row = n // size[2]
    return wp.vec3i(row // size[1], row % size[1], n % size[2])


@wp.func
def in_box(node: wp.vec3i, extent: wp.vec3i):
    """Return whether a node, relative to the first node of a box, is inside the box."""
    return (
        node[0] >= 0
        and node[1] >= 0
        and node[2] >= 0
        and node[0] < extent[0]
        and node[1] < extent[1]
        and node[2] < extent[2]
    )


@wp.func
def strides(size: wp.vec3i):
    """Return the memory stride between neighbouring nodes along each axis."""
    return wp.vec3i(size[1] * size[2], size[2], 1)


@wp.func
def laden(grid: wp.array(dtype=Any), size: wp.vec3i, span: wp.vec2i, node: wp.vec3i):
    """Return whether a node has mass and this launch may change the node."""
    if not holds(size, span, node):
        return False
    q = grid[wp.dot(node, strides(size))]
    return q[3] > type(q[3])(0.0)
