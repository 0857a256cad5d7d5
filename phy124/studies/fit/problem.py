"""What is searched: places in the unit cube, one side per value, and what each would show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.studies.fit.observation import Groups, Kind
from phy124.studies.fit.table import Values

Places = Sequence[Values]
"""Points of the unit cube [P] each."""


class Problem(Protocol):
    """What can be asked about a fit; runs of a scene are one, a formula is another."""

    measured: Values
    """[M]."""
    groups: Groups
    """Which measurements err together [M]."""

    @property
    def names(self) -> Sequence[str]:
        """What is to be found [P]."""
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
        """What would be measured at each place, on the grid of a level; None: the run failed."""
        ...

    def late(self, part: float) -> bool:
        """Whether more than a part of the time is spent."""
        ...


class Distance:
    """Differences of prediction and measurement, each kind in units of its own scale.

    A group of measurements that err together counts once, however many they are.
    """

    def __init__(self, problem: Problem, scales: Sequence[float] | None = None) -> None:
        """Choose the scales; None: the spread of the measurements themselves."""
        self.measured, self.kinds = problem.measured, tuple(problem.kinds)
        own = [float(np.sqrt(np.mean(self.measured[kind.place] ** 2))) for kind in self.kinds]
        self.scales = tuple(scales or [scale or 1.0 for scale in own])
        self._weights = np.empty(len(self.measured))
        for kind, scale in zip(self.kinds, self.scales, strict=True):
            groups = problem.groups[kind.place]
            count = len(np.unique(groups))
            self._weights[kind.place] = np.sqrt(count / len(groups)) / scale

    def residual(self, predicted: Values) -> Values:
        """Weighted differences [M]."""
        return self._weights * (predicted - self.measured)

    def weighted(self, jacobian: Values) -> Values:
        """A Jacobian [M,P] in the same units."""
        return self._weights[:, None] * jacobian

    def cost(self, predicted: Values | None) -> float:
        """Half the sum of squares; very large for a run that failed."""
        if predicted is None:
            return 1e12
        return 0.5 * float(np.sum(self.residual(predicted) ** 2))

    def misfits(self, predicted: Values) -> list[float]:
        """Root mean square difference of each kind, in its unit."""
        apart = predicted - self.measured
        return [float(np.sqrt(np.mean(apart[kind.place] ** 2))) for kind in self.kinds]


def jacobian(problem: Problem, place: Values, level: int, step: float) -> NDArray | None:
    """Derivatives of the prediction by the place [M,P], by central differences.

    Args:
        problem: What predicts.
        place: Where.
        level: On which grid.
        step: Half the distance of two places, as a part of the range.

    Returns:
        None if a run failed.
    """
    centre = np.clip(place, step, 1 - step)
    sides = [centre + sign * step * axis for axis in np.eye(len(place)) for sign in (1, -1)]
    seen = problem.predict(sides, level)
    good = [one for one in seen if one is not None]
    if len(good) < len(seen):
        return None
    return np.stack([(a - b) / (2 * step) for a, b in zip(good[::2], good[1::2], strict=True)], 1)
