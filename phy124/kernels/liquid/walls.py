"""Computes distances from walls and the open fractions of faces.

Distances are stored at the corners and at the centres of edges, faces and cells. The open fraction
of each face (Ng, Min and Gibou 2009) and the solid volume of each eighth of a cell are computed
from the distances.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.collide import FLAT
from phy124.kernels.diagnostics import wide
from phy124.kernels.distance import SHAPES
from phy124.kernels.free.numbers import PLACE, at3, axes
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import cell_of, inner, number, stride

SHUT = wp.constant(1.0e-3)
"""A face counts as closed if its open fraction is below this value."""
SLACK = wp.constant(1.0e-4)
"""A face at most this far in front of a wall is closed [cells]; otherwise, rounding errors would
decide whether a face that lies on the wall is open.
"""
GAP = wp.constant(0.02)
"""Particles inside a wall are moved this far in front of the wall [cells]."""
DISTANT = wp.constant(2.0)
"""Distance [cells] beyond which a wall closes no part of a cell or of a face."""


@wp.func
def halves(size: wp.vec3i):
    """Return the number of points, half a cell apart, along each axis."""
    return wp.vec3i(2 * size[0] + 1, 2 * size[1] + 1, 2 * size[2] + 1)


@wp.func
def point(cell: wp.vec3i, a: int, b: int, c: int, size: wp.vec3i):
    """Return the index of the point (a, b, c) half cells away from a cell's lowest corner."""
    return number(wp.vec3i(2 * cell[0] + a, 2 * cell[1] + b, 2 * cell[2] + c), halves(size))


@wp.func
def triangle(a: Any, b: Any, c: Any):
    """Return the fraction of a triangle in which a linear function is positive, from its corner
    values.
    """
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
    """Return the fraction of a square in which a function is positive.

    The arguments are values at the corners and the centre.
    """
    return type(a)(0.25) * (
        triangle(a, b, middle)
        + triangle(b, c, middle)
        + triangle(c, d, middle)
        + triangle(d, a, middle)
    )


@wp.func
def to_frame(x: Any, slot: int, values: wp.array(dtype=Any), frame: wp.array(dtype=wp.float64)):
    """Return a position in the frame of a wall's shape, and whether the wall is active.

    If `slot` is above 0, the value of this track displaces the wall. `frame` is the state of a
    freely moving solid (phy124/kernels/free/numbers.py), or empty.
    """
    active = type(x[0])(1.0)
    at = x
    if slot > 0:
        q = values[slot]
        at = x - wp.vector(q[0], q[1], q[2])
        active = q[3]
    if frame.shape[0] > 0:
        arm = wp.transpose(axes(frame)) @ (wide(x) - at3(frame, PLACE))
        at = wp.vector(type(x[0])(arm[0]), type(x[0])(arm[1]), type(x[0])(arm[2]))
    return at, active


@wp.func
def to_world(n: Any, frame: wp.array(dtype=wp.float64)):
    """Rotate a direction from the frame of a wall's shape to world axes."""
    if frame.shape[0] == 0:
        return n
    w = axes(frame) @ wide(n)
    return wp.vector(type(n[0])(w[0]), type(n[0])(w[1]), type(n[0])(w[2]))


@build_once
def make_wall_distance(shape: str, real: Any):
    """Kernel over points at half the grid spacing: updates the distance to the nearest wall.

    `walls` contains the indices of the walls, and `geometries` their shapes. `slots` contains the
    index of each wall's displacement, or 0 for a wall that never moves. A wall whose track has
    ended has no effect. `region` is the first cell and the size of a region of the window.
    """
    distance = SHAPES[shape]

    @kernel(f"phy124_liquid_wall_{shape}_{real.__name__}", real, seconds=0.3)
    def wall_distance(
        first,
        walls: Ints,
        geometries,
        slots,
        lattice,
        window,
        values,
        frame,
        region,
        distances_out,
        owners_out,
    ):
        at = cell_of(first + wp.tid(), halves(region[1])) + 2 * region[0]
        if not inner(at, halves(window[1]), 0):
            return
        n = number(at, halves(window[1]))
        low = window[0]
        half = real(0.5) * lattice[3]
        x = wp.vector(
            lattice[0] + half * real(2 * low[0] + at[0]),
            lattice[1] + half * real(2 * low[1] + at[1]),
            lattice[2] + half * real(2 * low[2] + at[2]),
        )
        least = distances_out[n]
        owner = int(-1)
        for k in range(walls.shape[0]):
            place, active = to_frame(x, slots[walls[k]], values, frame)
            d = distance(place, geometries[k])[3]
            if active > real(0.0) and d < least:
                least = d
                owner = walls[k]
        if owner >= 0:
            distances_out[n] = least
            owners_out[n] = owner

    return wall_distance


@wp.func
def speed_of(motions: wp.array2d(dtype=Any), wall: int, x: Any):
    """Return the velocity of a wall at a point [m/s]; `motions` contains V, w and centre."""
    return motions[wall, 0] + wp.cross(motions[wall, 1], x - motions[wall, 2])


