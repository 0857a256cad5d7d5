"""An experiment: published values, how the solver repeats them, and the outcome on three grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from phy124.accuracy.convergence import richardson

Values = tuple[float, ...]
"""One number per quantity; NaN where a control does not measure it."""


@dataclass(frozen=True)
class Quantity:
    """A published number, and the band in which measurements lie."""

    name: str
    published: float
    low: float
    """Lowest value that the source allows."""
    high: float
    """Highest value that the source allows."""
    at: float | None = None
    """Position on the horizontal axis of a plot, if the quantities make a curve."""

    @classmethod
    def within(cls, name: str, value: float, part: float, at: float | None = None) -> Quantity:
        """Return a quantity that is known to a fraction `part` of itself.

        Args:
            name: Name of the quantity.
            value: The published value.
            part: Half the width of its band, as a fraction of the value.
            at: Position on the horizontal axis of a plot.
        """
        half = abs(value) * part
        return cls(name, value, value - half, value + half, at)


@dataclass(frozen=True)
class Experiment:
    """A comparison with published values: the declaration of runs, table, page and plot."""

    name: str
    """Name on the command line."""
    title: str
    source: str
    """Publication or theory of the values."""
    measured: str
    """Description of the setup and the measured quantities, in a sentence or two."""
    band: str
    """Reason for the width of the band."""
    published: Callable[[], tuple[Quantity, ...]]
    """Returns the published values, in the order of `run`."""
    run: Callable[[int], Values]
    """Returns the measured values on a grid of N cells."""
    control: Callable[[int], Values]
    """Returns the values with a deliberate mistake, which must leave a band."""
    mistake: str
    """The mistake of the control."""
    grids: tuple[int, int, int]
    """Cells, from coarse to fine; the control runs on the coarsest."""
    across: str
    """Length across which the cells are counted."""
    axis: str = ""
    """Label of the horizontal axis, if the quantities make a curve."""
    unit: str = ""
    """Unit of all quantities, or their reference."""
    quick: bool = False
    """Whether `phy124 validate --quick` runs it."""
    seconds: float = 1.0
    """Approximate duration [s]; the longest experiments start first."""
    reason: str = ""
    """Why some values lie outside their bands; empty if none does."""


def find_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Find the zero of a function between two places at which its signs differ.

    Args:
        function: Function of one number.
        low: Lower end.
        high: Upper end.
    """
    from scipy.optimize import brentq

    return float(brentq(function, low, high))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class Estimate:
    """A quantity on three grids, and its extrapolation to a grid without error."""

    quantity: Quantity
    levels: Values
    """The value on each grid, from coarse to fine."""
    control: float
    """The value with the deliberate mistake, on the coarsest grid; NaN if it was not measured."""
    value: float
    """Richardson's value, or the finest grid's if the grids do not converge."""
    error: float
    """Estimated error of `value`: its distance from the finest grid's value, plus the scatter."""
    order: float | None
    """Observed order; None if the grids agree or do not converge."""

    @property
    def deviation(self) -> float:
        """Relative difference from the published value; absolute if the latter is zero."""
        return (self.value - self.quantity.published) / (abs(self.quantity.published) or 1.0)

    @property
    def inside(self) -> bool:
        """Whether the value is within its band, extended by the value's error."""
        return self.quantity.low - self.error <= self.value <= self.quantity.high + self.error

    @property
    def by_its_error(self) -> bool:
        """Whether the value is within the band only because of its error."""
        return self.inside and not self.quantity.low <= self.value <= self.quantity.high

    @property
    def control_outside(self) -> bool:
        """Whether the control is outside the band by more than the error of its grid."""
        error = abs(self.levels[0] - self.value) + self.error
        return not self.quantity.low - error <= self.control <= self.quantity.high + error


@dataclass(frozen=True)
class Outcome:
    """The estimates of an experiment, or the reasons why it could not be run."""

    experiment: Experiment
    estimates: tuple[Estimate, ...] = ()
    seconds: float = 0.0
    """Processor time of all its runs [s]."""
    failures: tuple[str, ...] = field(default=())
    """Messages of failed runs."""

    @property
    def inside(self) -> int:
        """Number of quantities within their bands."""
        return sum(each.inside for each in self.estimates)

    @property
    def control_holds(self) -> bool:
        """Whether the control leaves at least one band, so that the mistake is detected."""
        return any(each.control_outside for each in self.estimates)

    @property
    def missed(self) -> tuple[Estimate, ...]:
        """The quantities outside their bands."""
        return tuple(each for each in self.estimates if not each.inside)

    @property
    def good(self) -> bool:
        """Whether all runs succeeded, the control left a band, and misses have a known reason."""
        explained = not self.missed or bool(self.experiment.reason)
        return not self.failures and self.control_holds and explained

    @property
    def verdict(self) -> str:
        """The result in a few words."""
        if self.failures:
            return "FAILED"
        inside = f"{self.inside} of {len(self.estimates)} in the band"
        return inside if self.control_holds else f"{inside}; the CONTROL is in it, too"


def estimate(grids: Sequence[int], quantity: Quantity, levels: Values, control: float) -> Estimate:
    """Extrapolate the values of a quantity on all grids.

    Args:
        grids: Cells, from coarse to fine.
        quantity: The published quantity.
        levels: The values on the grids.
        control: The value with the deliberate mistake.
    """
    values = np.array(levels)
    if not np.isfinite(values).all():
        return Estimate(quantity, levels, control, math.nan, math.nan, None)
    size = abs(quantity.published) or 1.0
    apart = np.abs(values[:, None] - values) / size
    limit = richardson([1 / n for n in grids], apart)
    if limit.error is None:
        return Estimate(quantity, levels, control, levels[-1], float(np.ptp(values)), None)
    value = float(np.dot(limit.exact, values))
    return Estimate(quantity, levels, control, value, limit.error * size, limit.order)
