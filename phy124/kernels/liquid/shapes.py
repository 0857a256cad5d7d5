"""Represents a particle body immersed in a liquid as a wall of the same shape.

The distance from a body follows from the fraction of each cell that the body fills (as in
`surface`). A surface from these fractions has rounded edges, so the surface is shifted outwards
until it encloses the body's volume.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.liquid.active import EMPTY
from phy124.kernels.liquid.faces import cell_at, cell_of, inner, local, number, stride
from phy124.kernels.liquid.surface import depth, filled_share
from phy124.kernels.liquid.walls import GAP, SHUT, centre_of, halves, square

BURIED = wp.constant(0.7)
"""A cell's fill determines a body's surface only if walls cover at most this part of the cell."""


@wp.func
def spline(s: Any, cell: wp.vec3i, a: int, b: int, c: int):
    """Return the value at a point of the B-spline of the cell `cell` + (a, b, c) - 1."""
    weight = type(s[0])(1.0)
    at = wp.vec3i(a, b, c)
    for axis in range(3):
        d = wp.abs(s[axis] - type(s[0])(cell[axis] + at[axis]) + type(s[0])(0.5))
        if d < type(s[0])(0.5):
            weight *= type(s[0])(0.75) - d * d
        else:
            far = wp.max(type(s[0])(1.5) - d, type(s[0])(0.0))
            weight *= type(s[0])(0.5) * far * far
    return weight


@build_once
def make_body_scatter(real: Any):
    """Kernel: adds momentum, mass and volume of a body's particles to the cells.

    Positions are extrapolated by the velocities times `ahead` [s].
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_scatter_{real.__name__}", real, seconds=0.4)
    def body_scatter(
        ahead: real, lattice, window, mass, volume, x, v, C, F, sheet_out, full_out: t.reals
    ):
        p = wp.tid()
        size = window[1]
        place = x[p] + ahead * v[p]
        s = local(place, lattice, window)
        cell = cell_at(s)
        if not inner(cell, size, 2):
            return
        filled = volume[p] * wp.clamp(wp.determinant(F[p]), real(0.1), real(3.0))
        for a in range(3):
            for b in range(3):
                for c in range(3):
                    at = cell + wp.vec3i(a - 1, b - 1, c - 1)
                    w = spline(s, cell, a, b, c)
                    n = number(at, size)
                    there = v[p] + C[p] @ (centre_of(at, lattice, window[0]) - place)
                    m = w * mass[p]
                    row = wp.vector(m * there[0], m * there[1], m * there[2], m)
                    wp.atomic_add(sheet_out, n, row)
                    wp.atomic_add(full_out, n, w * filled)

    return body_scatter


@wp.func
def eighth(cell: wp.vec3i, a: int, b: int, c: int, like: Any):
    """Return the centre of an eighth of a cell, in cells from the window's corner."""
    half = type(like)(0.5)
    quarter = type(like)(0.25)
    return wp.vector(
        type(like)(cell[0]) + quarter + half * type(like)(a),
        type(like)(cell[1]) + quarter + half * type(like)(b),
        type(like)(cell[2]) + quarter + half * type(like)(c),
    )


@wp.func
def raw_level(full: wp.array(dtype=Any), shares: wp.array(dtype=Any), n: int, dx: Any):
    """Return the distance from a body to a cell's centre [cells], from the cell's fill."""
    level = type(dx)(EMPTY)
    if full[n] > type(dx)(0.0):
        level = -depth(filled_share(full[n], shares[n][1], dx))
    return level


@wp.func
def way_out(shares: wp.array(dtype=Any), n: int, size: wp.vec3i):
    """Return the index step from a cell inside walls to the one of its 26 neighbours that lies in
    the direction out of the walls.
    """
    slopes = wp.vector(type(shares[n][1])(0.0), type(shares[n][1])(0.0), type(shares[n][1])(0.0))
    for axis in range(3):
        step = stride(axis, size)
        slopes[axis] = shares[n - step][1] - shares[n + step][1]
    least = type(shares[n][1])(0.5) * wp.max(wp.abs(slopes))
    way = int(0)
    for axis in range(3):
        if wp.abs(slopes[axis]) > least:
            way += int(wp.sign(slopes[axis])) * stride(axis, size)
    return way


