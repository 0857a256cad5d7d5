"""The fit: search, refusal of what cannot be told, refinement from grid to grid, intervals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from phy124.errors import InputError
from phy124.studies.fit.apart import undetermined, unseen
from phy124.studies.fit.interval import bootstrap, extrapolated, shifted, unexplained
from phy124.studies.fit.problem import Distance, Problem, jacobian
from phy124.studies.fit.refine import Refined, refine
from phy124.studies.fit.search import screened, search
from phy124.studies.fit.table import Values

STEP = 0.05
"""Half the distance of central differences, as a part of the range. Runs scatter by some tenths of
a pixel however close their values are, so that differences over shorter ways are those of chance:
with 0.01 the slopes by nu of a pressed duck were up to nine times too large."""
END = 0.005
"""Distance from the end of a range at which a value is said to lie there."""


@dataclass(frozen=True)
class Estimate:
    """What was found, as parts of the ranges."""

    places: tuple[Values, ...]
    """The best on each grid that was reached [P]."""
    misfits: tuple[list[float], ...]
    """Root mean square difference of each kind, on each of these grids."""
    grids: tuple[int, ...]
    """Cells across the object of each."""
    sampling: Values
    """Half of the interval, as far as it comes from the measurements [P]."""
    model: Values
    """How far an error of the finest grid, of the size that was seen, may shift it [P]."""
    correlation: Values
    """[P,P]."""
    notes: tuple[str, ...]

    def on(self, cells: float) -> tuple[Values, Values]:
        """The best on any grid, infinity for the material itself, and half its interval [P].

        An extrapolation is taken to be as uncertain as it is long, and no less than an error of the
        finest grid may shift the value. That is no matter of chance, so it adds to what the
        measurements leave open.
        """
        place, shift = extrapolated(self.grids, self.places, cells)
        return place, self.sampling + np.maximum(self.model, shift)


def estimate(
    problem: Problem, *, seed: int = 0, told: Callable[[float], object] = lambda cost: None
) -> Estimate:
    """Find the values.

    Args:
        problem: What predicts and what was measured.
        seed: Of everything random.
        told: Called with the least cost after each generation of the search.

    Raises:
        InputError: Some values cannot be told apart, or runs fail.
    """
    distance = Distance(problem)
    start = screened(problem, distance, seed)
    _refuse_unseen(problem, distance, _slopes(problem, start, 0))
    best = search(problem, distance, start, seed, told)
    slopes = _slopes(problem, best, 0)
    _refuse_unseen(problem, distance, slopes)
    found = _refined(problem, distance, best, slopes, 0)
    distance = Distance(problem, [_scale(one) for one in distance.misfits(found.predicted)])
    found = _refined(problem, distance, found.place, found.jacobian, 0)
    passed = [found]
    for level in range(1, len(problem.grids)):
        if problem.late(1.0):
            break
        passed.append(_refined(problem, distance, found.place, found.jacobian, level))
        found = passed[-1]
    found = _settled(problem, distance, passed)
    return _judged(problem, distance, passed, found, seed)


def _settled(problem: Problem, distance: Distance, passed: list[Refined]) -> Refined:
    """The last place with derivatives of its own grid, if there is time for them."""
    level, found = len(passed) - 1, passed[-1]
    if not problem.late(1.0):
        slopes = _slopes(problem, found.place, level)
        found = _refined(problem, distance, found.place, slopes, level)
        # As measured: what steps taught them is right along these steps alone.
        passed[-1] = found = found._replace(jacobian=slopes)
    return found


def _judged(
    problem: Problem, distance: Distance, passed: list[Refined], found: Refined, seed: int
) -> Estimate:
    """The estimate with its intervals; refuses what is left open."""
    distance = Distance(problem, [_scale(one) for one in distance.misfits(found.predicted)])
    slopes, residual = distance.weighted(found.jacobian), distance.residual(found.predicted)
    spread = bootstrap(slopes, residual, problem.groups, problem.kinds, seed)
    misfits = tuple(distance.misfits(one.predicted) for one in passed)
    grids, model = tuple(problem.grids[: len(passed)]), np.zeros(len(problem.names))
    if len(passed) > 1:
        parts = unexplained(grids, *misfits[-2:])
        model = shifted(slopes, parts, problem.groups, problem.kinds)
    blind = undetermined(problem.names, spread.errors, model, spread.covariance)
    if blind is not None:
        raise blind.refusal()
    places = tuple(one.place for one in passed)
    scale = np.sqrt(np.diag(spread.covariance))
    return Estimate(
        places, misfits, grids, spread.errors, model,
        spread.covariance / np.outer(scale, scale), tuple(_notes(problem, places)),
    )  # fmt: skip


def _notes(problem: Problem, places: tuple[Values, ...]) -> list[str]:
    """Sentences about what is weaker than it might be."""
    found = []
    for name, part in zip(problem.names, places[-1], strict=True):
        if not END < part < 1 - END:
            end = "lower" if part < 0.5 else "upper"
            found.append(f"{name} lies at the {end} end of its range: widen it.")
    if len(problem.grids) == 1:
        found.append("With one grid its own error is unknown, and not in the intervals.")
    elif len(places) < len(problem.grids):
        left = ", ".join(map(str, problem.grids[len(places) :]))
        found.append(f"The time ended before the grid of {left} cells: give more --seconds.")
    return found


def _refuse_unseen(problem: Problem, distance: Distance, slopes: Values) -> None:
    """Refuse what no measurement of this kind could tell."""
    spread = distance.residual(np.zeros_like(problem.measured))
    blind = unseen(problem.names, distance.weighted(slopes), float(np.linalg.norm(spread)))
    if blind is not None:
        raise blind.refusal()


def _slopes(problem: Problem, place: Values, level: int) -> Values:
    found = jacobian(problem, place, level, STEP)
    if found is None:
        raise _failed(problem)
    return found


def _refined(
    problem: Problem, distance: Distance, place: Values, slopes: Values, level: int
) -> Refined:
    found = refine(problem, distance, place, slopes, level)
    if found is None:
        raise _failed(problem)
    return found


def _failed(problem: Problem) -> InputError:
    limit = "the run stops early near the best values."
    return InputError("find", ", ".join(problem.names), limit, "Choose narrower ranges.")


def _scale(misfit: float) -> float:
    """A misfit as a scale, which must not be zero."""
    return max(misfit, 1e-12)
