"""Compares the solver with known solutions, for `phy124 accuracy --verify`."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from phy124.accuracy.convergence import distances, fit_order, richardson
from phy124.studies.validation.accuracy import problems

Range = tuple[float, float]


@dataclass(frozen=True)
class Verdict:
    """The result of one check of the solver."""

    problem: str
    quantity: str
    value: float
    """Error on the finest grid, or the largest error of all grids."""
    limit: float
    """Largest permitted error."""
    levels: tuple[int, ...] = ()
    """Cells across the body on each grid, from coarse to fine; empty for a single grid."""
    order: float | None = None
    """Observed order of convergence, if any."""
    expected_order: Range | None = None
    """Permitted range of the order; None if the order is not checked."""
    seconds: float = 0.0
    """CPU time used [s]."""

    @property
    def passed(self) -> bool:
        """Whether the error and the order are within their permitted ranges."""
        within = True
        if self.expected_order is not None:
            low, high = self.expected_order
            within = self.order is not None and low <= self.order <= high
        return bool(np.isfinite(self.value) and self.value <= self.limit and within)


def verify(*, device: str = "cpu") -> Iterator[Verdict]:
    """Run all checks, and yield their results; the fine grids take half a minute on a CPU."""
    for check in CHECKS:
        start = time.process_time()
        for verdict in check(True, device):
            yield replace(verdict, seconds=time.process_time() - start)
            start = time.process_time()


def free_fall(fine: bool, device: str) -> Iterator[Verdict]:
    """Check that a thrown body follows the exact parabola up to rounding.

    The check fails unless the first substep advances velocities by half a substep (leapfrog).
    """
    time = 0.4 if fine else 0.2
    for precision, limit in (("float64", 1e-12), ("float32", 5e-5)):
        error = problems.free_fall(precision=precision, time=time, device=device)
        yield Verdict(f"free fall, {precision}", "position error / way", error, limit)


def rigid_spin(fine: bool, device: str) -> Iterator[Verdict]:
    """Check that a rotating body conserves angular momentum and loses little energy."""
    turns = 8.0 if fine else 2.0
    for precision, limit in (("float64", 1e-12), ("float32", 1e-4)):
        momentum, energy = problems.spin(turns, precision=precision, device=device)
        name = f"rigid spin, {precision}"
        yield Verdict(name, "angular momentum lost", momentum, limit)
        if precision == "float64":
            yield Verdict(name, "energy lost", energy, 0.02)


def vibrating_bar(fine: bool, device: str) -> Iterator[Verdict]:
    """Check that the frequency of a bar converges to `pi c / L` with second order."""
    cells = (8, 16, 32, 64) if fine else (8, 16, 32)
    errors = [abs(problems.vibrating_bar(n, device)) for n in cells]
    yield _series("vibrating bar", "frequency error", cells, errors, 2e-3, (1.8, 2.2))


def vortex(fine: bool, device: str) -> Iterator[Verdict]:
    """Check that the ring's motion converges with about second order.

    On finer grids, the error of the quadrature would dominate (Steffen, Kirby, Berzins 2008).
    """
    cells = (32, 64, 128) if fine else (16, 32, 64)
    errors = [problems.vortex(n, device=device) for n in cells]
    yield _series("generalised vortex", "position error", cells, errors, 0.01, (1.5, 3.1))


def hydrostatic_column(fine: bool, device: str) -> Iterator[Verdict]:
    """Check the mean hydrostatic pressure, and the pressure away from the floor."""
    cells = (8, 16, 32) if fine else (6, 12, 24)
    columns = [problems.hydrostatic_column(n, device) for n in cells]
    for quantity, limit in (("mean", 1e-3), ("inside", 0.01)):
        worst = float(np.max([column[quantity] for column in columns]))
        yield Verdict("hydrostatic column", f"pressure error, {quantity}", worst, limit, cells)


def bouncing_ball(fine: bool, device: str) -> Iterator[Verdict]:
    """Check that a bouncing ball converges with an order from 1 to 2; contact reduces the order."""
    cells = (12, 18, 27) if fine else (8, 12, 16)
    runs = problems.bouncing_ball(cells, device)
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


CHECKS: tuple[Callable[[bool, str], Iterator[Verdict]], ...] = (
    free_fall,
    rigid_spin,
    vibrating_bar,
    vortex,
    hydrostatic_column,
    bouncing_ball,
)


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
