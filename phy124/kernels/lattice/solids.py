"""Contact of surface points with a freely moving rigid solid, by impulses on both.

The impulses are computed as in phy124/kernels/lattice/contact.py. An impulse J at r from the
solid's centre changes the solid's velocity by -J / m and the angular velocity by -I^-1 (r x J). The
arrays of the solid have the layout of phy124/kernels/free/numbers.py. `trial` contains the motion
of the solid under the last substep's impulses of flat walls, so that contact takes the support by
these walls into account.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.columns import xyz
from phy124.kernels.diagnostics import wide
from phy124.kernels.distance import SHAPES
from phy124.kernels.free.numbers import (
    ANGULAR,
    GUESS,
    KICKED,
    PLACE,
    PRIOR,
    VELOCITY,
    at3,
    axes,
    inertia_of,
    moving,
    put3,
    spin_of,
)
from phy124.kernels.free.walls import arm_to
from phy124.kernels.lattice.responses import LIMITS, RELAXED, largest_approach, there_and_back
from phy124.kernels.lattice.rows import Rows

ALIGNED = wp.constant(0.9)
"""A box and a point are in contact only if the cosine between the box's normal and the point's
reversed normal is at least this.
"""


@build_once
def make_solid_begin(real: Any):
    """Single-thread kernel: applies gravity; predicts a solid's motion with the walls' last
    impulses.

    `impulses` contains each wall's impulse at each of the solid's `points`.
    """

    @kernel(f"phy124_lattice_solid_begin_{real.__name__}", real, seconds=0.4)
    def solid_begin(
        mass: wp.float64,
        moments,
        half: wp.vec3d,
        points: int,
        planes: wp.array2d(dtype=wp.vec3d),
        impulses,
        clock,
        values,
        body_out,
        trial_out,
    ):
        put3(body_out, VELOCITY, at3(body_out, VELOCITY) + wp.float64(clock[0]) * wide(values[0]))
        body_out[KICKED] = wp.float64(1.0)
        R = axes(body_out)
        V = at3(body_out, VELOCITY)
        L = at3(body_out, ANGULAR)
        for n in range(impulses.shape[0]):
            r = arm_to(points, n % points, R, half, planes[n / points, 1])
            V += impulses[n] / mass
            L += wp.cross(r, impulses[n])
        w = spin_of(R, moments, L)
        put3(trial_out, GUESS, V)
        put3(trial_out, GUESS + 3, w)
        put3(trial_out, PRIOR, V)
        put3(trial_out, PRIOR + 3, w)

    return solid_begin


@build_once
def make_solid_finish(real: Any):
    """Single-thread kernel: changes the motion of a solid by the impulses of all points."""

    @kernel(f"phy124_lattice_solid_finish_{real.__name__}", real, seconds=0.3)
    def solid_finish(moments, trial, body_out):
        inertia = inertia_of(axes(body_out), moments)
        turned = inertia @ (at3(trial, GUESS + 3) - at3(trial, PRIOR + 3))
        gained = at3(trial, GUESS) - at3(trial, PRIOR)
        put3(body_out, VELOCITY, at3(body_out, VELOCITY) + gained)
        put3(body_out, ANGULAR, at3(body_out, ANGULAR) + turned)

    return solid_finish


@wp.func
def react(
    trial: wp.array(dtype=wp.float64),
    mass: wp.float64,
    turning: wp.mat33d,
    r: wp.vec3d,
    impulse: wp.vec3d,
):
    """Apply the opposite of an impulse to a solid, at the position r relative to its centre."""
    put3(trial, GUESS, at3(trial, GUESS) - impulse / mass)
    put3(trial, GUESS + 3, at3(trial, GUESS + 3) - turning @ wp.cross(r, impulse))


@wp.func
def solid_yields(mass: wp.float64, turning: wp.mat33d, r: wp.vec3d, way: wp.vec3d):
    """Return the velocity change along `way`, at r, due to an impulse of 1 N s along `way`."""
    arm = wp.cross(r, way)
    return wp.float64(1.0) / mass + wp.dot(arm, turning @ arm)


@wp.func
def turning_of(body: wp.array(dtype=wp.float64), moments: wp.vec3d):
    """Return the inverse of a solid's inertia tensor."""
    return wp.inverse(inertia_of(axes(body), moments))


@build_once
def make_solid_near(shape: str, real: Any, rows: Rows):
    """Kernel over surface points: computes the distance of each point from a solid."""
    t, moved_by = types(real), rows.moved_by
    distance = SHAPES[shape]

    @kernel(f"phy124_lattice_solid_near_{shape}_{rows.name}{real.__name__}", real, seconds=0.4)
    def solid_near(geometry, nodes, weights, rest, u, body, gap_out: t.reals):
        s = wp.tid()
        y = wide(rest[s] + moved_by(u, nodes, weights, s))
        d = distance(t.vec3(wp.transpose(axes(body)) @ (y - at3(body, PLACE))), geometry)
        gap_out[s] = d[3]

    return solid_near


