"""Forces on chosen particles, before they scatter: one kernel per force.

`chosen` lists the particles a force acts on; `slot` is the track that holds its strength, whose
fourth component is zero while the force is off.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.transfer import types


@cache
def make_accelerate(real: Any, per_mass: bool):
    """Kernel: v += kick a, or kick f / m where `per_mass` (the paper's particle force)."""
    t = types(real)
    name = f"phy124_accelerate_{'force' if per_mass else 'field'}_{real.__name__}"

    @wp.kernel(module=name, enable_backward=False)
    def accelerate(
        # model
        chosen: wp.array(dtype=int), slot: int, mass: wp.array(dtype=real),
        clock: wp.array(dtype=real), values: wp.array(dtype=t.vec4),
        # out
        v_out: wp.array(dtype=t.vec3),
    ):  # fmt: skip
        p = chosen[wp.tid()]
        a = values[slot]
        scale = clock[0] * a[3]
        if wp.static(per_mass):
            scale = scale / mass[p]
        v_out[p] = v_out[p] + scale * wp.vector(a[0], a[1], a[2])

    return accelerate


@cache
def make_set_velocity(real: Any):
    """Kernel: v = u + omega x (x - centre) and C = [omega]x while active."""
    t = types(real)

    @wp.kernel(module=f"phy124_set_velocity_{real.__name__}", enable_backward=False)
    def set_velocity(
        # model
        chosen: wp.array(dtype=int), slot: int, centre: t.vec3, omega: t.vec3,
        x: wp.array(dtype=t.vec3), values: wp.array(dtype=t.vec4),
        # out
        v_out: wp.array(dtype=t.vec3), C_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = chosen[wp.tid()]
        u = values[slot]
        if u[3] > real(0.0):
            v_out[p] = wp.vector(u[0], u[1], u[2]) + wp.cross(omega, x[p] - centre)
            C_out[p] = wp.skew(omega)

    return set_velocity
