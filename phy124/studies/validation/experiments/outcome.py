"""What an experiment found: the value without the grid's error, and whether it is in its band."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from phy124.accuracy.convergence import richardson
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values


@dataclass(frozen=True)
class Found:
    """One quantity on three grids, and what they say about a grid without error."""

    quantity: Quantity
    levels: Values
    """The value on each grid, from coarse to fine."""
    control: float
    """The value with the deliberate mistake, on the coarsest grid; NaN if it was not measured."""
    value: float
    """Richardson's value, or the finest where the grids do not converge."""
    error: float
    """Estimated error of that value: its distance from the finest grid's, and their scatter."""
    order: float | None
    """Observed order; None if the grids agree or do not converge."""

    @property
    def deviation(self) -> float:
        """Difference from the published value, as a fraction of it (of 1 if that is zero)."""
        return (self.value - self.quantity.published) / (abs(self.quantity.published) or 1.0)

    @property
    def inside(self) -> bool:
        """Whether the value is within its band, give or take its own error."""
        return self.quantity.low - self.error <= self.value <= self.quantity.high + self.error

    @property
    def by_its_error(self) -> bool:
        """Whether it is within the band only thanks to its own error."""
        return self.inside and not self.quantity.low <= self.value <= self.quantity.high

    @property
    def control_outside(self) -> bool:
        """Whether the control is outside the band by more than the error of its grid."""
        own = abs(self.levels[0] - self.value) + self.error
        return self.control < self.quantity.low - own or self.control > self.quantity.high + own


@dataclass(frozen=True)
class Outcome:
    """All that one experiment found, or why it could not be run."""

    experiment: Experiment
    found: tuple[Found, ...] = ()
    seconds: float = 0.0
    """Processor time of all its runs [s]."""
    failures: tuple[str, ...] = field(default=())
    """What went wrong in a run."""

    @property
    def inside(self) -> int:
        """How many quantities are within their bands."""
        return sum(each.inside for each in self.found)

    @property
    def control_holds(self) -> bool:
        """Whether the mistake is seen: its control leaves at least one band."""
        return any(each.control_outside for each in self.found)

    @property
    def missed(self) -> tuple[Found, ...]:
        """The quantities outside their bands."""
        return tuple(each for each in self.found if not each.inside)

    @property
    def good(self) -> bool:
        """Whether all ran, the control left a band, and each miss is one whose reason is known."""
        explained = not self.missed or bool(self.experiment.reason)
        return not self.failures and self.control_holds and explained

    @property
    def verdict(self) -> str:
        """The result in a few words."""
        if self.failures:
            return "FAILED"
        inside = f"{self.inside} of {len(self.found)} in the band"
        return inside if self.control_holds else f"{inside}; the CONTROL is in it, too"


def found(grids: Sequence[int], quantity: Quantity, levels: Values, control: float) -> Found:
    """What the values of one quantity on all grids say.

    Args:
        grids: Cells, from coarse to fine.
        quantity: What was published.
        levels: The values on the grids.
        control: The value with the deliberate mistake.
    """
    values = np.array(levels)
    if not np.isfinite(values).all():
        return Found(quantity, levels, control, math.nan, math.nan, None)
    size = abs(quantity.published) or 1.0
    apart = np.abs(values[:, None] - values) / size
    limit = richardson([1 / n for n in grids], apart)
    if limit.error is None:
        return Found(quantity, levels, control, levels[-1], float(np.ptp(values)), None)
    value = float(np.dot(limit.exact, values))
    return Found(quantity, levels, control, value, limit.error * size, limit.order)
