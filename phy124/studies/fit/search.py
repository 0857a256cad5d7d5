"""Optimisation: Sobol's points, CMA-ES (Hansen 2016), and Gauss-Newton steps.

The search runs on the coarsest grid; the refinement may use derivatives from a coarser grid.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from phy124.errors import InputError
from phy124.runtime.installation import install_command
from phy124.studies.fit.observation import Values
from phy124.studies.fit.problem import Distance, Problem

PART = 0.6
"""Largest fraction of the time for the search."""
START = 0.2
"""Standard deviation of the first generation, as a fraction of the range."""
SETTLED = 3e-3
"""Standard deviation at which the search ends and the refinement begins."""
GENERATIONS = 60
"""Largest number of generations."""


def screen(problem: Problem, distance: Distance, seed: int) -> Values:
    """Return the best of evenly distributed places.

    Raises:
        InputError: The run fails at all places.
    """
    from scipy.stats.qmc import Sobol

    count = len(problem.names)
    shift = np.random.default_rng(seed).random(count)
    drawn = (Sobol(count, scramble=False).random_base2(log2_screened(count)) + shift) % 1.0
    seen = problem.predict([*drawn], 0)
    costs = [*map(distance.cost, seen)]
    if all(prediction is None for prediction in seen):
        limit = "the run fails everywhere in these ranges."
        raise InputError("find", ", ".join(problem.names), limit, "Choose other ranges.")
    return drawn[int(np.argmin(costs))]


def log2_screened(count: int) -> int:
    """Return log2 of the number of screened places for a number of values."""
    return 3 + (count > 1) + (count > 3)


def generation_size(count: int) -> int:
    """Return the number of runs per generation, which is even, for two cores."""
    return 2 * ((5 + int(3 * np.log(count))) // 2)


def search(
    problem: Problem,
    distance: Distance,
    start: Values,
    seed: int,
    on_generation: Callable[[float], object] = lambda cost: None,
) -> Values:
    """Search the best place on the coarsest grid.

    Args:
        problem: The problem.
        distance: The distance to minimise.
        start: The first place.
        seed: Seed of the random generations.
        on_generation: Called with the least cost after each generation.

    Raises:
        InputError: The package `cma` is missing.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of a missing matplotlib
            import cma
    except ImportError:
        command = install_command("fit")
        raise InputError("fit", "cma", "this package is missing.", f"Run {command}.") from None
    count = len(start)
    # CMA-ES needs two coordinates; a second one without effect costs little.
    begin = start if count > 1 else np.append(start, 0.5)
    options = {"bounds": [0, 1], "seed": seed + 1, "popsize": generation_size(count)}
    options |= {"tolx": SETTLED, "maxiter": GENERATIONS}
    options |= {"verbose": -9, "verb_disp": 0, "verb_log": 0}
    strategy = cma.CMAEvolutionStrategy(begin, START, options)
    best, least = start, np.inf
    while not strategy.stop() and not problem.late(PART):
        asked = strategy.ask()
        places = [np.asarray(place[:count], float) for place in asked]
        costs = [*map(distance.cost, problem.predict(places, 0))]
        # The logarithm keeps the order of the places, and resolves small costs.
        strategy.tell(asked, np.log(np.maximum(costs, 1e-30)).tolist())
        if min(costs) < least:
            best, least = places[int(np.argmin(costs))], min(costs)
        on_generation(least)
        if float(np.max(strategy.result.stds[:count])) < SETTLED:
            break
    return best


LONGEST = 0.15
"""Longest step, as a fraction of the range."""
SHORTEST = 1e-3
"""Step at which the refinement ends."""
INFORMATIVE = 0.01
"""Shortest step that updates derivatives, as a fraction of the range; the effect of a shorter step
is no larger than the scatter of runs."""
ROUNDS = 6
HALVES = (1.0, 0.5)
"""Fractions of a step that are tried at once."""


class Refined(NamedTuple):
    """A place that no further step improves."""

    place: Values
    predicted: Values
    jacobian: Values
    """Derivatives of the prediction [M,P], updated by the steps (Broyden 1965)."""


def refine(
    problem: Problem, distance: Distance, place: Values, jacobian: Values, level: int
) -> Refined | None:
    """Return the best place near another place; None if the run fails there.

    Args:
        problem: The problem.
        distance: The distance to minimise.
        place: The first place.
        jacobian: Derivatives of the prediction, on this or a coarser grid [M,P].
        level: Index of the grid.
    """
    predicted = problem.predict([place], level)[0]
    if predicted is None:
        return None
    for count in range(ROUNDS):
        if count and problem.late(1.0):
            break
        step = _step(distance, place, predicted, jacobian)
        places = [np.clip(place + part * step, 0, 1) for part in HALVES]
        seen = problem.predict(places, level)
        costs = [*map(distance.cost, seen)]
        best = int(np.argmin(costs))
        prediction = seen[best]
        if prediction is None:
            break
        moved = places[best] - place
        square = float(moved @ moved)
        if square > INFORMATIVE**2:
            change = prediction - predicted - jacobian @ moved
            jacobian = jacobian + np.outer(change, moved) / square
        if costs[best] >= distance.cost(predicted):
            break
        place, predicted = places[best], prediction
        if np.abs(moved).max() < SHORTEST:
            break
    return Refined(place, predicted, jacobian)


def _step(distance: Distance, place: Values, predicted: Values, jacobian: Values) -> Values:
    """Return the step to the linear model's least sum of squares within the ranges."""
    from scipy.optimize import lsq_linear

    matrix, residual = distance.weigh(jacobian), distance.residual(predicted)
    # Normal equations have a row per value instead of a row per measurement.
    square, slope = matrix.T @ matrix, matrix.T @ residual
    low = np.maximum(-place, -LONGEST) - 1e-12
    high = np.minimum(1 - place, LONGEST) + 1e-12
    factor = np.linalg.cholesky(square + 1e-12 * np.trace(square) * np.eye(len(place)))
    return np.asarray(lsq_linear(factor.T, -np.linalg.solve(factor, slope), (low, high)).x)
