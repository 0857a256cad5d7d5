"""Forces on chosen particles before they scatter: one kernel per force.

`chosen` lists the particles that a force acts on; `slot` is the track with its strength, averaged
over the kick and zero while the force is off.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.build import kernel


@cache
def make_accelerate(real: Any, per_mass: bool):
    """Kernel: v += kick a, or kick f / m where `per_mass` (the paper's particle force)."""
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


@cache
def make_zone(real: Any):
    """Kernel: v += kick a for particles that are inside a box now.

    With an `axis` from 0 to 2, only the cylinder along that axis about the box's centre counts.
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


@cache
def make_drag(real: Any):
    """Kernel: v approaches the wind, dv/dt = rate (u - v), exactly, and never overshoots.

    The uniform acceleration a acts after it, on the grid. Both at once would give
    v + (u + a / rate - v)(1 - exp(-rate kick)), so that less a kick is what is left here: one after
    the other, what falls through a stream would be too fast by rate kick / 2.
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


@cache
def make_attract(real: Any):
    """Kernel: v += kick g d / r, g linear inside `radius` and falling as 1 / d^2 outside."""
    t = types(real)

    @kernel(f"phy124_attract_{real.__name__}", real)
    def attract(chosen, slot, centre: t.vec3, radius: real, clock, values, x, v_out):
        p = chosen[wp.tid()]
        d = (centre - x[p]) / radius
        r = wp.max(wp.length(d), real(1.0))
        v_out[p] = v_out[p] + (clock[0] * values[slot][0] / (r * r * r)) * d

    return attract


@cache
def make_set_velocity(real: Any):
    """Kernel: v = s (u + omega x (x - centre)) and C = s [omega]x while active, s the profile."""
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
