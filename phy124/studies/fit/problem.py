"""The search space: places in the unit cube, an axis per value, and their predictions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.studies.fit.observation import Groups, Kind, Values

Places = Sequence[Values]
"""Points of the unit cube [P] each."""


class Problem(Protocol):
    """Measurements and their predictions, by runs of a scene or by a formula."""

    measured: Values
    """[M]."""
    groups: Groups
    """Group of each measurement [M]; errors in a group are correlated."""

    @property
    def names(self) -> Sequence[str]:
        """Names of the values to find [P]."""
        ...

    @property
    def kinds(self) -> Sequence[Kind]:
        """Kinds of measurements."""
        ...

    @property
    def grids(self) -> Sequence[int]:
        """Cells across the object, from coarse to fine."""
        ...

    def predict(self, places: Places, level: int) -> list[Values | None]:
        """Predict the measurements at each place on a level's grid; None: the run failed."""
        ...

    def late(self, part: float) -> bool:
        """Whether more than a fraction of the time is spent."""
        ...


class Distance:
    """Differences of prediction and measurement, each kind in units of its scale.

    A group of correlated measurements has the weight of one measurement.
    """

    def __init__(self, problem: Problem, scales: Sequence[float] | None = None) -> None:
        """Set the scales; None: the root mean square of the measurements."""
        self.measured, self.kinds = problem.measured, tuple(problem.kinds)
        spreads = [float(np.sqrt(np.mean(self.measured[kind.place] ** 2))) for kind in self.kinds]
        self.scales = tuple(scales or [spread or 1.0 for spread in spreads])
        self._weights = np.empty(len(self.measured))
        for kind, scale in zip(self.kinds, self.scales, strict=True):
            groups = problem.groups[kind.place]
            count = len(np.unique(groups))
            self._weights[kind.place] = np.sqrt(count / len(groups)) / scale

    def residual(self, predicted: Values) -> Values:
        """Return weighted differences [M]."""
        return self._weights * (predicted - self.measured)

    def weigh(self, jacobian: Values) -> Values:
        """Return a Jacobian [M,P] in the units of `residual`."""
        return self._weights[:, None] * jacobian

    def cost(self, predicted: Values | None) -> float:
        """Return half the sum of squares; very large for a failed run."""
        if predicted is None:
            return 1e12
        return 0.5 * float(np.sum(self.residual(predicted) ** 2))

    def misfits(self, predicted: Values) -> list[float]:
        """Return the root mean square difference of each kind, in its unit."""
        apart = predicted - self.measured
        return [float(np.sqrt(np.mean(apart[kind.place] ** 2))) for kind in self.kinds]


def differentiate(problem: Problem, place: Values, level: int, step: float) -> NDArray | None:
    """Differentiate the prediction by the place [M,P], by central differences.

    Args:
        problem: The problem.
        place: The place.
        level: Index of the grid.
        step: Half the distance of two places, as a fraction of the range.

    Returns:
        None if a run failed.
    """
    centre = np.clip(place, step, 1 - step)
    sides = [centre + sign * step * axis for axis in np.eye(len(place)) for sign in (1, -1)]
    seen = problem.predict(sides, level)
    good = [prediction for prediction in seen if prediction is not None]
    if len(good) < len(seen):
        return None
    return np.stack([(a - b) / (2 * step) for a, b in zip(good[::2], good[1::2], strict=True)], 1)
