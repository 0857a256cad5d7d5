"""What a material does with the work of its stress: how much of it friction inside takes.

Both sums are in float64. The stress in a substep is the mean of those at its ends, which is right
to second order for what is elastic, and at the yield stress while something flows.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.reduction import add_to
from phy124.kernels.spectral import to_double
from phy124.kernels.transfer import Law, member

RUBBED, STRAINED, LOST = 0, 1, 2
"""Index of each sum, and the number of sums: the work of the part of the stress that depends on the
rate, and of the part that does not [J]."""


@cache
def make_dissipation(law: Law, real: Any):
    """Kernel, right after a gather: adds the work of a substep to the `LOST` sums.

    Each thread sums `each` particles before it writes, as in `make_measure`.
    """
    stress, exact = law.stress, wp.types.vector(law.width, wp.float64)
    has_history = law.project is not None

    @kernel(f"phy124_dissipation_{law.name}_{real.__name__}", real, width=law.width)
    def dissipation(
        first,
        each,
        stride,
        count,
        chosen,
        theta,
        volume,
        clock,
        C,
        F,
        history,
        stress_out: wp.array(dtype=wp.mat33d),
        sums_out,
    ):
        rubbed = wp.float64(0.0)
        strained = wp.float64(0.0)
        dt = wp.float64(clock[1])
        for k in range(each):
            i = wp.tid() * first + k * stride
            if i < count:
                p = member(chosen, i)
                h = wp.vec2d()
                if wp.static(has_history):
                    h = wp.vec2d(wp.float64(history[p][0]), wp.float64(history[p][1]))
                row = wp.min(p, theta.shape[0] - 1)
                parameters = exact()
                for c in range(wp.static(law.width)):
                    parameters[c] = wp.float64(theta[row][c])
                rate = to_double(C[p])
                here = to_double(F[p])
                still = stress(here, wp.mat33d(), h, parameters)
                moving = stress(here, rate, h, parameters)
                mean = wp.float64(0.5) * (stress_out[p] + still)
                stress_out[p] = still
                share = dt * wp.float64(volume[p])
                rubbed += share * wp.ddot(moving - still, rate)
                strained += share * wp.ddot(mean, rate)
        add_to(sums_out, RUBBED, rubbed)
        add_to(sums_out, STRAINED, strained)

    return dissipation
