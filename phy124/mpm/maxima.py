"""Maxima: what limits the substep and where the particles are, as measured on the device."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.kernels.measure import GRADIENT, HIGH, LOW, SPEED, STIFFNESS
from phy124.mpm.timestep import Extremes


class Maxima(NamedTuple):
    """What was measured over some particles."""

    extremes: Extremes
    """What limits the substep."""
    lower: NDArray[np.float64]
    """Lowest corner of a box that holds them [3], m."""
    upper: NDArray[np.float64]
    """Highest corner [3], m."""

    @classmethod
    def of(cls, row: NDArray[np.float64]) -> Maxima:
        """From the numbers of the device."""
        speed, gradient, stiffness = row[[SPEED, GRADIENT, STIFFNESS]].tolist()
        return cls(Extremes(speed, gradient, stiffness), -row[LOW : LOW + 3], row[HIGH : HIGH + 3])

    @property
    def corners(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner."""
        return self.lower, self.upper
