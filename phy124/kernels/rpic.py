"""RPIC: the symmetric part of C dies away, its skew part, which is spin, stays.

PhysGaussian's `rpic_damping` r scatters (1 - r) C + r/2 (C - C^T) in each substep, so that r = 1 is
RPIC (Jiang et al. 2015, section 5.1) and what it damps depends on the substep. Here it is a rate.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.transfer import member, types


@wp.func
def decayed(x: Any):
    """1 - exp(-x), right to rounding for small x, too."""
    t = wp.tanh(type(x)(0.5) * x)
    return type(x)(2.0) * t / (type(x)(1.0) + t)


@wp.func
def without_strain(C: Any, share: Any):
    """C less a share of its symmetric part; a skew C comes back bit for bit."""
    return C - (type(share)(0.5) * share) * (C + wp.transpose(C))


@cache
def make_rpic(real: Any):
    """Kernel, right before a scatter: sym C decays as exp(-rate t), rate in 1/s."""
    t = types(real)

    @kernel(f"phy124_rpic_{real.__name__}")
    def rpic(
        # model
        chosen: wp.array(dtype=int), rate: real, clock: wp.array(dtype=real),
        # in place
        C_out: wp.array(dtype=t.mat33),
    ):  # fmt: skip
        p = member(chosen, wp.tid())
        C_out[p] = without_strain(C_out[p], decayed(rate * clock[0]))

    return rpic
