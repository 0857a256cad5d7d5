"""Walls of a liquid: distances at half the grid's spacing, open shares of faces, and particles.

The lattice of distances has points at the corners, edges, faces and centres of cells, so the
fraction of each face that is open (Ng, Min and Gibou 2009) and the volume of each eighth of a cell
that is solid follow from it. A new shape needs only its distance function (distance.py).
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.distance import SHAPES
from phy124.kernels.liquid.faces import cell_at, cell_of, inner, local, number

SHUT = wp.constant(1.0e-3)
"""Open share below which a face is closed."""
GAP = wp.constant(0.02)
"""Distance from a wall to which particles are moved back [cells]."""
NEAR = wp.constant(1.5)
"""Distance from a wall within which particles may be behind it after a step [cells]."""


@wp.func
def halves(size: wp.vec3i):
    """Return the number of points of the lattice of distances along each axis."""
    return wp.vec3i(2 * size[0] + 1, 2 * size[1] + 1, 2 * size[2] + 1)


@wp.func
def point(cell: wp.vec3i, a: int, b: int, c: int, size: wp.vec3i):
    """Return the index of the point (a, b, c) half spacings from a cell's low corner."""
    return number(wp.vec3i(2 * cell[0] + a, 2 * cell[1] + b, 2 * cell[2] + c), halves(size))


@wp.func
def triangle(a: Any, b: Any, c: Any):
    """Return the positive fraction of a triangle with linear values a, b, c at its corners."""
    zero = type(a)(0.0)
    unit = type(a)(1.0)
    low = wp.min(a, wp.min(b, c))
    high = wp.max(a, wp.max(b, c))
    middle = a + b + c - low - high
    if high <= zero:
        return zero
    if low >= zero:
        return unit
    if middle <= zero:
        return high / (high - low) * high / (high - middle)
    return unit - low / (low - high) * low / (low - middle)


@wp.func
def square(a: Any, b: Any, c: Any, d: Any, middle: Any):
    """Return the positive fraction of a square with values at its corners, in order, and centre."""
    return type(a)(0.25) * (
        triangle(a, b, middle)
        + triangle(b, c, middle)
        + triangle(c, d, middle)
        + triangle(d, a, middle)
    )


@cache
def make_wall_distance(shape: str, real: Any):
    """Kernel over points of half the spacing: lowers the distance to that of a wall.

    `wall` is the wall's number, which is stored in the points nearest to the wall; `slot` is the
    index of the wall's displacement, or 0 for a wall that never moves. A wall whose track has ended
    has no effect.
    """
    t = types(real)
    distance = SHAPES[shape]

    @kernel(f"phy124_liquid_wall_{shape}_{real.__name__}", real, seconds=0.3)
    def wall_distance(
        first,
        wall: int,
        slot,
        geometry,
        lattice,
        window,
        values,
        distances_out: t.reals,
        owners_out: Ints,
    ):
        n = first + wp.tid()
        at = cell_of(n, halves(window[1]))
        low = window[0]
        half = real(0.5) * lattice[3]
        x = wp.vector(
            lattice[0] + half * real(2 * low[0] + at[0]),
            lattice[1] + half * real(2 * low[1] + at[1]),
            lattice[2] + half * real(2 * low[2] + at[2]),
        )
        active = real(1.0)
        if slot > 0:
            q = values[slot]
            x -= wp.vector(q[0], q[1], q[2])
            active = q[3]
        s = distance(x, geometry)
        if active > real(0.0) and s[3] < distances_out[n]:
            distances_out[n] = s[3]
            owners_out[n] = wall

    return wall_distance


@cache
def make_openings(real: Any):
    """Kernel over cells: the open share of the three low faces of each cell."""
    t = types(real)

    @kernel(f"phy124_liquid_openings_{real.__name__}", real, seconds=0.3)
    def openings(first, window, distances: t.reals, open_out: t.vec4s):
        n = first + wp.tid()
        size = window[1]
        cell = cell_of(n, size)
        d0 = distances[point(cell, 0, 0, 0, size)]
        dx = distances[point(cell, 2, 0, 0, size)]
        dy = distances[point(cell, 0, 2, 0, size)]
        dz = distances[point(cell, 0, 0, 2, size)]
        dyz = distances[point(cell, 0, 2, 2, size)]
        dxz = distances[point(cell, 2, 0, 2, size)]
        dxy = distances[point(cell, 2, 2, 0, size)]
        share = wp.vector(
            square(d0, dy, dyz, dz, distances[point(cell, 0, 1, 1, size)]),
            square(d0, dx, dxz, dz, distances[point(cell, 1, 0, 1, size)]),
            square(d0, dx, dxy, dy, distances[point(cell, 1, 1, 0, size)]),
            real(0.0),
        )
        for axis in range(3):
            if share[axis] < real(SHUT):
                share[axis] = real(0.0)
            if share[axis] > real(1.0) - real(SHUT):
                share[axis] = real(1.0)
        open_out[n] = share

    return openings


