"""Defines the minimisation problem of a fit; a point of the unit cube is a set of values."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.studies.fit.observation import Groups, Kind, Values

Places = Sequence[Values]
"""Points in the unit cube: each value is a fraction of its range [P]."""
FAILED = 1e12
"""Cost of a failed run."""


class Problem(Protocol):
    """Measurements, and their prediction by simulations or by a formula."""

    measured: Values
    """Measured values [M]."""
    groups: Groups
    """Index of each measurement's group [M]; errors in a group are correlated."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the values to fit [P]."""
        ...

    @property
    def kinds(self) -> Sequence[Kind]:
        """Kinds of measurements."""
        ...

    @property
    def grids(self) -> Sequence[int]:
        """Numbers of cells across the object, from coarse to fine."""
        ...

    def predict(self, places: Places, level: int) -> list[Values | None]:
        """Predict the measurements [M] at each point on grid `level`; None for a failed run."""
        ...

    def late(self, part: float) -> bool:
        """Return whether more than the fraction `part` of the time budget has been used."""
        ...


class Distance:
    """Weighted differences between predicted and actual measurements.

    The measurements of each kind are divided by the kind's scale. A group of correlated
    measurements has the same total weight as a single measurement.
    """

    def __init__(self, problem: Problem, scales: Sequence[float] | None = None) -> None:
        """Compute the weights; a kind's default scale is the RMS of its measured values."""
        self.measured, self.kinds = problem.measured, tuple(problem.kinds)
        spreads = [float(np.sqrt(np.mean(self.measured[kind.place] ** 2))) for kind in self.kinds]
        self.scales = tuple(scales or [spread or 1.0 for spread in spreads])
        self._weights = np.empty(len(self.measured))
        for kind, scale in zip(self.kinds, self.scales, strict=True):
            groups = problem.groups[kind.place]
            count = len(np.unique(groups))
            self._weights[kind.place] = np.sqrt(count / len(groups)) / scale

    def residual(self, predicted: Values) -> Values:
        """Return the weighted differences between a prediction and the measurements [M]."""
        return self._weights * (predicted - self.measured)

    def weigh(self, jacobian: Values) -> Values:
        """Return the Jacobian [M,P] multiplied by the measurements' weights."""
        return self._weights[:, None] * jacobian

    def cost(self, predicted: Values | None) -> float:
        """Return half the sum of squared weighted differences; 1e12 for a failed run, and if a
        predicted value is not finite.
        """
        if predicted is None:
            return FAILED
        cost = 0.5 * float(np.sum(self.residual(predicted) ** 2))
        return cost if np.isfinite(cost) else FAILED

    def misfits(self, predicted: Values) -> list[float]:
        """Return the RMS difference of each kind, in its unit."""
        apart = predicted - self.measured
        return [float(np.sqrt(np.mean(apart[kind.place] ** 2))) for kind in self.kinds]


def predict_near(problem: Problem, places: Places, level: int) -> list[Values]:
    """Predict the measurements [M] for points near the best point.

    Raises:
        InputError: A run stopped early.
    """
    seen = [values for values in problem.predict(places, level) if values is not None]
    if len(seen) < len(places):
        limit, names = "the run stops early near the best values.", ", ".join(problem.names)
        raise InputError("find", names, limit, "Choose narrower ranges for the values.")
    return seen


def differentiate(problem: Problem, place: Values, level: int, step: float) -> NDArray:
    """Return the Jacobian of the prediction [M,P], computed by central differences.

    Args:
        problem: The problem.
        place: Point in the unit cube [P].
        level: Index of the grid.
        step: Step, as a fraction of each value's range.

    Raises:
        InputError: A run stopped early.
    """
    centre = np.clip(place, step, 1 - step)
    sides = [centre + sign * step * axis for axis in np.eye(len(place)) for sign in (1, -1)]
    seen = predict_near(problem, sides, level)
    return np.stack([(a - b) / (2 * step) for a, b in zip(seen[::2], seen[1::2], strict=True)], 1)
