"""Fields on a grid: adds up the volumes of Gaussians, and computes values and gradients.

Positions and lengths are in cells of the grid, unless stated otherwise.
"""

from typing import Any

import warp as wp

from phy124.kernels.build import kernel


@wp.struct
class Grid:
    """Position and size of the grid of a field."""

    corner: wp.vec3
    """Centre of the first cell, m."""
    cell: float
    """Edge of a cell, m."""
    size: wp.vec3i
    """Number of cells along each axis."""


@wp.func
def index_of(cells: Grid, i: int, j: int, k: int) -> int:
    """Return the index of a cell in a flat array."""
    return (i * cells.size[1] + j) * cells.size[2] + k


@wp.func
def nearest(cells: Grid, at: wp.vec3) -> int:
    """Return the index of the cell whose centre is nearest to a position."""
    i = int(wp.clamp(wp.rint(at[0]), 0.0, float(cells.size[0] - 1)))
    j = int(wp.clamp(wp.rint(at[1]), 0.0, float(cells.size[1] - 1)))
    k = int(wp.clamp(wp.rint(at[2]), 0.0, float(cells.size[2] - 1)))
    return index_of(cells, i, j, k)


@wp.func
def inside(cells: Grid, at: wp.vec3) -> wp.vec3:
    """Return the position inside the grid that is nearest to a position."""
    return wp.vec3(
        wp.clamp(at[0], 0.0, float(cells.size[0] - 1)),
        wp.clamp(at[1], 0.0, float(cells.size[1] - 1)),
        wp.clamp(at[2], 0.0, float(cells.size[2] - 1)),
    )


@wp.func
def lowest(cells: Grid, at: wp.vec3) -> wp.vec3i:
    """Return the lowest of the eight cells around a position inside the grid."""
    return wp.vec3i(
        wp.min(int(at[0]), cells.size[0] - 2),
        wp.min(int(at[1]), cells.size[1] - 2),
        wp.min(int(at[2]), cells.size[2] - 2),
    )


@wp.func
def weight(corner: int, upper: wp.vec3) -> float:
    """Return the weight of one of the eight cells around a position.

    `upper` contains the weights of the upper cell along each axis.
    """
    w = float(1.0)
    for axis in range(3):
        if (corner >> axis) & 1 == 1:
            w *= upper[axis]
        else:
            w *= 1.0 - upper[axis]
    return w


@wp.func
def interpolate(cells: Grid, field: wp.array(dtype=Any), position: wp.vec3):
    """Interpolate a field linearly; outside the grid, the values at the boundary are used."""
    at = inside(cells, position)
    low = lowest(cells, at)
    upper = at - wp.vec3(float(low[0]), float(low[1]), float(low[2]))
    first = index_of(cells, low[0], low[1], low[2])
    total = weight(0, upper) * field[first]
    for corner in range(1, 8):
        step = index_of(cells, corner & 1, (corner >> 1) & 1, (corner >> 2) & 1)
        total += weight(corner, upper) * field[first + step]
    return total


@wp.func
def distribute(cells: Grid, position: wp.vec3, value: float, field_out: wp.array(dtype=float)):
    """Distribute a value among the eight cells around a position, with linear weights."""
    at = inside(cells, position)
    low = lowest(cells, at)
    upper = at - wp.vec3(float(low[0]), float(low[1]), float(low[2]))
    first = index_of(cells, low[0], low[1], low[2])
    for corner in range(8):
        step = index_of(cells, corner & 1, (corner >> 1) & 1, (corner >> 2) & 1)
        wp.atomic_add(field_out, first + step, weight(corner, upper) * value)


@kernel("phy124_fields", seconds=0.5)
def fill(
    cells: Grid,
    means: wp.array(dtype=wp.vec3),  # m
    volumes: wp.array(dtype=float),  # m^3
    # fractions of the cells, in which the volumes are added up
    filled_out: wp.array(dtype=float),
):
    """Distribute the volume of each Gaussian among the eight cells around it."""
    n = wp.tid()
    share = volumes[n] / (cells.cell * cells.cell * cells.cell)
    distribute(cells, (means[n] - cells.corner) / cells.cell, share, filled_out)


@kernel("phy124_fields", seconds=0.5)
def sample(
    cells: Grid,
    means: wp.array(dtype=wp.vec3),  # m
    field: wp.array(dtype=float),
    values_out: wp.array(dtype=float),
):
    """Interpolate a field at each Gaussian."""
    n = wp.tid()
    values_out[n] = interpolate(cells, field, (means[n] - cells.corner) / cells.cell)


@kernel("phy124_fields", seconds=0.5)
def differentiate(cells: Grid, field: wp.array(dtype=float), slopes_out: wp.array(dtype=wp.vec3)):
    """Compute the gradient of a field by central differences, one-sided at the grid's boundary."""
    n = wp.tid()
    at = wp.vec3i(
        n // (cells.size[1] * cells.size[2]), n // cells.size[2] % cells.size[1], n % cells.size[2]
    )
    stride = wp.vec3i(cells.size[1] * cells.size[2], cells.size[2], 1)
    slope = wp.vec3()
    for axis in range(3):
        before = wp.min(at[axis], 1)
        after = wp.min(cells.size[axis] - 1 - at[axis], 1)
        rise = field[n + after * stride[axis]] - field[n - before * stride[axis]]
        slope[axis] = rise / float(before + after)
    slopes_out[n] = slope