@wp.func
def level_near(
    full: wp.array(dtype=Any), shares: wp.array(dtype=Any), n: int, size: wp.vec3i, dx: Any
):
    """Return the distance of a cell's centre from a body [cells], extrapolated inside walls.

    The extrapolation is linear along the line to the nearest cell outside the walls.
    """
    m = n
    for _ in range(3):
        if shares[m][1] > type(dx)(BURIED):
            m += way_out(shares, m, size)
    level = raw_level(full, shares, m, dx)
    if m != n and shares[m][1] <= type(dx)(BURIED):
        further = raw_level(full, shares, 2 * m - n, dx)
        level = wp.clamp(level + level - further, -type(dx)(EMPTY), type(dx)(EMPTY))
    return level


@build_once
def make_body_level(real: Any):
    """Kernel over a region's cells: computes the distance from a body's surface [cells].

    A body that touches a wall is extended into the wall, so that no liquid gets between them. The
    surface is shifted outwards by `shift` [cells]. The body's volume [cells] is added to
    `volumes_out`.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_level_{real.__name__}", real, seconds=0.3)
    def body_level(
        shift: real, lattice, window, region, full: t.reals, shares, level_out, volumes_out: Doubles
    ):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if inner(cell, size, 0):
            n = number(cell, size)
            dx = lattice[3]
            level = raw_level(full, shares, n, dx)
            if inner(cell, size, 7):
                level = level_near(full, shares, n, size, dx)
            if level < real(EMPTY):
                level_out[n] = level - shift
            wp.atomic_add(volumes_out, 0, wp.float64(full[n] / (dx * dx * dx)))

    return body_level


@wp.func
def level_at(level: wp.array(dtype=Any), s: Any, size: wp.vec3i):
    """Return a point's distance from a body [cells], interpolated linearly between cell centres."""
    half = type(s[0])(0.5)
    low = cell_at(s - wp.vector(half, half, half))
    total = type(s[0])(EMPTY)
    if inner(low, size, 1):
        total = type(s[0])(0.0)
        u = s - wp.vector(half, half, half)
        u -= wp.vector(type(s[0])(low[0]), type(s[0])(low[1]), type(s[0])(low[2]))
        unit = type(s[0])(1.0)
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    w = wp.where(a == 1, u[0], unit - u[0]) * wp.where(b == 1, u[1], unit - u[1])
                    w *= wp.where(c == 1, u[2], unit - u[2])
                    total += w * level[number(low + wp.vec3i(a, b, c), size)]
    return total


