"""Computes the filled fraction (fill) of each cell and, from the fill, the distance to the surface.

The distance to a flat surface is exact, whatever the height of the surface is. Near walls, the fill
refers to the open part of the B-spline. The thickness of a layer on a wall is the volume in a
column of cells.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.active import EMPTY
from phy124.kernels.liquid.faces import FILL, HAT, cell_of, entry, inner, stride, sums
from phy124.kernels.liquid.walls import SHUT, point

LONE = wp.constant(0.3)
"""Smallest fill around a particle that is not a drop in flight, and of a cell of a layer whose
surface is below the cell's centre.
"""
THIN = wp.constant(0.02)
"""Thickness of the thinnest layer with pressure [cells]; in a thinner layer, particles are drops.
"""
SPARSE, HALF = wp.constant(0.1), wp.constant(0.5)
"""The surface of a layer is below the second cell away from a wall that is perpendicular to an
axis, and below the next cell away from other walls: the fill of that cell is less than the fraction
`SPARSE` or `HALF` of the fill of the cell at the wall.
"""
FLAT = wp.constant(0.999)
"""A wall is perpendicular to an axis if the cosine of their angle exceeds this."""
LEAST = wp.constant(0.004)
"""Lower limit of the open part of a B-spline around a cell. Of an open cell in the corner of a
tank, at least this part is open.
"""
RIM = wp.constant(0.1)
"""In a closed cell, a B-spline whose open part is smaller counts as less filled."""


@wp.func
def depth(fill: Any):
    """Return the depth below a flat surface [cells] of a B-spline with a certain fill.

    The fill at depth T is (T + 3/2)^3 / 6 for T < -1/2, 1 - (3/2 - T)^3 / 6 for T > 1/2, and 1/2 +
    3 T / 4 - T^3 / 3 for T between -1/2 and 1/2.
    """
    unit = type(fill)(1.0)
    sixth = unit / type(fill)(6.0)
    third = unit / type(fill)(3.0)
    f = wp.clamp(fill, type(fill)(0.0), unit)
    if f == type(fill)(0.0):  # most cells
        return -type(fill)(1.5)
    if f < sixth:
        return wp.pow(type(fill)(6.0) * f, third) - type(fill)(1.5)
    if f > unit - sixth:
        return type(fill)(1.5) - wp.pow(type(fill)(6.0) * (unit - f), third)
    T = (f - type(fill)(0.5)) * type(fill)(1.5)
    for _ in range(4):
        error = type(fill)(0.5) + type(fill)(0.75) * T - T * T * T * third - f
        T -= error / (type(fill)(0.75) - T * T)
    return T


@wp.func
def opening(open: wp.array(dtype=Any), n: int, size: wp.vec3i):
    """Return the sum of the open fractions of a cell's six faces."""
    q = item(open, n)
    total = q[0] + q[1] + q[2]
    for axis in range(3):
        total += item(open, n + stride(axis, size))[axis]
    return total


@wp.func
def filled_share(volume: Any, solid: Any, dx: Any):
    """Return the filled fraction of the part of a B-spline outside walls; `solid` is the part
    inside.
    """
    open = wp.max(type(dx)(1.0) - solid, type(dx)(LEAST))
    return wp.min(volume / (dx * dx * dx) / open, type(dx)(1.0))


@wp.func
def is_flat(distances: wp.array(dtype=Any), cell: wp.vec3i, size: wp.vec3i, dx: Any):
    """Return whether the wall nearest to a cell is perpendicular to an axis."""
    here = item(distances, point(cell, 1, 1, 1, size))
    x = wp.abs(item(distances, point(cell, 3, 1, 1, size)) - here)
    y = wp.abs(item(distances, point(cell, 1, 3, 1, size)) - here)
    z = wp.abs(item(distances, point(cell, 1, 1, 3, size)) - here)
    return wp.max(x, wp.max(y, z)) > type(dx)(FLAT) * dx


@wp.func
def layer_on_wall(
    cells: wp.array(dtype=Any),
    component: int,
    open: wp.array(dtype=Any),
    shares: wp.array(dtype=Any),
    n: int,
    size: wp.vec3i,
    dx: Any,
    flat: bool,
):
    """Return the thickness of a liquid layer on a wall [cells], and the index of its cell at the
    wall.

    The layer's surface is in the cell n, which is at the wall. If the wall is `flat`, that is
    perpendicular to an axis, the cell n may also be the next cell away from the wall. The thickness
    is 0 without such a layer. In a narrow gap, the second cell away from the wall may be inside the
    opposite wall.
    """
    unit = type(dx)(1.0)
    thick = type(dx)(0.0)
    base = n
    sparse = type(dx)(wp.where(flat, SPARSE, HALF))
    # The loop count is not a constant, so that the compiler does not unroll the loop.
    first, last = wp.where(flat, -1, 0), wp.where(flat, 2, 1)
    for axis in range(3):
        step = stride(axis, size)
        for k in range(first, last):
            m = n + k * step
            jump = item(open, m + step)[axis] - item(open, m)[axis]
            if wp.abs(jump) > type(dx)(0.5) and jump * type(dx)(k) <= type(dx)(0.0):
                away = int(wp.sign(jump)) * step
                dry = m + wp.where(flat, 2, 1) * away
                far = m + 2 * away
                near = filled_share(item(cells, m)[component], item(shares, m)[1], dx)
                most = sparse * near
                if (
                    near < unit
                    and filled_share(item(cells, dry)[component], item(shares, dry)[1], dx) < most
                ):
                    volume = type(dx)(0.0)
                    for i in range(5):
                        volume += item(cells, m + (i - 2) * step)[component]
                    # Walls at the sides of the layer occupy a fraction of the column.
                    part = wp.max(unit - item(shares, far)[1], type(dx)(0.3))
                    thick = volume / (dx * dx * dx) / part
                    base = m
    return thick, base


