"""Measures the particles' bounding box and the maxima that limit a substep.

The lowest corner is stored as the maximum of -x.
"""

from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import build_once, kernel
from phy124.kernels.native import code
from phy124.kernels.reduction import finite, greater, raise_all, raise_to
from phy124.kernels.transfer import Law, between, member

SPEED = 0
"""Index of the largest speed |v| [m/s]."""
GRADIENT = 1
"""Index of the largest velocity gradient |C| [1/s]."""
STIFFNESS = 2
"""Index of the largest A / rho0 [m^2/s^2], where A is the modulus of the constitutive law."""
LOW = 3
"""First index of the bounding box's lowest corner [m], with negative sign."""
HIGH = 6
"""First index of the bounding box's highest corner [m]."""
COUNT = 9
SPEEDS = 2
"""Number of maxima that `make_measure_speeds` computes; these have the first indices."""


@build_once
def make_measure(law: Law, real: Any):
    """Kernel: measures the limits of the substep and the extent of the particles.

    The maxima are taken over the particles inside the domain. Particles with non-finite values
    count as stray particles.
    """
    t = types(real)
    modulus = law.modulus
    has_history = law.project is not None

    @kernel(f"phy124_measure_{law.name}_{real.__name__}", real, width=law.width, seconds=0.4)
    def measure(
        first,
        each,
        stride,
        count,
        chosen,
        theta,
        mass,
        volume,
        domain: t.vec3s,
        x,
        v,
        C,
        F,
        history,
        maxima_out,
        stray_out,
    ):
        # Squares start from 0, because the root of -inf would be NaN in a thread without particles.
        speed = real(0.0)
        gradient = real(0.0)
        stiffness = real(-wp.inf)
        low = t.vec3(real(-wp.inf))
        high = t.vec3(real(-wp.inf))
        lower = domain[0]
        upper = domain[1]
        for k in range(each):
            i = wp.tid() * first + k * stride
            if i < count:
                p = member(chosen, i)
                h = t.vec2()
                if wp.static(has_history):
                    h = history[p]
                fast = wp.dot(v[p], v[p])
                rate = wp.ddot(C[p], C[p])
                A = modulus(F[p], h, theta[wp.min(p, theta.shape[0] - 1)])
                here = x[p]
                if not finite(fast + rate + A + wp.dot(here, here)):
                    wp.atomic_add(stray_out, 0, 1)
                elif between(here, lower, upper):
                    speed = greater(speed, fast)
                    gradient = greater(gradient, rate)
                    stiffness = greater(stiffness, A * volume[p] / mass[p])
                    for axis in range(3):
                        low[axis] = greater(low[axis], -here[axis])
                        high[axis] = greater(high[axis], here[axis])
        raise_all(
            maxima_out,
            wp.vector(
                wp.sqrt(speed),
                wp.sqrt(gradient),
                stiffness,
                low[0],
                low[1],
                low[2],
                high[0],
                high[1],
                high[2],
            ),
        )

    return measure


for kinds in (types(wp.float32), types(wp.float64)):

    @wp.func_native(code("reduction:fastest"))
    def fastest(
        first: int,
        each: int,
        stride: int,
        count: int,
        chosen: Ints,
        v: kinds.vec3s,
        C: kinds.mat33s,
    ) -> kinds.vec3:
        """Return the largest |v|^2 and |C|^2, and the number of non-finite particles."""
        ...


@build_once
def make_measure_speeds(real: Any):
    """Kernel: measures only the largest speed and velocity gradient, over particles of all laws."""

    @kernel(f"phy124_measure_speeds_{real.__name__}", real)
    def measure_speeds(first, each, stride, count, chosen, v, C, maxima_out, stray_out):
        largest = fastest(wp.tid() * first, each, stride, count, chosen, v, C)
        raise_to(maxima_out, SPEED, wp.sqrt(largest[0]))
        raise_to(maxima_out, GRADIENT, wp.sqrt(largest[1]))
        if largest[2] > real(0.0):
            wp.atomic_add(stray_out, 0, int(largest[2]))

    return measure_speeds