@wp.func
def way_out(p: Any, half: Any, m: Any):
    """Return the distance along m from a point to the surface of a box around the origin."""
    way = type(half[0])(wp.inf)
    for c in range(3):
        if wp.abs(m[c]) > type(half[0])(1.0e-6):
            way = wp.min(way, (wp.sign(m[c]) * half[c] - p[c]) / m[c])
    return way


@build_once
def make_solid_touch(shape: str, real: Any, rows: Rows):
    """Single-thread kernel: finds the points near a solid, and applies the last substep's impulses.

    For each listed point, `gap_out` receives the normal of the solid and the distance from the
    solid (infinite if out of reach). If a flat body touches an edge of a box, the normal of the
    body (`side`) is used. The normal of the box changes direction across the edge, so it would stop
    a sliding box. `space_out` is computed as in `make_touch`.
    """
    t = types(real)
    moved_by, yielding, strike = rows.moved_by, rows.yielding, rows.strike
    distance = SHAPES[shape]

    @kernel(f"phy124_lattice_solid_touch_{shape}_{rows.name}{real.__name__}", real, seconds=0.6)
    def solid_touch(
        near,
        count,
        reach,
        deepest: real,
        geometry,
        mass: wp.float64,
        moments,
        nodes,
        weights,
        rest,
        side: t.vec3s,
        inverse,
        u,
        clock,
        body,
        space_out: t.reals,
        trial_out,
        v_out,
        gap_out,
        place_out,
        yields_out,
        force_out,
    ):
        R = axes(body)
        turning = turning_of(body, moments)
        for a in range(count):
            s = near[a]
            y = rest[s] + moved_by(u, nodes, weights, s)
            r = wide(y) - at3(body, PLACE)
            local = t.vec3(wp.transpose(R) @ r)
            d = distance(local, geometry)
            n = t.vec3(R @ wide(xyz(d)))
            far = d[3]
            if wp.static(shape == "box"):
                facing = -side[s]
                if far >= real(0.0):
                    if wp.length(facing) > real(0.0) and wp.dot(facing, n) < real(ALIGNED):
                        far = real(wp.inf)
                elif wp.length(facing) > real(0.0):
                    half = wp.vector(geometry[1, 0], geometry[1, 1], geometry[1, 2])
                    way = way_out(local, half, t.vec3(wp.transpose(R) @ wide(facing)))
                    if way < deepest:
                        n = facing
                        far = -way
            if wp.isinf(space_out[s]):
                space_out[s] = wp.min(far, real(0.0))
            gap = far - space_out[s]
            place_out[s] = y
            yields_out[s] = yielding(inverse, nodes, weights, s)
            if gap < reach and yields_out[s] > real(0.0):
                gap_out[s] = wp.vector(n[0], n[1], n[2], gap)
                impulse = clock[0] * force_out[s]
                if wp.dot(impulse, impulse) > real(0.0):
                    strike(v_out, inverse, nodes, weights, s, impulse)
                    react(trial_out, mass, turning, r, wide(impulse))
            else:
                gap_out[s] = wp.vector(n[0], n[1], n[2], real(wp.inf))
                force_out[s] = t.vec3()
                if gap >= reach or far < real(0.0):
                    space_out[s] = wp.min(far, real(0.0))

    return solid_touch


@build_once
def make_solid_resist(sticky: bool, real: Any, rows: Rows):
    """Single-thread kernel: a forward and a backward Gauss-Seidel sweep over points and solid."""
    t = types(real)
    moved_by, strike = rows.moved_by, rows.strike
    kind = "sticky" if sticky else "separate"
    limit = LIMITS[kind]

    @kernel(f"phy124_lattice_solid_resist_{kind}_{rows.name}{real.__name__}", real, seconds=0.6)
    def solid_resist(
        near,
        count,
        restore,
        friction,
        mass: wp.float64,
        moments,
        nodes,
        weights,
        inverse,
        gap,
        place,
        yields,
        clock,
        body,
        trial_out,
        v_out,
        force_out,
    ):
        turning = turning_of(body, moments)
        zero = real(0.0)
        for b in range(2 * count):
            s = near[there_and_back(b, count)]
            g = gap[s]
            if not wp.isinf(g[3]) and clock[0] > zero:
                n = xyz(g)
                r = wide(place[s]) - at3(body, PLACE)
                surface = t.vec3(moving(trial_out, GUESS, r))
                relative = moved_by(v_out, nodes, weights, s) - surface
                last = clock[0] * force_out[s]
                speed = wp.dot(relative, n)
                along = relative - speed * n
                pressed = wp.dot(last, n)
                bias = largest_approach(g[3], pressed, restore, clock)
                whole = yields[s] + real(solid_yields(mass, turning, r, wide(n)))
                press = pressed - real(RELAXED) / whole * (speed + bias)
                drag = last - pressed * n
                slip = wp.length(along)
                if slip > zero:
                    way = along / slip
                    whole = yields[s] + real(solid_yields(mass, turning, r, wide(way)))
                    drag -= real(RELAXED) / whole * along
                impulse = limit(press, pressed, drag, n, g[3], friction)
                change = impulse - last
                force_out[s] = impulse / clock[0]
                if wp.dot(change, change) > zero:
                    strike(v_out, inverse, nodes, weights, s, change)
                    react(trial_out, mass, turning, r, wide(change))

    return solid_resist