@wp.func
def level(
    cells: wp.array(dtype=Any),
    component: int,
    open: wp.array(dtype=Any),
    shares: wp.array(dtype=Any),
    distances: wp.array(dtype=Any),
    owners: wp.array(dtype=int),
    solid: int,
    n: int,
    size: wp.vec3i,
    dx: Any,
):
    """Return a cell's fill, its centre's distance from the surface, and 1 if the cell is liquid.

    The distance from the surface of a layer on a wall follows from the layer's thickness. If this
    surface is below the centre of the cell at the wall, the cell still counts as liquid if it is
    filled enough. Particles in a very thin layer count as drops instead. On a dry wall, the surface
    is the wall. For a cell inside a wall, only the rim of the B-spline reaches the liquid, so the
    fill is halved, or reduced more if the rim is small.

    Args:
        cells: Sums over the particles; the sum with the index `component` is the volume.
        component: Index of the volume.
        open: Open fractions of the low faces.
        shares: Solid fractions of the linear kernel and of the B-spline.
        distances: Distances from the walls at points with half the grid spacing [m].
        owners: Index of the nearest wall for each distance.
        solid: Index of the first wall that is a body or a freely moving solid; no layers of liquid
            form on such walls.
        n: Index of the cell.
        size: Size of the window.
        dx: Grid spacing [m].
    """
    zero = type(dx)(0.0)
    filled = filled_share(item(cells, n)[component], item(shares, n)[1], dx)
    phi = -depth(filled)
    wet = int(0)
    cell = cell_of(n, size)
    height = type(dx)(EMPTY)
    flat = bool(False)
    if item(shares, n)[1] > zero:
        middle = point(cell, 1, 1, 1, size)
        if item(owners, middle) < solid:
            height = item(distances, middle) / dx
            flat = is_flat(distances, cell, size, dx)
    if (filled > zero or (flat and height < zero)) and inner(cell, size, 2):
        if opening(open, n, size) <= type(dx)(SHUT):
            rim = (type(dx)(1.0) - item(shares, n)[1]) / type(dx)(RIM)
            filled *= type(dx)(0.5) * wp.min(rim, type(dx)(1.0))
        elif filled == zero:
            phi = height
        else:
            wet = wp.where(phi < zero, 1, 0)
            thick = zero
            base = n
            if height < type(dx)(EMPTY) and filled < type(dx)(1.0) and inner(cell, size, 3):
                thick, base = layer_on_wall(cells, component, open, shares, n, size, dx, flat)
            if thick > zero:
                phi = item(distances, point(cell_of(base, size), 1, 1, 1, size)) / dx - thick
                if base != n:
                    phi += type(dx)(1.0)
                wet = wp.where(flat and phi < zero and thick >= type(dx)(THIN), 1, 0)
                if base == n:
                    wet = wp.where(filled >= type(dx)(LONE), 1, wet)
                    filled = type(dx)(wet)
    return filled, phi, wet


@build_once
def make_levels(real: Any):
    """Kernel over cells: converts sums to velocities, densities, and distance to the surface.

    `known_out` contains a bit for each face that has a velocity. `hats_out` is the fraction of the
    linear kernel that is filled by liquid or solid. `phi_out` is the distance to the surface
    [cells], negative in the liquid. The kernel also applies the uniform acceleration.
    """
    t = types(real)
    vec8 = sums(real)

    @kernel(f"phy124_liquid_levels_{real.__name__}", real, seconds=0.4)
    def levels(
        worker,
        active,
        ends,
        lattice,
        window,
        clock,
        values,
        open,
        shares,
        distances,
        owners,
        solid,
        cells: wp.array(dtype=vec8),
        velocity_out,
        hats_out,
        phi_out,
        liquid_out,
        known_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        q = item(cells, n)
        a = values[0]
        v = t.vec4()
        known = int(0)
        for axis in range(3):
            m = q[4 + axis]
            if m > real(0.0):
                v[axis] = q[axis] / m + clock[0] * a[axis]
                if item(open, n)[axis] > real(0.0):
                    known += 1 << axis
        share = item(shares, n)
        filled, phi, wet = level(
            cells, FILL, open, shares, distances, owners, solid, n, size, lattice[3]
        )
        v[3] = filled
        velocity_out[n] = v
        hats_out[n] = q[HAT] / (lattice[3] * lattice[3] * lattice[3]) + share[0]
        phi_out[n] = phi
        liquid_out[n] = wet
        known_out[n] = known

    return levels


@build_once
def make_refill(real: Any):
    """Kernel over cells: computes densities and the distance to the surface from volumes."""

    @kernel(f"phy124_liquid_refill_{real.__name__}", real, seconds=0.3)
    def refill(
        worker,
        active,
        ends,
        lattice,
        window,
        open,
        shares,
        distances,
        owners,
        solid,
        fills,
        hats_out,
        phi_out,
        liquid_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        size = window[1]
        share = item(shares, n)
        q = item(fills, n)
        hats_out[n] = q[1] / (lattice[3] * lattice[3] * lattice[3]) + share[0]
        _, phi, wet = level(fills, 0, open, shares, distances, owners, solid, n, size, lattice[3])
        phi_out[n] = phi
        liquid_out[n] = wet

    return refill
