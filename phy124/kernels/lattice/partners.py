"""Finds surface points that may come into contact, and the position opposite to each point."""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.lattice.contact import NODES
from phy124.kernels.lattice.points import inverse_rows
from phy124.kernels.lattice.rows import Rows
from phy124.kernels.native import code

SIDEWAYS = 0.75
"""Largest distance along the surface between a point and the position that it touches [cells]."""
APART = wp.constant(3.0)
"""Distance at rest above which two points of a body belong to different parts [cells]."""
FACING = wp.constant(1.0)
"""Two points face each other if, at rest, each is this far in front of the other [cells]."""
NEARER = wp.constant(0.6)
"""Points of a body may touch if they are closer than this fraction of their distance at rest."""
BEYOND = wp.constant(0.05)
"""Distance beyond the edge of a flat side up to which a point may touch the side [cells]."""
OTHER = wp.constant(-0.2)
"""Smallest cosine between the normals of two points on the same side of a thin part."""
DEEPEST = wp.constant(0.5)
"""Largest depth of a point inside another body or part [cells]. Without this limit, contact of two
thin parts that lie on each other would push the outer side of each part through the other part,
which would create energy.
"""


@wp.func
def apart(side: wp.array(dtype=int), a: int, b: int):
    """Return whether two points belong to different pieces of a body, whose nodes were duplicated
    at the gap between the pieces.
    """
    return side[a] > 0 and side[b] > 0 and side[a] != side[b]


@wp.func
def may_meet(
    between: bool,
    dx: Any,
    rest: wp.array(dtype=Any),
    normal: wp.array(dtype=Any),
    body: wp.array(dtype=int),
    side: wp.array(dtype=int),
    a: int,
    b: int,
):
    """Return whether two points may touch: on different bodies, or on separate parts of a body."""
    if between:
        return body[a] != body[b]
    if apart(side, a, b):
        return True
    way = (rest[b] - rest[a]) / dx
    square = wp.dot(way, way)
    if square > type(dx)(APART) * type(dx)(APART):
        return True
    ahead = wp.min(wp.dot(way, normal[a]), -wp.dot(way, normal[b]))
    return ahead > type(dx)(FACING)


@wp.func
def touches(
    between: bool,
    far: Any,
    dx: Any,
    sample: Ints,
    x: wp.array(dtype=Any),
    rest: wp.array(dtype=Any),
    normal: wp.array(dtype=Any),
    body: Ints,
    side: Ints,
    i: int,
    j: int,
):
    """Return whether two sampled points are closer than `far`, and may touch.

    `x` contains the current positions of the samples.
    """
    way = x[j] - x[i]
    square = wp.dot(way, way)
    if i == j or square >= far * far:
        return False
    a, b = sample[i], sample[j]
    still = rest[b] - rest[a]
    nearer = type(dx)(NEARER)
    if between or square < nearer * nearer * wp.dot(still, still) or apart(side, a, b):
        return may_meet(between, dx, rest, normal, body, side, a, b)
    return False


@wp.func_native(code("partners:next"))
def next_near(
    places: wp.array2d(dtype=wp.float32), i: int, first: int, far: float, nearer: float, loose: bool
) -> int:
    """Return the next sampled surface point, from `first` on, that may touch sample i.

    The samples are closer than `far` and, unless `loose` is set, closer than `nearer` times their
    distance at rest.
    """
    ...


@build_once
def make_flag(real: Any):
    """Kernel over sampled surface points from `start` on: flags points near which contact is
    possible.

    `x` contains the current positions of the samples, sorted into `cells`.
    """

    @kernel(f"phy124_lattice_flag_{real.__name__}", real, seconds=0.5)
    def flag(
        start, cells, between, far, dx, sample, x, rest, normal, body: Ints, side, flagged_out
    ):
        i = start + wp.tid()
        near = int(0)
        query = wp.hash_grid_query(cells, x[i], far)
        j = int(0)
        while wp.hash_grid_query_next(query, j):
            if touches(between, far, dx, sample, x, rest, normal, body, side, i, j):
                near = 1
                break
        flagged_out[i] = near

    return flag