@build_once
def make_body_volume(real: Any):
    """Kernel over a region's cells: sums a body's volume outside walls.

    `volumes_out` receives this volume [cells], and its change if the surface is shifted by one
    cell. `vacant` contains the fraction of each eighth of a cell that is outside walls.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_volume_{real.__name__}", real, seconds=0.3)
    def body_volume(window, region, level, vacant: t.reals, volumes_out: Doubles):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        here = level[number(cell, size)]
        if here >= real(EMPTY):
            return
        half = real(0.5)
        inside = real(0.0)
        slope = real(0.0)
        parts = int(2)
        for a in range(parts):
            for b in range(parts):
                for c in range(parts):
                    d = level_at(level, eighth(cell, a, b, c, here), size)
                    share = half - real(2.0) * d
                    room = vacant[number(2 * cell + wp.vec3i(a, b, c), 2 * size)]
                    inside += real(0.125) * room * wp.clamp(share, real(0.0), real(1.0))
                    if share > real(0.0) and share < real(1.0):
                        slope += real(0.25) * room
        wp.atomic_add(volumes_out, 1, wp.float64(inside))
        wp.atomic_add(volumes_out, 2, wp.float64(slope))

    return body_volume


@build_once
def make_body_distance(real: Any):
    """Kernel over points at half the grid spacing: updates the distance to the nearest body."""

    @kernel(f"phy124_liquid_body_distance_{real.__name__}", real, seconds=0.3)
    def body_distance(wall, lattice, window, region, level, distances_out, owners_out):
        at = cell_of(wp.tid(), halves(region[1])) + 2 * region[0]
        if not inner(at, halves(window[1]), 0):
            return
        n = number(at, halves(window[1]))
        half = real(0.5)
        s = wp.vector(half * real(at[0]), half * real(at[1]), half * real(at[2]))
        d = level_at(level, s, window[1])
        if d < real(0.98) * real(EMPTY) and d * lattice[3] < distances_out[n]:
            distances_out[n] = d * lattice[3]
            owners_out[n] = wall

    return body_distance


@build_once
def make_body_openings(real: Any):
    """Kernel over a region's cells: multiplies open fractions by the fraction outside a body, for
    the low faces and the eighths of each cell.
    """
    t = types(real)

    @kernel(f"phy124_liquid_body_openings_{real.__name__}", real, seconds=0.5)
    def body_openings(window, region, level, open_out, vacant_out: t.reals):
        cell = cell_of(wp.tid(), region[1]) + region[0]
        size = window[1]
        if not inner(cell, size, 2):
            return
        n = number(cell, size)
        if level[n] >= real(EMPTY):
            return
        half = real(0.5)
        low = wp.vector(real(cell[0]), real(cell[1]), real(cell[2]))
        share = open_out[n]
        for axis in range(3):
            e = t.vec3()
            f = t.vec3()
            e[(axis + 1) % 3] = real(1.0)
            f[(axis + 2) % 3] = real(1.0)
            part = square(
                level_at(level, low, size),
                level_at(level, low + e, size),
                level_at(level, low + e + f, size),
                level_at(level, low + f, size),
                level_at(level, low + half * (e + f), size),
            )
            share[axis] = share[axis] * part
            if share[axis] < real(SHUT):
                share[axis] = real(0.0)
            if share[axis] > real(1.0) - real(SHUT):
                share[axis] = real(1.0)
        open_out[n] = share
        twice = 2 * size
        parts = int(2)
        for a in range(parts):
            for b in range(parts):
                for c in range(parts):
                    d = level_at(level, eighth(cell, a, b, c, half), size)
                    m = number(2 * cell + wp.vec3i(a, b, c), twice)
                    vacant_out[m] = vacant_out[m] * wp.clamp(
                        half + real(2.0) * d, real(0.0), real(1.0)
                    )

    return body_openings


@build_once
def make_body_push_out(real: Any):
    """Kernel: moves particles of liquid out of bodies; `wall` is the index of the first body."""
    t = types(real)

    @kernel(f"phy124_liquid_body_push_out_{real.__name__}", real, seconds=0.4)
    def body_push_out(wall, lattice, window, distances, owners, x_out):
        p = wp.tid()
        size = window[1]
        dx = lattice[3]
        s = local(x_out[p], lattice, window)
        if not inner(cell_at(s), size, 1):
            return
        near = number(cell_at(real(2.0) * s + t.vec3(real(0.5))), halves(size))
        if owners[near] < wall or distances[near] > dx:
            return
        low = cell_at(real(2.0) * s)
        u = real(2.0) * s - wp.vector(real(low[0]), real(low[1]), real(low[2]))
        d = real(0.0)
        slope = t.vec3()
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    at = wp.vec3i(a, b, c)
                    here = distances[number(low + at, halves(size))]
                    w = t.vec3()
                    for axis in range(3):
                        w[axis] = wp.where(at[axis] == 1, u[axis], real(1.0) - u[axis])
                    d += w[0] * w[1] * w[2] * here
                    for axis in range(3):
                        side = wp.where(at[axis] == 1, real(1.0), real(-1.0))
                        slope[axis] += side * w[(axis + 1) % 3] * w[(axis + 2) % 3] * here
        deep = real(GAP) * dx - d
        if deep > real(0.0) and wp.length(slope) > real(0.0):
            x_out[p] = x_out[p] + wp.min(deep, real(0.5) * dx) * wp.normalize(slope)

    return body_push_out
