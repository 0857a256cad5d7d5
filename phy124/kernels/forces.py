"""Forces on particles before the scatter: accelerations, wrenches, pulls, and a force for tests.

The kick is the time step of velocities [s], and `chosen` the particles on which a force acts. The
track `slot` is the force's strength, averaged over the kick and zero while the force does not act.

A pull or a wrench acts on a group of particles with weights w from 0 to 1. The group's centre X and
velocity V are means weighted by w m. A force f gives each particle the acceleration w f / sum(w m),
so the total force is f.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import build_once, kernel


@build_once
def make_accelerate(real: Any, per_mass: bool):
    """Kernel: adds kick * a to v or, if `per_mass` is set, kick * f / m (as in PhysGaussian)."""
    name = f"phy124_accelerate_{'force' if per_mass else 'field'}_{real.__name__}"

    @kernel(name, real)
    def accelerate(chosen, slot, mass, clock, values, v_out):
        p = chosen[wp.tid()]
        a = values[slot]
        scale = clock[0]
        if wp.static(per_mass):
            scale = scale / mass[p]
        v_out[p] = v_out[p] + scale * wp.vector(a[0], a[1], a[2])

    return accelerate


@build_once
def make_zone(real: Any):
    """Kernel: adds kick * a to v for the particles that are currently inside a box.

    If `axis` is 0, 1 or 2, particles farther than `radius` from the box's central line along this
    axis are excluded.
    """
    t = types(real)

    @kernel(f"phy124_zone_{real.__name__}", real)
    def zone(lower: t.vec3, upper: t.vec3, axis: int, radius: real, slot, clock, values, x, v_out):
        p = wp.tid()
        inside = bool(True)
        across = x[p] - real(0.5) * (lower + upper)
        for i in range(3):
            if not (x[p][i] >= lower[i] and x[p][i] <= upper[i]):
                inside = False
            if i == axis:
                across[i] = real(0.0)
        if axis >= 0 and wp.length(across) > radius:
            inside = False
        if inside:
            a = values[slot]
            v_out[p] = v_out[p] + clock[0] * wp.vector(a[0], a[1], a[2])

    return zone


@build_once
def make_drag(real: Any):
    """Kernel: solves dv/dt = rate (u - v) exactly, so that v never overshoots the wind u.

    The grid update later adds kick * a. Together with the drag, the velocity becomes v + (u + a /
    rate - v)(1 - exp(-rate kick)). If the drag ignored the acceleration a, an object's terminal
    velocity would be too high by the fraction `rate * kick / 2`.
    """

    @kernel(f"phy124_drag_{real.__name__}", real)
    def drag(chosen, slot, rate: real, clock, values, v_out):
        p = chosen[wp.tid()]
        u = values[slot]
        if u[3] > real(0.0):
            fraction = real(1.0) - wp.exp(-rate * clock[0])
            a = wp.vector(values[0][0], values[0][1], values[0][2])
            gain = fraction * (wp.vector(u[0], u[1], u[2]) - v_out[p])
            v_out[p] = v_out[p] + gain + (fraction / rate - clock[0]) * a

    return drag


@build_once
def make_attract(real: Any):
    """Kernel: attracts particles to a point.

    The acceleration is g at the distance `radius` from the point, proportional to the distance up
    to `radius`, and inversely proportional to its square beyond `radius`.
    """
    t = types(real)

    @kernel(f"phy124_attract_{real.__name__}", real)
    def attract(chosen, slot, centre: t.vec3, radius: real, clock, values, x, v_out):
        p = chosen[wp.tid()]
        d = (centre - x[p]) / radius
        r = wp.max(wp.length(d), real(1.0))
        v_out[p] = v_out[p] + (clock[0] * values[slot][0] / (r * r * r)) * d

    return attract


@build_once
def make_set_velocity(real: Any):
    """Kernel: sets v = s (u + omega x (x - centre)), C = s [omega]x while the track s is active."""
    t = types(real)

    @kernel(f"phy124_set_velocity_{real.__name__}", real)
    def set_velocity(
        chosen, slot, u: t.vec3, centre: t.vec3, omega: t.vec3, values, x, v_out, C_out
    ):
        p = chosen[wp.tid()]
        s = values[slot]
        if s[3] > real(0.0):
            v_out[p] = s[0] * (u + wp.cross(omega, x[p] - centre))
            C_out[p] = s[0] * wp.skew(omega)

    return set_velocity


PLACE, SPEED = 0, 1
FLAT = wp.constant(wp.float64(1e-6))
"""Fraction of the trace of the second moments that is added to the inertia tensor, so that the
tensor of a line of particles can be inverted.
"""


@wp.func
def spring_damper(gap: wp.vec3d, slip: wp.vec3d, spring: wp.vec4d, kick: wp.float64):
    """Return the force [N] of a damped spring at the end of a kick, by the implicit Euler method.

    `spring` contains the stiffness [N/m], the damping [N s/m], the mass that the spring pulls [kg]
    and the largest force [N]. `gap` and `slip` are the position and velocity of the target relative
    to the group.
    """
    drag = spring[1] + kick * spring[0]
    f = (spring[0] * gap + drag * slip) / (wp.float64(1.0) + kick * drag / spring[2])
    size = wp.length(f)
    if size > spring[3]:
        f = f * (spring[3] / size)
    return f


@wp.func
def angular_acceleration(torque: wp.vec3d, mass: wp.float64, second: wp.mat33d):
    """Return the angular acceleration [rad/s^2] of a rigid group.

    `second` contains the second moments per unit mass [m^2].
    """
    spread = wp.trace(second)
    inertia = wp.diag(wp.vec3d(spread, spread, spread)) - second
    inertia = inertia + FLAT * wp.diag(wp.vec3d(spread, spread, spread))
    if spread <= wp.float64(0.0):
        return wp.vec3d()
    return wp.inverse(inertia) * torque / mass


@kernel("phy124_held_forget")
def forget(means_out: wp.array(dtype=wp.vec3d), second_out: wp.array(dtype=wp.mat33d)):
    """Set the mean values of a group of particles to zero."""
    for i in range(2):
        means_out[i] = wp.vec3d()
    second_out[0] = wp.mat33d()


@build_once
def make_centre(real: Any):
    """Kernel: computes a group's centre X and velocity V while the force's track is active."""

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


@build_once
def make_second(real: Any):
    """Kernel: computes the second moments of a group about X, divided by the group's mass [m^2]."""

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


