"""Contact of surface points with a wall, by impulses on the nodes.

A point at signed distance g from the wall must not approach the wall faster than g / dt. A pressed
point that has penetrated the wall moves out at the speed -`restore` g, where `restore` is a rate
[1/s]. Projected Gauss-Seidel corrects the impulses of the last substep. An impulse J on a point
changes the velocities of the point's nodes by w_i J / m_i, and the velocity of the point by (sum
w_i^2 / m_i) J.

A sweep over all points, forwards and then backwards, is a symmetric positive operator E on the
velocities. With C = E^-1 - 1, the impulses of the last substep equal the impulses of implicitly
integrated springs C / dt^2. The equation (1 + C) v' = v - (K + C) x is stable for every stiffness K
that is stable without walls. A sweep in one direction only is not symmetric, and excites
vibrations.

`restore` is the gain of an integral controller. A gain above omega^2 dt would excite the body's
slowest vibration (angular frequency omega). If the gain were larger for shorter substeps, a body
that is squeezed hard would be thrown out.

The result of Gauss-Seidel depends on the order of the points, so these kernels use a single thread.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import xyz
from phy124.kernels.contacts import MOMENT as PAIR_MOMENT
from phy124.kernels.diagnostics import add3, wide
from phy124.kernels.distance import SHAPES
from phy124.kernels.lattice.responses import LIMITS, RELAXED, correct, there_and_back
from phy124.kernels.lattice.rows import Rows
from phy124.kernels.work import EXCHANGE, add_exchange

LOOSE = wp.constant(0.5)
"""Walls act on a point only if clamps leave at least this fraction of the point's mobility. For a
pair of points of two bodies, one of the points must keep this fraction.
"""
NODES = 27
"""Largest number of nodes that carry a surface point."""
SWEEPS = 16
"""Largest number of sweeps over all points, forwards and backwards."""
MOMENT, DRIVEN, SUMS = EXCHANGE, EXCHANGE + 3, 16
"""Indices in the sums of each wall, after the sums of phy124/kernels/work.py: the moment of all
impulses about the origin [N m s], and the work by a clamp's motion [J].
"""


@build_once
def make_touch(shape: str, real: Any, rows: Rows):
    """Single-thread kernel: finds the points near a wall, and applies the last substep's impulses.

    `inverse` is the inverse mass, or zero for nodes in a clamp. `force_out` contains the mean force
    on each point in the last substep [N], and is set to zero for a point that has left the wall.
    Contact with a point begins at the distance `space_out` from the wall. This value is -inf until
    the point is near the wall for the first time. If the point is inside the wall at that time, or
    enters the wall without contact, contact begins at the point's depth, because moving the point
    out would create energy. `gap_out` is the normal and the distance of each point near the wall;
    the distance of other points is infinite.
    """
    t = types(real)
    moved_by, strike = rows.moved_by, rows.strike
    distance = SHAPES[shape]

    @kernel(f"phy124_lattice_touch_{shape}_{rows.name}{real.__name__}", real, seconds=0.6)
    def touch(
        near,
        count,
        reach,
        geometry,
        slot,
        nodes,
        weights,
        rest,
        inverse,
        yields,
        u,
        clock,
        values,
        space_out: t.reals,
        v_out,
        gap_out,
        place_out,
        force_out,
    ):
        moved = xyz(values[slot])
        active = values[slot][3]
        for a in range(count):
            s = near[a]
            y = rest[s] + moved_by(u, nodes, weights, s)
            d = distance(y - moved, geometry)
            if wp.isinf(space_out[s]):
                space_out[s] = wp.min(d[3], real(0.0))
            gap = d[3] - space_out[s]
            place_out[s] = y
            if active > real(0.0) and gap < reach and yields[s] > real(0.0):
                gap_out[s] = wp.vector(d[0], d[1], d[2], gap)
                impulse = clock[0] * force_out[s]
                if wp.dot(impulse, impulse) > real(0.0):
                    strike(v_out, inverse, nodes, weights, s, impulse)
            else:
                gap_out[s] = wp.vector(d[0], d[1], d[2], real(wp.inf))
                force_out[s] = t.vec3()
                if gap >= reach or d[3] < real(0.0):
                    space_out[s] = wp.min(d[3], real(0.0))

    return touch


@build_once
def make_yields(real: Any, rows: Rows):
    """Kernel over points near a wall: computes each point's velocity change per impulse [1/kg].

    The change is set to zero if a clamp fixes nearly all nodes of a point (`inverse` is zero, but
    `whole` is not). Otherwise, an impulse would accelerate the few other nodes too much.
    """
    yielding = rows.yielding

    @kernel(f"phy124_lattice_yields_{rows.name}{real.__name__}", real, seconds=0.3)
    def lattice_yields(near, nodes, weights, inverse, whole, yields_out):
        s = near[wp.tid()]
        yields = yielding(inverse, nodes, weights, s)
        if yields > real(LOOSE) * yielding(whole, nodes, weights, s):
            yields_out[s] = yields
        else:
            yields_out[s] = real(0.0)

    return lattice_yields


@build_once
def make_resist(response: str, real: Any, rows: Rows):
    """Single-thread kernel: forward and backward Gauss-Seidel sweeps over points near a wall.

    Further sweeps follow if the wall holds points in both directions, or if a point is deeper than
    `deep`. One sweep balances a change of the load only in part, so points would drift into the
    wall. The sweeps end when no correction displaces a point by more than `exact`.

    The wall's velocity is the rate of the track `slot`. Pairs of points use slot 0, whose rate is
    zero. `response` is "separate" (points may leave; friction acts), "slip" (points may not leave;
    no friction) or "sticky".
    """
    moved_by, strike, limit = rows.moved_by, rows.strike, LIMITS[response]
    leaves = response == "separate"

    @kernel(f"phy124_lattice_resist_{response}_{rows.name}{real.__name__}", real, seconds=0.6)
    def resist(
        near,
        count,
        restore,
        friction,
        deep,
        exact,
        slot,
        nodes,
        weights,
        inverse,
        gap,
        yields,
        clock,
        rates,
        v_out,
        force_out,
    ):
        wall = xyz(rates[slot])
        zero = real(0.0)
        farthest = zero
        lowest = zero
        for b in range(wp.static(SWEEPS) * 2 * count):
            step = b % (2 * count)
            if step == 0:
                if b > 0 and (farthest < exact or (wp.static(leaves) and lowest > -deep)):
                    break
                farthest = zero
            s = near[there_and_back(step, count)]
            g = gap[s]
            if not wp.isinf(g[3]) and yields[s] > zero and clock[0] > zero:
                lowest = wp.min(lowest, g[3])
                relative = moved_by(v_out, nodes, weights, s) - wall
                last = clock[0] * force_out[s]
                part = real(RELAXED) / yields[s]
                press, pressed, drag = correct(relative, last, g, part, restore, clock)
                impulse = limit(press, pressed, drag, xyz(g), g[3], friction)
                change = impulse - last
                force_out[s] = impulse / clock[0]
                if wp.dot(change, change) > zero:
                    strike(v_out, inverse, nodes, weights, s, change)
                    farthest = wp.max(farthest, yields[s] * wp.length(change) * clock[1])

    return resist


@wp.func
def mostly_held(
    inverse: wp.array(dtype=Any),
    whole: wp.array(dtype=Any),
    nodes: wp.array2d(dtype=int),
    weights: wp.array2d(dtype=Any),
    s: int,
    first: int,
):
    """Return whether clamps fix most nodes of a surface point; `first` is the column of its first
    node.
    """
    free = weights[s, first] * weights[s, first] * inverse[nodes[s, first]]
    total = weights[s, first] * weights[s, first] * whole[nodes[s, first]]
    for k in range(first + 1, first + wp.static(NODES)):
        w = weights[s, k] * weights[s, k]
        free += w * inverse[nodes[s, k]]
        total += w * whole[nodes[s, k]]
    return free <= type(free)(LOOSE) * total


@build_once
def make_meet(real: Any, rows: Rows):
    """Single-thread kernel: computes the gaps between points of two bodies, as `make_touch` does.

    The weights of a pair are the weights of the point minus the weights of the opposite position,
    so a pair is treated like a single point. `rest_out` plus the weighted displacements of the
    nodes is the vector from the opposite position to the point. The opposite position follows the
    point along the surface, so that the pair's impulses have no moment. `back` maps this motion to
    the body at rest. `slopes` contains the gradients of the weights, from which the new weights
    follow. A pair is ignored if the opposite position moves farther than `far`, or if the gap
    exceeds `reach`.

    For nodes in a clamp, `inverse` is zero, but `whole` is not. A pair of points of one body
    (`between` is 0) is ignored if a node of the pair is in a clamp, because the clamp's sums would
    lack the impulses of the pair. A pair of two bodies is ignored if clamps fix most nodes of both
    points.
    """
    t = types(real)
    moved_by, yielding, strike = rows.moved_by, rows.yielding, rows.strike

    @kernel(f"phy124_lattice_meet_{rows.name}{real.__name__}", real, seconds=0.5)
    def meet(
        count,
        far,
        reach,
        between: int,
        nodes,
        normal,
        slopes,
        back: wp.array(dtype=t.mat33),
        inverse,
        whole,
        u,
        clock,
        weights_out: wp.array2d(dtype=real),
        rest_out: t.vec3s,
        shift_out: t.vec3s,
        v_out,
        gap_out,
        yields_out,
        force_out,
    ):
        for s in range(count):
            n = normal[s]
            way = rest_out[s] + moved_by(u, nodes, weights_out, s)
            gap = wp.dot(way, n)
            step = back[s] * (way - gap * n)
            shift = shift_out[s] + step
            if gap < reach and wp.dot(shift, shift) < far * far:
                shift_out[s] = shift
                rest_out[s] = rest_out[s] - step
                for k in range(wp.static(NODES)):
                    place = wp.static(NODES) + k
                    weights_out[s, place] = weights_out[s, place] - wp.dot(slopes[s, k], step)
                gap_out[s] = wp.vector(n[0], n[1], n[2], gap)
                yields_out[s] = yielding(inverse, nodes, weights_out, s)
                if yields_out[s] < yielding(whole, nodes, weights_out, s):
                    stuck = bool(between == 0)
                    if not stuck and mostly_held(inverse, whole, nodes, weights_out, s, 0):
                        other = wp.static(NODES)
                        stuck = mostly_held(inverse, whole, nodes, weights_out, s, other)
                    if stuck:
                        yields_out[s] = real(0.0)
                        force_out[s] = t.vec3()
                impulse = clock[0] * force_out[s]
                if wp.dot(impulse, impulse) > real(0.0):
                    strike(v_out, inverse, nodes, weights_out, s, impulse)
            else:
                gap_out[s] = wp.vector(n[0], n[1], n[2], real(wp.inf))
                force_out[s] = t.vec3()

    return meet


@build_once
def make_exchange(real: Any):
    """Single-thread kernel: adds impulses and moments between points of two bodies to sums.

    `sign` is 1 if the points belong to the body on which the summed impulse acts, and -1 otherwise.
    """
    t = types(real)

    @kernel(f"phy124_lattice_exchange_{real.__name__}", real, seconds=0.3)
    def exchange(count, sign: t.reals, nodes, weights, rest, u, force, clock, sums_out):
        for s in range(count):
            impulse = wide((sign[s] * clock[0]) * force[s])
            if wp.dot(impulse, impulse) > wp.float64(0.0):
                place = t.vec3()
                for k in range(wp.static(NODES)):
                    n = nodes[s, k]
                    place += weights[s, k] * (rest[n] + u[n])
                add3(sums_out, 0, impulse)
                add3(sums_out, wp.static(PAIR_MOMENT), wp.cross(wide(place), impulse))

    return exchange


@build_once
def make_place(real: Any, rows: Rows):
    """Kernel over selected surface points: computes their positions."""
    moved_by = rows.moved_by

    @kernel(f"phy124_lattice_place_{rows.name}{real.__name__}", real, seconds=0.3)
    def lattice_place(chosen, nodes, weights, rest, u, x_out):
        s = chosen[wp.tid()]
        x_out[wp.tid()] = rest[s] + moved_by(u, nodes, weights, s)

    return lattice_place


@build_once
def make_account(real: Any, rows: Rows):
    """Kernel over the points near a wall: adds impulse, moment and work to the wall's sums.

    The work is the impulse times the mean of the velocities before the kick and after the substep.
    The work of all impulses then equals the change of the kinetic energy exactly. The mean of the
    velocities before and after the contact would include work of the stress.
    """
    moved_by = rows.moved_by

    @kernel(f"phy124_lattice_account_{rows.name}{real.__name__}", real, seconds=0.4)
    def account(near, nodes, weights, place, force, clock, v_before, v, sums_out):
        s = near[wp.tid()]
        impulse = wide(clock[0] * force[s])
        if wp.dot(impulse, impulse) > wp.float64(0.0):
            before = moved_by(v_before, nodes, weights, s)
            after = moved_by(v, nodes, weights, s)
            work = wp.float64(0.5) * wp.dot(impulse, wide(before) + wide(after))
            add_exchange(sums_out, impulse, work, wp.length(impulse), wp.abs(work))
            add3(sums_out, wp.static(MOMENT), wp.cross(wide(place[s]), impulse))

    return account


@build_once
def make_reach(shape: str, real: Any, rows: Rows):
    """Kernel over the surface points from `start` on: computes the distances from a wall."""
    t = types(real)
    moved_by = rows.moved_by
    distance = SHAPES[shape]

    @kernel(f"phy124_lattice_reach_{shape}_{rows.name}{real.__name__}", real, seconds=0.4)
    def lattice_reach(start, geometry, slot, nodes, weights, rest, u, values, gap_out: t.reals):
        s = start + wp.tid()
        y = rest[s] + moved_by(u, nodes, weights, s)
        d = distance(y - xyz(values[slot]), geometry)
        gap_out[s] = d[3]

    return lattice_reach


@build_once
def make_distances(shape: str, real: Any):
    """Kernel over points: computes normals of a shape, and signed distances from the shape [m]."""
    t = types(real)
    distance = SHAPES[shape]

    @kernel(f"phy124_lattice_distances_{shape}_{real.__name__}", real, seconds=0.2)
    def distances(geometry, points: t.vec3s, distance_out: t.vec4s):
        distance_out[wp.tid()] = distance(points[wp.tid()], geometry)

    return distances