@wp.func
def centre_of(cell: wp.vec3i, lattice: Any, low: wp.vec3i):
    """Return the position of a cell's centre [m]."""
    dx = lattice[3]
    half = type(dx)(0.5)
    return wp.vector(
        lattice[0] + dx * (type(dx)(low[0] + cell[0]) + half),
        lattice[1] + dx * (type(dx)(low[1] + cell[1]) + half),
        lattice[2] + dx * (type(dx)(low[2] + cell[2]) + half),
    )


@wp.func
def solid_face(cell: wp.vec3i, axis: int, jump: Any, size: wp.vec3i):
    """Return the midpoint of the less open of two opposite faces of a cell."""
    at = wp.vec3i(1, 1, 1)
    at[axis] = 0
    if jump < type(jump)(0.0):
        at[axis] = 2
    return point(cell, at[0], at[1], at[2], size)


@wp.func
def wall_across(
    cell: wp.vec3i,
    axis: int,
    jump: Any,
    size: wp.vec3i,
    distances: wp.array(dtype=Any),
    owners: wp.array(dtype=int),
    dx: Any,
):
    """Return the index of the wall that closes a cell's face, or -1 if no wall closes the face.

    Usually this is the wall nearest to the middle of the face. If several walls meet, nine points
    on the face are compared: the result is the wall nearest to the point at which the distance
    changes most along the axis. At the bottom of a tank, for example, the result is the floor
    instead of a side.
    """
    points = halves(size)
    middle = solid_face(cell, axis, jump, size)
    along = stride(axis, points)
    owner = owners[middle]
    most = wp.abs(distances[middle + along] - distances[middle - along])
    if most < type(dx)(0.9) * dx:
        a = stride((axis + 1) % 3, points)
        b = stride((axis + 2) % 3, points)
        for u in range(-1, 2):
            for v in range(-1, 2):
                at = middle + u * a + v * b
                change = wp.abs(distances[at + along] - distances[at - along])
                if change > most + type(dx)(0.01) * dx:
                    most = change
                    owner = owners[at]
    return owner


@wp.func
def part_of_solid(jump: Any, covers: wp.array(dtype=Any), n: int, step: int, axis: int):
    """Return the part of the difference of two opposite faces' open fractions due to a freely
    moving solid.

    `covers` contains the fraction of each low face that the solid closes (`make_openings`). The
    rest of the difference is due to another wall, such as the floor below the solid.
    """
    part = covers[n][axis] - covers[n + step][axis]
    if part != type(jump)(0.0) and wp.abs(jump - part) < type(jump)(SHUT):
        part = jump
    return part


@build_once
def make_openings(shape: str, real: Any):
    """Kernel over cells: multiplies the open fractions of low faces by each wall's open fraction.

    For a plane, the open fraction is computed from the distances at the corners of the face; for
    other shapes, from 64 points, since distances are not linear at edges. The product is exact if
    the walls are perpendicular to each other. `covers_out` receives the fractions that a freely
    moving solid closes.
    """
    t = types(real)
    distance = SHAPES[shape]
    flat = shape in FLAT

    @wp.func
    def far(
        middle: t.vec3,
        axis: int,
        a: real,
        b: real,
        slot: int,
        geometry: t.mat33,
        values: wp.array(dtype=t.vec4),
        frame: Doubles,
        dx: real,
    ):
        """Return the distance from a wall to the point (a, b) [m from the middle] of a face."""
        x = middle
        x[(axis + 1) % 3] = middle[(axis + 1) % 3] + a
        x[(axis + 2) % 3] = middle[(axis + 2) % 3] + b
        place, active = to_frame(x, slot, values, frame)
        if active <= real(0.0):
            return real(wp.inf)
        return distance(place, geometry)[3] - real(SLACK) * dx

    @kernel(f"phy124_liquid_openings_{shape}_{real.__name__}", real, seconds=0.4)
    def openings(
        first,
        walls: Ints,
        geometries,
        slots,
        lattice,
        window,
        values,
        frame,
        region,
        distances,
        open_out,
        covers_out,
    ):
        cell = cell_of(first + wp.tid(), region[1]) + region[0]
        if not inner(cell, window[1], 0):
            return
        n = number(cell, window[1])
        dx = lattice[3]
        if item(distances, point(cell, 1, 1, 1, window[1])) > real(DISTANT) * dx:
            return
        share = open_out[n]
        before = share
        centre = centre_of(cell, lattice, window[0])
        for k in range(walls.shape[0]):
            slot = slots[walls[k]]
            form = geometries[k]
            for axis in range(3):
                middle = centre
                middle[axis] = centre[axis] - real(0.5) * dx
                d = far(middle, axis, real(0.0), real(0.0), slot, form, values, frame, dx)
                part = real(1.0)
                if d < real(-0.75) * dx:
                    part = real(0.0)
                elif d < real(0.75) * dx:
                    if wp.static(flat):
                        h = real(0.5) * dx
                        part = square(
                            far(middle, axis, -h, -h, slot, form, values, frame, dx),
                            far(middle, axis, h, -h, slot, form, values, frame, dx),
                            far(middle, axis, h, h, slot, form, values, frame, dx),
                            far(middle, axis, -h, h, slot, form, values, frame, dx),
                            d,
                        )
                    else:
                        part = real(0.0)
                        # The loop count is not a constant, so that the compiler does not unroll the
                        # loops.
                        points = int(8)
                        for a in range(points):
                            for b in range(points):
                                u = dx * (real(a) - real(3.5)) * real(0.125)
                                v = dx * (real(b) - real(3.5)) * real(0.125)
                                e = far(middle, axis, u, v, slot, form, values, frame, dx)
                                if e > real(0.0):
                                    part += real(0.015625)
                share[axis] = share[axis] * part
                if share[axis] < real(SHUT):
                    share[axis] = real(0.0)
                if share[axis] > real(1.0) - real(SHUT):
                    share[axis] = real(1.0)
        open_out[n] = share
        if frame.shape[0] > 0:
            closed = before - share
            covers_out[n] = wp.vector(closed[0], closed[1], closed[2])

    return openings


