"""Finds slivers of liquid between oblique walls and the surface, in which viscosity dominates.

In the viscous step, a wall without friction that is oblique to the cells prescribes no velocities
of faces, so the step does not stop the flow into the wall (viscous.py). The pressure alone would
stop this flow, and expel the liquid in slivers as jets. In reality, viscosity prevents such jets.
The velocities of faces in slivers are therefore extrapolated (spread.py). Slivers at freely moving
walls are treated in the same way.
"""

from typing import Any

import warp as wp

from phy124.kernels.build import build_once, kernel
from phy124.kernels.items import item
from phy124.kernels.liquid.faces import entry, stride
from phy124.kernels.liquid.viscous import filled_face, loose_wall

LIGHT = wp.constant(0.25)
"""Largest mass of a face in a sliver [full cells]."""


@build_once
def make_slivers(real: Any):
    """Kernel over cells: removes the bits of faces in slivers from `known_out`.

    A face is in a sliver if the nearby wall prescribes no velocities of faces, and if the mass of
    the face is below `LIGHT` and below dt eta / (rho dx^2), so that viscosity determines its
    velocity. `viscosity` is eta / (rho dx^2) [1/s] for a relative density and viscosity of 1.
    """

    @kernel(f"phy124_liquid_slivers_{real.__name__}", real, seconds=0.3)
    def slivers(
        worker,
        active,
        ends,
        viscosity,
        window,
        clock,
        densities,
        viscosities,
        open,
        phi,
        liquid,
        states,
        known_out,
    ):
        n = entry(active, ends, worker, wp.tid())
        if n < 0:
            return
        known = item(known_out, n)
        for axis in range(3):
            share = item(open, n)[axis]
            if known & (1 << axis) > 0 and share < real(1.0):
                size = window[1]
                m = n - stride(axis, size)
                mass = item(densities, n)[axis] * filled_face(phi, liquid, n, m) * share
                k = viscosity * clock[0] * item(viscosities, n)[axis]
                if mass < wp.min(k, real(LIGHT)):
                    if loose_wall(open, states, n, size) or loose_wall(open, states, m, size):
                        known -= 1 << axis
        known_out[n] = known

    return slivers
