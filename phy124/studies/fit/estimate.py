"""Estimates the fitted values and their intervals."""

from dataclasses import dataclass

import numpy as np

from phy124.studies.fit.interval import (
    bootstrap,
    extrapolate,
    find_undetermined,
    find_unexplained,
    find_unseen,
    shift_values,
)
from phy124.studies.fit.observation import Values
from phy124.studies.fit.problem import Distance, Problem, differentiate
from phy124.studies.fit.search import Refined, refine, screen, search

STEP = 0.05
"""Step of central differences, as a fraction of a value's range.

With a shorter step, random differences between runs (some tenths of a pixel) would be larger than
the effect of the step. For example, with a step of 0.01, derivatives of a pressed duck's motion
with respect to nu were up to nine times too large.
"""
END = 0.005
"""A fitted value causes a warning if it is closer to an end of its range than this fraction of the
range.
"""


@dataclass(frozen=True)
class Estimate:
    """The fitted values and their intervals, as fractions of the values' ranges."""

    places: tuple[Values, ...]
    """The best values on each grid [P]."""
    misfits: tuple[list[float], ...]
    """RMS misfit of each kind of measurement on each grid, in the unit of the kind."""
    grids: tuple[int, ...]
    """Numbers of cells across the object."""
    sampling: Values
    """Half-width of each 95 % interval [P] that is due to errors of the measurements."""
    model: Values
    """Largest shift of each value [P] that the finest grid's error can cause."""
    correlation: Values
    """Correlation matrix of the fitted values [P,P]."""
    notes: tuple[str, ...]

    def on(self, cells: float) -> tuple[Values, Values]:
        """Return the values on a grid [P] and the half-widths of their intervals [P].

        The values are extrapolated to `cells` cells across the object; infinity means a grid
        without error. Each half-width is `sampling` plus the larger of two numbers: `model`, and
        the shift of the value by the extrapolation.
        """
        place, shift = extrapolate(self.grids, self.places, cells)
        return place, self.sampling + np.maximum(self.model, shift)


def estimate(problem: Problem, *, seed: int = 0) -> Estimate:
    """Fit the values to the measurements.

    Raises:
        InputError: Some values cannot be determined, or runs of the simulation fail.
    """
    distance = Distance(problem)
    start = screen(problem, distance, seed)
    _refuse_unseen(problem, distance, differentiate(problem, start.place, 0, STEP))
    best = search(problem, distance, start, seed)
    slopes = differentiate(problem, best, 0, STEP)
    _refuse_unseen(problem, distance, slopes)
    fit = refine(problem, distance, best, slopes, 0)
    distance = _rescale(problem, distance, fit)
    levels = [refine(problem, distance, fit.place, fit.jacobian, 0)]
    for level in range(1, len(problem.grids)):
        if problem.late(1.0):
            break
        fit = levels[-1]
        levels.append(refine(problem, distance, fit.place, fit.jacobian, level))
    if not problem.late(1.0):
        # Broyden's updates are accurate only along the steps, so the derivatives are computed
        # again.
        level, fit = len(levels) - 1, levels[-1]
        slopes = differentiate(problem, fit.place, level, STEP)
        fit = refine(problem, distance, fit.place, slopes, level)
        levels[-1] = fit._replace(jacobian=slopes)
    return _conclude(problem, distance, levels, seed)


def _conclude(problem: Problem, distance: Distance, levels: list[Refined], seed: int) -> Estimate:
    fit = levels[-1]
    distance = _rescale(problem, distance, fit)
    slopes, residual = distance.weigh(fit.jacobian), distance.residual(fit.predicted)
    spread = bootstrap(slopes, residual, problem.groups, problem.kinds, seed)
    misfits = tuple(distance.misfits(level.predicted) for level in levels)
    grids, model = tuple(problem.grids[: len(levels)]), np.zeros(len(problem.names))
    if len(levels) > 1:
        parts = find_unexplained(grids, *misfits[-2:])
        model = shift_values(slopes, parts, problem.groups, problem.kinds)
    blind = find_undetermined(problem.names, spread.errors, model, spread.covariance)
    if blind is not None:
        raise blind
    places = tuple(level.place for level in levels)
    scale = np.sqrt(np.diag(spread.covariance))
    correlation, notes = spread.covariance / np.outer(scale, scale), tuple(_notes(problem, places))
    return Estimate(places, misfits, grids, spread.errors, model, correlation, notes)


def _notes(problem: Problem, places: tuple[Values, ...]) -> list[str]:
    notes = []
    for name, part in zip(problem.names, places[-1], strict=True):
        if not END < part < 1 - END:
            end = "lower" if part < 0.5 else "upper"
            notes.append(f"{name} lies at the {end} end of its range, so widen the range.")
    if len(problem.grids) == 1:
        notes.append(
            "Since there is only one grid, the grid's error is unknown and not included in the "
            "intervals."
        )
    elif len(places) < len(problem.grids):
        left = ", ".join(map(str, problem.grids[len(places) :]))
        notes.append(
            f"The time limit was reached before the grid of {left} cells was run: increase "
            "--seconds."
        )
    return notes


def _refuse_unseen(problem: Problem, distance: Distance, slopes: Values) -> None:
    spread = distance.residual(np.zeros_like(problem.measured))
    blind = find_unseen(problem.names, distance.weigh(slopes), float(np.linalg.norm(spread)))
    if blind is not None:
        raise blind


def _rescale(problem: Problem, distance: Distance, fit: Refined) -> Distance:
    return Distance(problem, [max(misfit, 1e-12) for misfit in distance.misfits(fit.predicted)])
