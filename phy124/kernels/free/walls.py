"""Computes the impulses of flat walls on a free body, and moves the body."""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles
from phy124.kernels.build import build_once, kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.free.numbers import (
    ANGULAR,
    GUESS,
    KICKED,
    LINEAR,
    PLACE,
    PRIOR,
    SYSTEM,
    TURN,
    TURNING,
    VELOCITY,
    WALLS,
    A,
    B,
    C,
    at3,
    at33,
    axes,
    inertia_of,
    put3,
    put_turn,
    spin_of,
    turn_after,
)

SWEEPS = wp.constant(24)
"""Number of Gauss-Seidel sweeps over the points."""


@wp.func
def arm_to(shape: int, point: int, R: wp.mat33d, half: wp.vec3d, n: wp.vec3d):
    """Return the vector [m] from a solid's centre to one of the points that a plane may touch.

    Args:
        shape: Number of points: 1 for a sphere, 2 for a capsule, 8 for a box.
        point: Index of the point.
        R: The body's axes as columns.
        half: Half of the solid's sides along the body's axes [m].
        n: Normal of the plane, out of the wall.
    """
    unit = wp.float64(1.0)
    if shape == 1:
        return -half[0] * n
    if shape == 2:
        least = wp.min(half)
        along = R @ (half - wp.vec3d(least, least, least))
        return wp.where(point == 0, unit, -unit) * along - least * n
    signs = wp.vec3d(
        wp.where((point & 1) == 0, -unit, unit),
        wp.where((point & 2) == 0, -unit, unit),
        wp.where((point & 4) == 0, -unit, unit),
    )
    return R @ wp.cw_mul(signs, half)


@wp.func
def turn_by(a: wp.mat33d, b: wp.mat33d, c: wp.mat33d, r: wp.vec3d, J: wp.vec3d):
    """Return the change of a free body's angular velocity due to an impulse J at the point r.

    a, b and c are blocks of the inverse matrix of the six equations.
    """
    return c @ (wp.cross(r, J) - wp.transpose(b) @ (a @ J))


@wp.func
def yielding(a: wp.mat33d, b: wp.mat33d, c: wp.mat33d, r: wp.vec3d, way: wp.vec3d):
    """Return the velocity change along `way`, at r, due to an impulse of 1 N s along `way`."""
    turn = turn_by(a, b, c, r, way)
    return wp.dot(way, a @ (way - b @ turn) + wp.cross(turn, r))


@wp.func
def within_cone(J: wp.vec3d, push: wp.float64, n: wp.vec3d, friction: wp.float64):
    """Return `push` along n plus the tangential part of J, limited by friction [N s]."""
    grip = J - wp.dot(J, n) * n
    most = friction * push
    if wp.length(grip) > most:
        grip *= most / wp.length(grip)
    return push * n + grip


