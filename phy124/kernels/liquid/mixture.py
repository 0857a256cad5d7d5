"""Averages a property of several liquids, such as density, at the faces and centres of cells.

The property is relative to a reference value; for a single liquid, the relative value is 1.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Ints, types
from phy124.kernels.build import kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import FILL, entry, stride, sums

CENTRE = wp.constant(3)
"""Index of the value at a cell's centre; the indices 0 to 2 are the low faces."""


@wp.func
def between(a: Any, b: Any):
    """Return the harmonic mean of two values, of which one or both may be zero.

    The harmonic mean is the viscosity between two layers that have the same shear stress.
    """
    total = a + b
    if total <= type(a)(0.0):
        return type(a)(0.0)
    return type(a)(2.0) * a * b / total


@cache
def make_mix(real: Any):
    """Kernel over cells: averages a property of liquids around each centre and low face.

    `fills` contains the sums of volume times property, and `cells` the sums of the volume. Without
    liquid, the average is 1.
    """
    t = types(real)
    vec8 = sums(real)

    @kernel(f"phy124_liquid_mix_{real.__name__}", real, seconds=0.2)
    def mix(
        worker: int,
        active: Ints,
        ends: Ints,
        window,
        fills: t.vec2s,
        cells: wp.array(dtype=vec8),
        mixed_out: t.vec4s,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        q = t.vec4(real(1.0), real(1.0), real(1.0), real(1.0))
        for k in range(4):
            volume = item(cells, n)[FILL]
            total = item(fills, n)[0]
            if k < 3:
                m = n - stride(k, window[1])
                volume += item(cells, m)[FILL]
                total += item(fills, m)[0]
            if volume > real(0.0):
                q[k] = total / volume
        mixed_out[n] = q

    return mix