@build_once
def make_flag_simd():
    """Kernel over sampled surface points, equivalent to `make_flag`, for float32 on a CPU.

    For a duck on a lattice of 32 cells, with 1,100 samples, comparing all samples, sixteen at a
    time, is faster than a search in cells.
    """

    @kernel("phy124_lattice_flag_simd", wp.float32, seconds=0.4)
    def flag_simd(
        start, places, between, far, dx, sample, x, rest, normal, body: Ints, side, flagged_out
    ):
        i = start + wp.tid()
        near = int(0)
        loose = between or side[sample[i]] > 0
        j = next_near(places, i, 0, far, NEARER, loose)
        while near == 0 and j < sample.shape[0]:
            if touches(between, far, dx, sample, x, rest, normal, body, side, i, j):
                near = 1
            j = next_near(places, i, j + 1, far, NEARER, loose)
        flagged_out[i] = near

    return flag_simd


@build_once
def make_expose(real: Any, rows: Rows):
    """Kernel over `chosen` points from `start` on: computes positions, normals, cofactors of F."""
    moved_by = rows.moved_by

    @kernel(f"phy124_lattice_expose_{rows.name}{real.__name__}", real, seconds=0.5)
    def expose(
        start, chosen, nodes, weights, slopes, rest, normal, u, x_out, normal_out, turned_out, J_out
    ):
        i = start + wp.tid()
        s = chosen[i]
        x_out[i] = rest[s] + moved_by(u, nodes, weights, s)
        F = wp.identity(3, dtype=real)
        for k in range(wp.static(NODES)):
            F += wp.outer(u[nodes[s, k]], slopes[s, k])
        turned = inverse_rows(F)
        out = turned * normal[s]
        normal_out[i] = out / wp.max(wp.length(out), real(1.0e-30))
        turned_out[i] = turned
        J_out[i] = wp.determinant(F)

    return expose


@build_once
def make_partner(real: Any):
    """Kernel over `chosen` points from `start` on: finds the nearest opposite position.

    `x` and `turned` contain the current positions and normals of the points in `chosen`. If the
    other part is less even than the surface at the point, for example at its edge, the contact
    force is directed along the normal at the point.
    """
    t = types(real)

    @kernel(f"phy124_lattice_partner_{real.__name__}", real, seconds=0.6)
    def partner(
        start,
        cells,
        between,
        reach,
        dx,
        chosen,
        evenness: Ints,
        body: Ints,
        side,
        rest,
        normal,
        x,
        turned: t.vec3s,
        partner_out: Ints,
        direction_out: t.vec3s,
    ):
        i = start + wp.tid()
        a = chosen[i]
        here = x[i]
        zero = real(0.0)
        best = int(-1)
        least = reach
        query = wp.hash_grid_query(cells, here, reach)
        j = int(0)
        while wp.hash_grid_query_next(query, j):
            b = chosen[j]
            way = here - x[j]
            distance = wp.max(wp.length(way), real(1.0e-12) * dx)
            if distance <= least and may_meet(between, dx, rest, normal, body, side, a, b):
                n = way / distance
                plain = wp.dot(turned[j], turned[j]) > zero
                if plain:
                    n = turned[j]
                opposed = wp.dot(turned[i], n) < real(OTHER) or not (
                    wp.dot(turned[i], turned[i]) > zero
                )
                at_edge = evenness[a] > evenness[b] and plain
                if at_edge:
                    n = -turned[i]
                sideways = way - wp.dot(way, n) * n
                near = wp.length(sideways) < real(wp.static(SIDEWAYS)) * dx
                fits = opposed and near and wp.dot(way, n) > -real(DEEPEST) * dx
                if at_edge and wp.dot(sideways, turned[j]) >= real(BEYOND) * dx:
                    fits = False
                # The result must not depend on the order in which the grid lists points.
                if fits and (distance < least or best < 0 or j < best):
                    best = j
                    least = distance
                    direction_out[i] = n
        partner_out[i] = best

    return partner