@build_once
def make_walls(drifts: bool, real: Any):
    """Single-thread kernel: solves a free body's equations of motion with the impulses of flat
    walls.

    Each of the `planes` has a point and an outward normal, and may act at `points` of the body (see
    `arm_to`). The variant with `drifts` ends a substep: first the walls stop the body, then the
    body moves with constant angular momentum L. For the rotation, the angular velocity is computed
    from L and the orientation after half of the rotation. If a rotating corner enters a wall, the
    body is moved out of the wall.
    """
    name = f"phy124_free_{'drift' if drifts else 'solve'}_{real.__name__}"

    @kernel(name, real, seconds=0.8)
    def walls(
        mass: wp.float64,
        moments,
        half: wp.vec3d,
        points: int,
        planes: wp.array2d(dtype=wp.vec3d),
        frictions: Doubles,
        slots,
        clock,
        values,
        rates,
        impulses_out,
        system_out,
        trial_out,
        body_out,
    ):
        zero = wp.float64(0.0)
        R = axes(body_out)
        inertia = inertia_of(R, moments)
        dt = wp.float64(clock[1])
        if wp.static(drifts):
            if body_out[KICKED] == zero:
                pull = wp.float64(clock[0]) * wide(values[0])
                put3(body_out, VELOCITY, at3(body_out, VELOCITY) + pull)
        L = at3(body_out, ANGULAR)
        a = wp.inverse(mass * wp.identity(n=3, dtype=wp.float64) + at33(system_out, A))
        b = at33(system_out, B)
        c = wp.inverse(inertia + at33(system_out, C) - wp.transpose(b) @ a @ b)
        p = mass * at3(body_out, VELOCITY) + at3(system_out, LINEAR)
        w = c @ (L + at3(system_out, TURNING) - wp.transpose(b) @ (a @ p))
        V = a @ (p - b @ w)

        for n in range(impulses_out.shape[0]):
            impulses_out[n] = wp.vec3d()
        for _ in range(SWEEPS):
            for wall in range(planes.shape[0]):
                normal = planes[wall, 1]
                speed = wp.vec3d()
                shift = wp.vec3d()
                if slots[wall] >= 0:
                    shift = wide(values[slots[wall]])
                    speed = wide(rates[slots[wall]])
                for point in range(points):
                    n = wall * points + point
                    r = arm_to(points, point, R, half, normal)
                    gap = wp.dot(at3(body_out, PLACE) + r - planes[wall, 0] - shift, normal)
                    u = V + wp.cross(w, r) - speed
                    J = impulses_out[n]
                    pressed = wp.dot(J, normal)
                    lacking = -wp.max(gap, zero) / dt - wp.dot(u, normal)
                    if lacking > zero or pressed > zero:
                        # With the impulses at the other points fixed, solve along the normal first,
                        # then tangentially.
                        push = pressed + lacking / yielding(a, b, c, r, normal)
                        along = u - wp.dot(u, normal) * normal
                        slip = wp.length(along)
                        wanted = J
                        if slip > wp.float64(1e-12):
                            wanted -= along / yielding(a, b, c, r, along / slip)
                        push = wp.max(push, zero)
                        now = within_cone(wanted, push, normal, frictions[wall])
                        more = now - J
                        impulses_out[n] = now
                        turn = turn_by(a, b, c, r, more)
                        w += turn
                        V += a @ (more - b @ turn)
        impulse = wp.vec3d()
        moment = wp.vec3d()
        for wall in range(planes.shape[0]):
            for point in range(points):
                J = impulses_out[wall * points + point]
                impulse += J
                r = arm_to(points, point, R, half, planes[wall, 1])
                moment += wp.cross(r, J)

        if wp.static(drifts):
            V = at3(body_out, VELOCITY) + impulse / mass
            L += moment
            put3(body_out, VELOCITY, V)
            put3(body_out, ANGULAR, L)
            X = at3(body_out, PLACE) + dt * V
            start = wp.quatd(
                body_out[TURN + 1], body_out[TURN + 2], body_out[TURN + 3], body_out[TURN]
            )
            put_turn(body_out, turn_after(body_out, spin_of(R, moments, L), dt / wp.float64(2.0)))
            w = spin_of(axes(body_out), moments, L)
            put_turn(body_out, start)
            put_turn(body_out, turn_after(body_out, w, dt))
            R = axes(body_out)
            for wall in range(planes.shape[0]):
                normal = planes[wall, 1]
                shift = wp.vec3d()
                if slots[wall] >= 0:
                    shift = wide(values[slots[wall]]) + dt * wide(rates[slots[wall]])
                deepest = wp.float64(0.0)
                for point in range(points):
                    r = arm_to(points, point, R, half, normal)
                    gap = wp.dot(X + r - planes[wall, 0] - shift, normal)
                    deepest = wp.min(deepest, gap)
                X -= deepest * normal
            put3(body_out, PLACE, X)
            body_out[KICKED] = zero
        else:
            for n in range(6):
                trial_out[PRIOR + n] = trial_out[GUESS + n]
            for n in range(wp.static(SYSTEM)):
                system_out[n] = zero
            put3(trial_out, GUESS, V)
            put3(trial_out, GUESS + 3, w)
            put3(trial_out, WALLS, impulse)
            put3(trial_out, WALLS + 3, moment)

    return walls
