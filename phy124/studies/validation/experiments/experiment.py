"""An experiment: published values, simulation, and outcome on three grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from phy124.accuracy.convergence import richardson

Values = tuple[float, ...]
"""One number per quantity; NaN if a control run does not measure the quantity."""


@dataclass(frozen=True)
class Quantity:
    """A published value with a band of permitted values."""

    name: str
    published: float
    low: float
    """Lower end of the band, according to the source."""
    high: float
    """Upper end of the band, according to the source."""
    at: float | None = None
    """Position on the horizontal axis of a plot; None if the quantities do not form a curve."""

    @classmethod
    def within(cls, name: str, value: float, part: float, at: float | None = None) -> Quantity:
        """Return a quantity whose band is symmetric about the published value.

        Args:
            name: Name of the quantity.
            value: The published value.
            part: Half the width of the band, as a fraction of the value.
            at: Position on the horizontal axis of a plot.
        """
        half = abs(value) * part
        return cls(name, value, value - half, value + half, at)


@dataclass(frozen=True)
class Experiment:
    """A comparison of simulations with published values, with texts for tables and plots."""

    name: str
    """Name of the experiment on the command line."""
    title: str
    source: str
    """Publication or theory from which the values come."""
    measured: str
    """Description of the setup and the measured quantities, in one or two sentences."""
    band: str
    """Description of the bands, with the reason for their width."""
    published: Callable[[], tuple[Quantity, ...]]
    """Function that returns the published values, in the same order as `run` returns the simulated
    values.
    """
    run: Callable[[int], Values]
    """Function that simulates with N cells across the length `across`, and returns the measured
    values.
    """
    control: Callable[[int], Values]
    """Function that simulates the control: a run with a deliberate mistake. At least one value of
    the control run must be outside its band.
    """
    mistake: str
    """Description of the mistake in the control run."""
    grids: tuple[int, int, int]
    """Cells across the length `across`, from coarse to fine; the control run uses the coarsest
    grid.
    """
    across: str
    """Length across which cells are counted."""
    axis: str = ""
    """Label of the plot's horizontal axis; empty if the quantities do not form a curve."""
    unit: str = ""
    """Unit of all quantities, or the value by which all are divided."""
    quick: bool = False
    """Whether `phy124 validate --quick` runs the experiment."""
    seconds: float = 1.0
    """Approximate duration of the experiment [s]; the longest experiments start first."""
    reason: str = ""
    """Known reason why some values lie outside their bands; empty if there is none."""


def find_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the zero of a function between `low` and `high`.

    The function must have opposite signs at these two points.
    """
    from scipy.optimize import brentq

    return float(brentq(function, low, high))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class Estimate:
    """The simulated values of a quantity on three grids, and their extrapolation."""

    quantity: Quantity
    levels: Values
    """The simulated value of the quantity on each grid, from coarse to fine."""
    control: float
    """The quantity's value in the control run, on the coarsest grid; NaN if it was not measured."""
    value: float
    """The quantity's value by Richardson extrapolation, or on the finest grid if the grids do not
    converge.
    """
    error: float
    """Estimated error of `value`; if the grids do not converge, the spread of their values."""
    order: float | None
    """Observed order of convergence; None if the grids agree or do not converge."""

    @property
    def deviation(self) -> float:
        """Relative difference of `value` from the published value.

        The difference is absolute if the published value is zero.
        """
        return (self.value - self.quantity.published) / (abs(self.quantity.published) or 1.0)

    @property
    def inside(self) -> bool:
        """Whether `value` is within the band, extended by `error` on both sides."""
        return self.quantity.low - self.error <= self.value <= self.quantity.high + self.error

    @property
    def by_its_error(self) -> bool:
        """Whether `value` is outside the band, but by less than `error`."""
        return self.inside and not self.quantity.low <= self.value <= self.quantity.high

    @property
    def control_outside(self) -> bool:
        """Whether the control run's value is outside the band by more than its error.

        The error is that of the coarsest grid.
        """
        error = abs(self.levels[0] - self.value) + self.error
        return not self.quantity.low - error <= self.control <= self.quantity.high + error


@dataclass(frozen=True)
class Outcome:
    """The estimates of an experiment, and the messages of failed runs."""

    experiment: Experiment
    estimates: tuple[Estimate, ...] = ()
    seconds: float = 0.0
    """Total CPU time of all runs [s]."""
    failures: tuple[str, ...] = field(default=())
    """Error messages of failed runs."""

    @property
    def inside(self) -> int:
        """Number of quantities within their bands."""
        return sum(each.inside for each in self.estimates)

    @property
    def control_holds(self) -> bool:
        """Whether the experiment detects the control run's mistake: a value is outside its band."""
        return any(each.control_outside for each in self.estimates)

    @property
    def missed(self) -> tuple[Estimate, ...]:
        """The quantities outside their bands."""
        return tuple(each for each in self.estimates if not each.inside)

    @property
    def good(self) -> bool:
        """Whether no run failed, and the control run's mistake is detected.

        In addition, the reason for values outside their bands must be known.
        """
        explained = not self.missed or bool(self.experiment.reason)
        return not self.failures and self.control_holds and explained

    @property
    def verdict(self) -> str:
        """Short description of the result."""
        if self.failures:
            return "FAILED"
        inside = f"{self.inside} of {len(self.estimates)} in the band"
        return (
            inside
            if self.control_holds
            else f"{inside}, but the control run also stays inside all bands"
        )


def estimate(grids: Sequence[int], quantity: Quantity, levels: Values, control: float) -> Estimate:
    """Extrapolate the simulated values of a quantity to zero grid spacing.

    Args:
        grids: Cells of each grid, from coarse to fine.
        quantity: The published quantity.
        levels: The value on each grid.
        control: The value of the control.
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
