"""`phy124 accuracy --verify`: compares the solver with known solutions on this machine.

Each check gives an error, the order at which it falls with the grid spacing, and the range in which
each must be. The same code runs on coarse grids in every test run, and on fine grids in the slow
tests.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from phy124.accuracy.convergence import distances, fit_order, richardson
from phy124.studies.validation.accuracy import problems

Range = tuple[float, float]


@dataclass(frozen=True)
class Verdict:
    """The result of one problem."""

    problem: str
    quantity: str
    """Quantity that `value` measures."""
    value: float
    """Error at the finest or only level."""
    limit: float
    """Largest value that passes."""
    levels: tuple[int, ...] = ()
    """Cells across, from coarse to fine."""
    order: float | None = None
    """Observed order of convergence; None if the solution is exact or no order was observed."""
    expected_order: Range | None = None
    """Range of valid orders; None if there is no order."""
    seconds: float = 0.0
    """CPU time used [s]."""

    @property
    def passed(self) -> bool:
        """Whether value and order are as expected."""
        within = True
        if self.expected_order is not None:
            low, high = self.expected_order
            within = self.order is not None and low <= self.order <= high
        return bool(np.isfinite(self.value) and self.value <= self.limit and within)


def verify(*, fine: bool = True) -> Iterator[Verdict]:
    """Run every check in turn; on fine grids they take about half a minute."""
    for check in CHECKS:
        start = time.process_time()
        for verdict in check(fine):
            yield replace(verdict, seconds=time.process_time() - start)
            start = time.process_time()


def free_fall(fine: bool) -> Iterator[Verdict]:
    """Half a kick at the start makes the parabola exact, up to rounding."""
    time = 0.4 if fine else 0.2
    for precision, limit in (("float64", 1e-12), ("float32", 5e-5)):
        error = problems.free_fall(precision=precision, time=time)
        yield Verdict(f"free fall, {precision}", "position error / way", error, limit)


def rigid_spin(fine: bool) -> Iterator[Verdict]:
    """APIC conserves angular momentum exactly and loses little energy."""
    turns = 8.0 if fine else 2.0
    for precision, limit in (("float64", 1e-12), ("float32", 1e-4)):
        kept = problems.spin(turns, precision=precision)
        name = f"rigid spin, {precision}"
        yield Verdict(name, "angular momentum lost", kept.angular_momentum, limit)
        if precision == "float64":
            yield Verdict(name, "energy lost", kept.energy, 0.02)


def vibrating_bar(fine: bool) -> Iterator[Verdict]:
    """Second order in the grid spacing: omega = pi c / L."""
    cells = (8, 16, 32, 64) if fine else (8, 16, 32)
    errors = [abs(problems.vibrating_bar(n)) for n in cells]
    yield _series("vibrating bar", "frequency error", cells, errors, 2e-3, (1.8, 2.2))


def vortex(fine: bool) -> Iterator[Verdict]:
    """Second order until the error of quadrature dominates (Steffen, Kirby, Berzins 2008)."""
    cells = (32, 64, 128) if fine else (16, 32, 64)
    errors = [problems.vortex(n) for n in cells]
    yield _series("generalised vortex", "position error", cells, errors, 0.01, (1.5, 3.1))


def hydrostatic_column(fine: bool) -> Iterator[Verdict]:
    """The floor carries the weight, so the pressure is right on any grid, on average and inside."""
    cells = (8, 16, 32) if fine else (6, 12, 24)
    columns = [problems.hydrostatic_column(n) for n in cells]
    for quantity, limit in (("mean", 1e-3), ("inside", 0.01)):
        worst = max(getattr(column, quantity) for column in columns)
        yield Verdict("hydrostatic column", f"pressure error, {quantity}", worst, limit, cells)


def bouncing_ball(fine: bool) -> Iterator[Verdict]:
    """Contact lowers the order to between 1 and 2, as the series of grids shows."""
    cells = (12, 18, 27) if fine else (8, 12, 16)
    runs = problems.bouncing_ball(cells)
    size = problems.Bounce().diameter
    extrapolation = richardson([1 / n for n in cells], distances(runs) / size)
    error = float("nan") if extrapolation.error is None else extrapolation.error
    limit = 0.02 if fine else 0.04
    yield Verdict(
        "bouncing ball",
        "position error / size",
        error,
        limit,
        cells,
        extrapolation.order,
        (1.0, 2.0),
    )


CHECKS: tuple[Callable[[bool], Iterator[Verdict]], ...] = (
    free_fall,
    rigid_spin,
    vibrating_bar,
    vortex,
    hydrostatic_column,
    bouncing_ball,
)
"""All checks, in the order in which they are shown."""


def _series(
    problem: str,
    quantity: str,
    cells: Sequence[int],
    errors: Sequence[float],
    limit: float,
    expected: Range,
) -> Verdict:
    order = fit_order([1 / n for n in cells], errors)
    return Verdict(problem, quantity, errors[-1], limit, tuple(cells), order, expected)
