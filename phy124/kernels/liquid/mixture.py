"""Averages a property of several liquids, such as density, at the faces and centres of cells.

The property is relative to a reference value; for a single liquid, the relative value is 1. The
fractions of the liquids are averaged in the same way, and give the forces between liquids.
"""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.arguments import Doubles, types
from phy124.kernels.build import kernel
from phy124.kernels.diagnostics import wide
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import FILL, cell_of, entry, stride, sums
from phy124.kernels.liquid.walls import centre_of

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
    def mix(worker, active, ends, window, fills, cells: wp.array(dtype=vec8), mixed_out: t.vec4s):
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


@wp.func
def fraction_of(parts: wp.array(dtype=Any), second: wp.array(dtype=Any), n: int):
    """Return a liquid's fraction at a cell's centre.

    If `parts` is empty, there are only two liquids, and the fraction of the other one is `second`.
    """
    if parts.shape[0] > 0:
        return item(parts, n)[CENTRE]
    return type(item(second, n)[CENTRE])(1.0) - item(second, n)[CENTRE]


@cache
def make_meeting(real: Any):
    """Kernel over cells: adds impulse and moment of a liquid on another one to `sums_out` [6].

    The force per volume on a liquid of the fraction c is p grad c, where the other liquid has the
    fraction 1 - c. Between two of several liquids, with the fractions a and b, the force per volume
    is p (a grad b - b grad a). `density` is the reference of the pressure solution.
    """
    t = types(real)

    @kernel(f"phy124_liquid_meeting_{real.__name__}", real, seconds=0.2)
    def meeting(
        worker,
        active,
        ends,
        density: real,
        lattice,
        window,
        open,
        liquid,
        pressure,
        first: t.vec4s,
        second: t.vec4s,
        sums_out: Doubles,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0 or item(liquid, n) == 0:
            return
        dx = lattice[3]
        for axis in range(3):
            m = n - stride(axis, window[1])
            if item(liquid, m) == 1 and item(open, n)[axis] > real(0.0):
                share = fraction_of(first, second, m) * item(second, n)[CENTRE]
                share -= fraction_of(first, second, n) * item(second, m)[CENTRE]
                if share != real(0.0):
                    q = wp.float64(0.5) * (item(pressure, n) + item(pressure, m))
                    area = density * dx * dx * dx * item(open, n)[axis]
                    impulse = wp.vec3d()
                    impulse[axis] = q * wp.float64(area * share)
                    x = centre_of(cell_of(n, window[1]), lattice, window[0])
                    x[axis] = x[axis] - real(0.5) * dx
                    turn = wp.cross(wide(x), impulse)
                    for k in range(3):
                        wp.atomic_add(sums_out, k, impulse[k])
                        wp.atomic_add(sums_out, 3 + k, turn[k])

    return meeting