@build_once
def make_eighths(shape: str, real: Any):
    """Kernel over the eight octants of each cell: multiplies open fractions by each wall's open
    fraction.

    The product is exact if the walls are perpendicular to each other. The kernel has the same
    arguments as the kernel of `make_wall_distance`.
    """
    t = types(real)
    distance = SHAPES[shape]

    @kernel(f"phy124_liquid_eighths_{shape}_{real.__name__}", real, seconds=0.2)
    def eighths(
        first,
        walls: Ints,
        geometries,
        slots,
        lattice,
        window,
        values,
        frame,
        region,
        distances,
        vacant_out: t.reals,
    ):
        at = cell_of(first + wp.tid(), 2 * region[1]) + 2 * region[0]
        if not inner(at, 2 * window[1], 0):
            return
        n = number(at, 2 * window[1])
        d = item(distances, number(at, halves(window[1])))
        if d > real(DISTANT) * lattice[3]:
            return
        if d < -real(DISTANT) * lattice[3]:
            vacant_out[n] = real(0.0)
            return
        low = window[0]
        half = real(0.5) * lattice[3]
        middle = real(0.5)
        x = wp.vector(
            lattice[0] + half * (real(2 * low[0] + at[0]) + middle),
            lattice[1] + half * (real(2 * low[1] + at[1]) + middle),
            lattice[2] + half * (real(2 * low[2] + at[2]) + middle),
        )
        share = vacant_out[n]
        for k in range(walls.shape[0]):
            place, active = to_frame(x, slots[walls[k]], values, frame)
            if active > real(0.0):
                depth = distance(place, geometries[k])[3]
                share *= wp.clamp(middle + depth / half, real(0.0), real(1.0))
        vacant_out[n] = share

    return eighths


@build_once
def make_solid_shares(real: Any):
    """Kernel over cells: computes the parts of a linear and a quadratic B-spline inside walls."""
    t = types(real)
    vec6 = wp.types.vector(6, real)

    @kernel(f"phy124_liquid_solid_shares_{real.__name__}", real, seconds=0.3)
    def solid_shares(first, window, lattice, region, distances, vacant: t.reals, shares_out):
        size = window[1]
        cell = cell_of(first + wp.tid(), region[1]) + region[0]
        if not inner(cell, size, 0):
            return
        n = number(cell, size)
        d = distances[point(cell, 1, 1, 1, size)]
        result = t.vec2()
        if d < real(-2.7) * lattice[3]:
            result = wp.vector(real(1.0), real(1.0))
        elif d < real(2.7) * lattice[3] and inner(cell, size, 1):
            twice = wp.vec3i(2 * size[0], 2 * size[1], 2 * size[2])
            # Integrals of the B-splines over half cells, starting three half cells below the
            # centre.
            hats = vec6(real(0.0), real(0.125), real(0.375), real(0.375), real(0.125), real(0.0))
            k = real(1.0) / real(48.0)
            splines = vec6(k, real(7.0) * k, real(16.0) * k, real(16.0) * k, real(7.0) * k, k)
            # The loop count is not a constant, so that the compiler does not unroll the loops.
            parts = int(6)
            for a in range(parts):
                for b in range(parts):
                    for c in range(parts):
                        at = wp.vec3i(2 * cell[0] + a - 2, 2 * cell[1] + b - 2, 2 * cell[2] + c - 2)
                        f = real(1.0) - vacant[number(at, twice)]
                        result += f * wp.vector(
                            hats[a] * hats[b] * hats[c], splines[a] * splines[b] * splines[c]
                        )
        shares_out[n] = result

    return solid_shares