@cache
def make_eighths(shape: str, real: Any):
    """Kernel over eighths of cells: multiplies the open fraction of each by that before a wall.

    The product is exact where walls are perpendicular to each other. The arguments are the same as
    for the kernel of distances.
    """
    t = types(real)
    distance = SHAPES[shape]

    @kernel(f"phy124_liquid_eighths_{shape}_{real.__name__}", real, seconds=0.2)
    def eighths(first, slot, geometry, lattice, window, values, vacant_out: t.reals):
        n = first + wp.tid()
        size = window[1]
        at = cell_of(n, wp.vec3i(2 * size[0], 2 * size[1], 2 * size[2]))
        low = window[0]
        half = real(0.5) * lattice[3]
        middle = real(0.5)
        x = wp.vector(
            lattice[0] + half * (real(2 * low[0] + at[0]) + middle),
            lattice[1] + half * (real(2 * low[1] + at[1]) + middle),
            lattice[2] + half * (real(2 * low[2] + at[2]) + middle),
        )
        active = real(1.0)
        if slot > 0:
            q = values[slot]
            x -= wp.vector(q[0], q[1], q[2])
            active = q[3]
        if active > real(0.0):
            d = distance(x, geometry)[3]
            vacant_out[n] = vacant_out[n] * wp.clamp(middle + d / half, real(0.0), real(1.0))

    return eighths


@cache
def make_solid_shares(real: Any):
    """Kernel over cells: the share of the linear and of the quadratic kernel that is solid."""
    t = types(real)
    vec6 = wp.types.vector(6, real)

    @kernel(f"phy124_liquid_solid_shares_{real.__name__}", real, seconds=0.3)
    def solid_shares(
        first, window, lattice, distances: t.reals, vacant: t.reals, shares_out: t.vec2s
    ):
        n = first + wp.tid()
        size = window[1]
        cell = cell_of(n, size)
        d = distances[point(cell, 1, 1, 1, size)]
        result = t.vec2()
        if d < real(-2.7) * lattice[3]:
            result = wp.vector(real(1.0), real(1.0))
        elif d < real(2.7) * lattice[3] and inner(cell, size, 1):
            twice = wp.vec3i(2 * size[0], 2 * size[1], 2 * size[2])
            # Integrals of the kernels over halves of cells, from 3 halves below the centre on.
            hats = vec6(real(0.0), real(0.125), real(0.375), real(0.375), real(0.125), real(0.0))
            k = real(1.0) / real(48.0)
            splines = vec6(k, real(7.0) * k, real(16.0) * k, real(16.0) * k, real(7.0) * k, k)
            for a in range(6):
                for b in range(6):
                    for c in range(6):
                        at = wp.vec3i(2 * cell[0] + a - 2, 2 * cell[1] + b - 2, 2 * cell[2] + c - 2)
                        f = real(1.0) - vacant[number(at, twice)]
                        result += f * wp.vector(
                            hats[a] * hats[b] * hats[c], splines[a] * splines[b] * splines[c]
                        )
        shares_out[n] = result

    return solid_shares


@cache
def make_push_out(shape: str, real: Any):
    """Kernel: moves particles out of a wall and stops them there.

    The tangential velocity loses up to `friction` times the normal velocity that the wall takes.
    The impulse on the particles and its work are added to `sums_out`.
    """
    t = types(real)
    distance = SHAPES[shape]

    @kernel(f"phy124_liquid_push_out_{shape}_{real.__name__}", real, seconds=0.4)
    def push_out(
        wall: int,
        slot,
        geometry,
        friction,
        stops: int,
        mass,
        lattice,
        window,
        values,
        rates,
        distances: t.reals,
        x_out,
        v_out,
        sums_out: wp.array2d(dtype=wp.float64),
    ):
        p = wp.tid()
        dx = lattice[3]
        x = x_out[p]
        size = window[1]
        cell = cell_at(local(x, lattice, window))
        d = real(-1.0)
        if inner(cell, size, 0):
            d = distances[point(cell, 1, 1, 1, size)]
        if d < real(NEAR) * dx:
            moved = t.vec3()
            u = t.vec3()
            active = real(1.0)
            if slot > 0:
                q = values[slot]
                r = rates[slot]
                moved = wp.vector(q[0], q[1], q[2])
                u = wp.vector(r[0], r[1], r[2])
                active = q[3]
            s = distance(x - moved, geometry)
            if active > real(0.0) and s[3] < real(GAP) * dx:
                normal = wp.vector(s[0], s[1], s[2])
                x_out[p] = x + (real(GAP) * dx - s[3]) * normal
                if stops > 0:
                    relative = v_out[p] - u
                    along = wp.dot(relative, normal)
                    if along < real(0.0):
                        slide = relative - along * normal
                        speed = wp.length(slide)
                        kept = real(0.0)
                        if speed > real(0.0):
                            kept = wp.max(real(0.0), real(1.0) + friction * along / speed)
                        after = u + kept * slide
                        change = mass[p] * (after - v_out[p])
                        work = real(0.5) * wp.dot(change, after + v_out[p])
                        v_out[p] = after
                        turn = wp.cross(x, change)
                        for axis in range(3):
                            wp.atomic_add(sums_out, wall, axis, wp.float64(change[axis]))
                            wp.atomic_add(sums_out, wall, 3 + axis, wp.float64(turn[axis]))
                        wp.atomic_add(sums_out, wall, 6, wp.float64(work))

    return push_out
