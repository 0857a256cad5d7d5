"""The watchdog: once per frame, is the state sound and does the balance of the run add up?

A violation is a sentence. What is checked, with the limits below: every number is finite; no
more than a few particles are turned inside out; volume ratios stay in range; momentum changes by
what forces and walls gave; energy does not grow beyond the work they did (explicit MPM only loses
energy, so more means that the run is exploding).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import diagnose

if TYPE_CHECKING:
    from phy124.mpm import Attachable, Solver, Stage

INSIDE_OUT = 0.01
"""Share of particles turned inside out from which the result is wrong."""
GREATEST_J = 1e6
"""Volume ratio no intact material reaches."""
ENERGY_GAIN = 0.25
"""Energy from nowhere that is tolerated, as a share of the greatest energy turned over.

Velocities are half a substep behind positions, so the sum of both energies swings by a few per
cent in a hard impact; an unstable run passes any limit within a few frames.
"""
MOMENTUM_GAIN = {"float32": 2e-3, "float64": 1e-6}
"""Momentum from nowhere that is tolerated, as a share of all momentum moved."""
GREATEST_TOTAL = 1e6
"""Norm of F_total that flowing material is held to; what is seen of it stops growing at 4."""
FAR = 2**31 - 1


@dataclass(frozen=True)
class Balance:
    """What a state adds up to."""

    momentum: NDArray[np.float64]
    """[3], kg m/s."""
    angular: NDArray[np.float64]
    """Angular momentum about the origin [3], kg m^2/s."""
    kinetic: float
    """J."""
    elastic: float
    """J."""
    middle: NDArray[np.float64]
    """Mass times position [3], kg m."""
    least_J: float
    """Least volume ratio."""
    greatest_J: float
    """Greatest volume ratio."""
    broken: int
    """Particles that are not finite."""
    inverted: int
    """Particles turned inside out."""
    first: tuple[int, int]
    """The lowest index of a broken and of an inverted particle."""

    @property
    def energy(self) -> float:
        """Kinetic and elastic energy, J."""
        return self.kinetic + self.elastic


def weigh(solver: Solver) -> Balance:
    """Add up the state of a solver."""
    device = solver.device
    sums = wp.zeros(diagnose.SUMS, dtype=wp.float64, device=device)
    spread = wp.array([-math.inf, -math.inf], dtype=wp.float64, device=device)
    counts = wp.zeros(2, dtype=int, device=device)
    first = wp.array([FAR, FAR], dtype=int, device=device)
    s = solver.state
    for group in solver.groups:
        part = slice(group.start, group.stop)
        history = s.history[part] if len(s.history) else s.history
        wp.launch(
            diagnose.make_weigh(group.law, solver.real),
            group.stop - group.start,
            inputs=[
                group.theta, solver.mass[part], solver.volume[part], solver.dx, group.start,
                s.x[part], s.v[part], s.C[part], s.F[part], history,
            ],
            outputs=[sums, spread, counts, first],
            device=device,
        )  # fmt: skip
    total, (broken, inverted) = sums.numpy(), counts.numpy().tolist()
    lowest, highest = spread.numpy().tolist()
    a, b = first.numpy().tolist()
    return Balance(
        momentum=total[:3], angular=total[3:6], kinetic=float(total[6]), elastic=float(total[7]),
        middle=total[8:], least_J=-lowest, greatest_J=highest, broken=broken, inverted=inverted,
        first=(a, b),
    )  # fmt: skip
