"""An experiment: published values, simulation, and outcome on three grids."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

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
    """Lower end of the band."""
    high: float
    """Upper end of the band."""
    at: float | None = None
    """Position on the horizontal axis of a plot; None: no curve."""

    @classmethod
    def within(cls, name: str, value: float, part: float, at: float | None = None) -> Quantity:
        """Return a quantity with a band that is symmetric about the value.

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
    title: str
    source: str
    measured: str
    """The setup and the measured quantities, in one or two sentences."""
    band: str
    """The bands and the reason for their width."""
    published: Callable[[], tuple[Quantity, ...]]
    """Returns the published values, in the order of `run`."""
    run: Callable[[int], Values]
    """Simulates with N cells across the length `across`, and returns the measured values."""
    control: Callable[[int], Values]
    """Simulates with a deliberate mistake; at least one value must be outside its band."""
    mistake: str
    """The mistake in the control run."""
    grids: tuple[int, int, int]
    """Cells across the length `across`, from coarse to fine; the control uses the coarsest grid."""
    across: str
    """Length across which cells are counted."""
    axis: str = ""
    """Label of the horizontal axis; empty if the quantities do not form a curve."""
    unit: str = ""
    """Unit of all quantities, or the value by which all are divided."""
    quick: bool = False
    """Whether `phy124 validate --quick` runs the experiment."""
    seconds: float = 1.0
    """Approximate duration [s]; the longest experiments start first."""
    known: Mapping[str, float] = field(default_factory=dict)
    """Largest known `deviation`, with its sign, of each quantity that may be outside its band."""
    reason: str = ""
    """Reason for the known deviations."""


def repeat_with_mpm(
    experiment: Experiment,
    run: Callable[[int], Values],
    control: Callable[[int], Values],
    *,
    seconds: float,
    known: Mapping[str, float] | None = None,
    reason: str = "",
) -> Experiment:
    """Return an experiment that repeats another one with MPM instead of the lattice solver.

    Args:
        experiment: The experiment on lattices.
        run: Simulates with MPM.
        control: Simulates with MPM and the deliberate mistake.
        seconds: Approximate duration [s].
        known: Largest known deviation of each quantity that may be outside its band.
        reason: Reason for the known deviations.
    """
    return replace(
        experiment,
        name=f"{experiment.name}-mpm",
        title=f"{experiment.title.partition(':')[0]} with MPM",
        measured=f'The experiment repeats `{experiment.name}` with accuracy.solver = "mpm".',
        run=run,
        control=control,
        seconds=seconds,
        known=known or {},
        reason=reason,
    )


def find_root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return the zero of a function that has opposite signs at `low` and `high`."""
    from scipy.optimize import brentq

    return float(brentq(function, low, high))  # pyright: ignore[reportArgumentType]


@dataclass(frozen=True)
class Estimate:
    """The simulated values of a quantity on three grids, and their extrapolation."""

    quantity: Quantity
    levels: Values
    """The value on each grid, from coarse to fine."""
    control: float
    """The value in the control run; NaN if it was not measured."""
    value: float
    """The Richardson extrapolation, or the value on the finest grid if the grids do not converge.
    """
    error: float
    """Estimated error of `value`; the spread of the values if the grids do not converge."""
    order: float | None
    """Observed order of convergence; None if the grids agree or do not converge."""

    @property
    def deviation(self) -> float:
        """Difference from the published value; relative unless that value is zero."""
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
        """Whether the control is outside the band by more than the coarsest grid's error; False if
        the control does not measure the quantity.
        """
        error = abs(self.levels[0] - self.value) + self.error
        low, high = self.quantity.low - error, self.quantity.high + error
        return self.control < low or self.control > high


@dataclass(frozen=True)
class Outcome:
    """The estimates of an experiment, and the messages of failed runs."""

    experiment: Experiment
    estimates: tuple[Estimate, ...] = ()
    seconds: float = 0.0
    """CPU time of all runs [s]."""
    failures: tuple[str, ...] = field(default=())

    @property
    def inside(self) -> int:
        """Number of quantities within their bands."""
        return sum(each.inside for each in self.estimates)

    @property
    def control_holds(self) -> bool:
        """Whether the experiment detects the mistake in the control run."""
        return any(each.control_outside for each in self.estimates)

    @property
    def missed(self) -> tuple[Estimate, ...]:
        """The quantities outside their bands."""
        return tuple(each for each in self.estimates if not each.inside)

    @property
    def new(self) -> tuple[Estimate, ...]:
        """The quantities outside their bands whose deviation exceeds the known deviation."""
        return tuple(each for each in self.missed if not self._is_known(each))

    def _is_known(self, each: Estimate) -> bool:
        known = self.experiment.known.get(each.quantity.name, 0.0)
        return min(known, 0.0) <= each.deviation <= max(known, 0.0)

    @property
    def good(self) -> bool:
        """Whether all runs worked, the mistake in the control run is detected, and no deviation is
        new.
        """
        return not self.failures and self.control_holds and not self.new

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
    """Extrapolate the values of a quantity to zero grid spacing.

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
