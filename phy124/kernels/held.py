"""Forces on a part of the body as a whole: a point that is drawn along, and a wrench.

A part is a list of particles with weights w from 0 to 1. Its centre X is the mean of their places
weighted by w m, and V that of their velocities, so it turns and deforms freely about X. A force f
gives each particle w f / sum(w m), which adds up to f whatever the weights are.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import kernel

PLACE, SPEED = 0, 1
"""Where X and V stand among the means."""
FLAT = wp.constant(wp.float64(1e-6))
"""Fraction of the largest moment of inertia below which one counts as zero: a line of particles."""


@wp.func
def spring_damper(gap: wp.vec3d, slip: wp.vec3d, spring: wp.vec4d, kick: wp.float64):
    """Force [N] at the end of a kick, by implicit Euler, so that no stiffness is too large.

    `spring` is stiffness [N/m], damping [N s/m], the mass that is drawn [kg] and the largest
    force [N]; `gap` and `slip` are what is missing to the target's place and velocity.
    """
    drag = spring[1] + kick * spring[0]
    f = (spring[0] * gap + drag * slip) / (wp.float64(1.0) + kick * drag / spring[2])
    size = wp.length(f)
    if size > spring[3]:
        f = f * (spring[3] / size)
    return f


@wp.func
def angular_acceleration(torque: wp.vec3d, mass: wp.float64, second: wp.mat33d):
    """Of a rigid part [rad/s^2], whose moments about its centre are mass times `second` [m^2]."""
    spread = wp.trace(second)
    inertia = wp.diag(wp.vec3d(spread, spread, spread)) - second
    inertia = inertia + FLAT * wp.diag(wp.vec3d(spread, spread, spread))
    if spread <= wp.float64(0.0):
        return wp.vec3d()
    return wp.inverse(inertia) * torque / mass


@kernel("phy124_held_forget")
def forget(
    means_out: wp.array(dtype=wp.vec3d),
    second_out: wp.array(dtype=wp.mat33d),
):
    """The means of a part become zero."""
    for i in range(2):
        means_out[i] = wp.vec3d()
    second_out[0] = wp.mat33d()


@cache
def make_centre(real: Any):
    """Kernel: X and V of a part, while its track is active."""

    @kernel(f"phy124_held_centre_{real.__name__}", real)
    def centre(first, each, stride, chosen, share: Doubles, slot, values, x, v, means_out):
        if values[slot][3] > real(0.0):
            place = wp.vec3d()
            speed = wp.vec3d()
            for k in range(each):
                i = wp.tid() * first + k * stride
                if i < chosen.shape[0]:
                    p = chosen[i]
                    place += share[i] * wp.vec3d(x[p])
                    speed += share[i] * wp.vec3d(v[p])
            wp.atomic_add(means_out, PLACE, place)
            wp.atomic_add(means_out, SPEED, speed)

    return centre


@cache
def make_second(real: Any):
    """Kernel: the second moments of a part about X, divided by its mass [m^2]."""

    @kernel(f"phy124_held_second_{real.__name__}", real)
    def second(first, each, stride, chosen, share: Doubles, slot, values, x, means, second_out):
        if values[slot][3] > real(0.0):
            total = wp.mat33d()
            for k in range(each):
                i = wp.tid() * first + k * stride
                if i < chosen.shape[0]:
                    r = wp.vec3d(x[chosen[i]]) - means[PLACE]
                    total += share[i] * wp.outer(r, r)
            wp.atomic_add(second_out, 0, total)

    return second


@cache
def make_draw(real: Any):
    """Kernel: a spring and a damper draw X to a target that moves."""
    t = types(real)

    @kernel(f"phy124_held_draw_{real.__name__}", real)
    def draw(
        chosen, per_force: t.reals, spring: wp.vec4d, slot, clock, values, rates, means, v_out
    ):
        target = values[slot]
        if target[3] > real(0.0):
            i = wp.tid()
            gap = wp.vec3d(wp.vector(target[0], target[1], target[2])) - means[PLACE]
            rate = wp.vec3d(wp.vector(rates[slot][0], rates[slot][1], rates[slot][2]))
            f = spring_damper(gap, rate - means[SPEED], spring, wp.float64(clock[0]))
            p = chosen[i]
            v_out[p] = v_out[p] + clock[0] * per_force[i] * t.vec3(f)

    return draw


@cache
def make_wrench(real: Any):
    """Kernel: a force at X, and a torque about it as if the part were rigid."""
    t = types(real)

    @kernel(f"phy124_held_wrench_{real.__name__}", real)
    def wrench(
        chosen,
        per_force: t.reals,
        mass: wp.float64,
        push: int,
        turn: int,
        clock,
        values,
        x,
        means,
        second,
        v_out,
    ):
        i = wp.tid()
        p = chosen[i]
        f = values[push]
        dv = per_force[i] * wp.vector(f[0], f[1], f[2])
        if values[turn][3] > real(0.0):
            torque = wp.vec3d(wp.vector(values[turn][0], values[turn][1], values[turn][2]))
            spin = angular_acceleration(torque, mass, second[0])
            arm = wp.vec3d(x[p]) - means[PLACE]
            weight = wp.float64(per_force[i]) * mass
            dv += t.vec3(weight * wp.cross(spin, arm))
        v_out[p] = v_out[p] + clock[0] * dv

    return wrench