@build_once
def make_draw(real: Any):
    """Kernel: pulls a group's centre X to a moving target with a spring and a damper."""
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


@build_once
def make_wrench(real: Any):
    """Kernel: applies a force and a torque at a group's centre X, as if the group were rigid."""
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


@build_once
def make_vortex(real: Any):
    """Kernel: adds kick * b(x, t) to v; b makes a motion exact (manufactured solution).

    The motion is the generalised vortex of Kamojjala, Brannon, Sadeghirad, Guilkey 2015 (doi
    10.1007/s00366-013-0342-x): each radius of a ring rotates by beta(R, t) = h(R) g(t) about z,

        h = 1 - 8 s^2 + 16 s^4, s = (R - mean) / width,   g = A (1 - cos(2 pi t)) / 2.

    For a neo-Hookean solid tau = mu (b - I) + lambda ln(J) I of density rho, with gamma = R beta',
    the force per mass is -R beta_t^2 + mu gamma^2 / (rho R) in the radial direction and R beta_tt -
    mu (3 beta' + R beta'') / rho in the tangential direction. The inner and outer edges of the ring
    remain free of stress.

    `ring` is (mean radius [m], width [m], A [rad], mu / rho [m^2/s^2]).
    """
    t = types(real)

    @kernel(f"phy124_vortex_{real.__name__}", real)
    def vortex(ring: t.vec4, clock, x, v_out):
        p = wp.tid()
        along_x = x[p][0]
        along_y = x[p][1]
        r = wp.sqrt(along_x * along_x + along_y * along_y)
        s = (r - ring[0]) / ring[1]
        two_pi = real(6.283185307179586)
        g = real(0.5) * ring[2] * (real(1.0) - wp.cos(two_pi * clock[2]))
        g_t = real(0.5) * ring[2] * two_pi * wp.sin(two_pi * clock[2])
        g_tt = real(0.5) * ring[2] * two_pi * two_pi * wp.cos(two_pi * clock[2])
        s2 = s * s
        h = real(1.0) - real(8.0) * s2 + real(16.0) * s2 * s2
        h_r = (real(-16.0) * s + real(64.0) * s2 * s) / ring[1]
        h_rr = (real(-16.0) + real(192.0) * s2) / (ring[1] * ring[1])
        gamma = r * h_r * g
        speed = h * g_t
        outwards = -r * speed * speed + ring[3] * gamma * gamma / r
        around = r * h * g_tt - ring[3] * (real(3.0) * h_r + r * h_rr) * g
        push = wp.vector(
            (outwards * along_x - around * along_y) / r,
            (outwards * along_y + around * along_x) / r,
            real(0.0),
        )
        v_out[p] = v_out[p] + clock[0] * push

    return vortex
