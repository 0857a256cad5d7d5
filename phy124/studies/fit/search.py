"""Minimises the misfit by Sobol points, then CMA-ES (Hansen 2016), then Gauss-Newton steps.

The search with CMA-ES runs on the coarsest grid. The Gauss-Newton steps on a grid may start with
derivatives from a coarser grid.
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
"""Maximum fraction of the time budget that the search may use."""
START = 0.2
"""Standard deviation of the first generation, as a fraction of the range."""
SETTLED = 3e-3
"""Standard deviation below which the search ends, as a fraction of the range."""
GENERATIONS = 60
"""Maximum number of generations."""


def screen(problem: Problem, distance: Distance, seed: int) -> Values:
    """Return the best of several points that are evenly distributed in the unit cube.

    Raises:
        InputError: The run fails at all points.
    """
    from scipy.stats.qmc import Sobol

    count = len(problem.names)
    shift = np.random.default_rng(seed).random(count)
    drawn = (Sobol(count, scramble=False).random_base2(log2_screened(count)) + shift) % 1.0
    seen = problem.predict([*drawn], 0)
    costs = [*map(distance.cost, seen)]
    if all(prediction is None for prediction in seen):
        limit = "every run in these ranges fails."
        raise InputError("find", ", ".join(problem.names), limit, "Choose other ranges.")
    return drawn[int(np.argmin(costs))]


def log2_screened(count: int) -> int:
    """Return log2 of the number of points to screen, for `count` values."""
    return 3 + (count > 1) + (count > 3)


def generation_size(count: int) -> int:
    """Return the number of runs per generation for `count` values.

    The number is even, so that two cores are equally busy.
    """
    return 2 * ((5 + int(3 * np.log(count))) // 2)


def search(
    problem: Problem,
    distance: Distance,
    start: Values,
    seed: int,
    on_generation: Callable[[float], object] = lambda cost: None,
) -> Values:
    """Search the unit cube for the point with the smallest cost, on the coarsest grid.

    Args:
        problem: The problem.
        distance: The distance to minimise.
        start: The initial point [P].
        seed: Seed of the random generations.
        on_generation: Called with the smallest cost so far after each generation.

    Raises:
        InputError: The package `cma` is missing.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it warns of a missing matplotlib
            import cma
    except ImportError:
        command = install_command("fit")
        raise InputError(
            "fit", "cma", "the package cma is not installed.", f"Run {command}."
        ) from None
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
        # The logarithm preserves the order of the costs, and resolves small costs.
        strategy.tell(asked, np.log(np.maximum(costs, 1e-30)).tolist())
        if min(costs) < least:
            best, least = places[int(np.argmin(costs))], min(costs)
        on_generation(least)
        if float(np.max(strategy.result.stds[:count])) < SETTLED:
            break
    return best


LONGEST = 0.15
"""Maximum length of a step, as a fraction of the range."""
SHORTEST = 1e-3
"""Length of a step below which the refinement ends, as a fraction of the range."""
INFORMATIVE = 0.01
"""Minimum length of a step that updates derivatives, as a fraction of the range.

The effect of a shorter step is no larger than the scatter of runs.
"""
ROUNDS = 6
HALVES = (1.0, 0.5)
"""Fractions of a step that are evaluated in parallel; the best one is used."""


class Refined(NamedTuple):
    """The result of a refinement: a point, its prediction and its derivatives."""

    place: Values
    predicted: Values
    jacobian: Values
    """Derivatives of the prediction [M,P], updated by the steps (Broyden 1965)."""


def refine(
    problem: Problem, distance: Distance, place: Values, jacobian: Values, level: int
) -> Refined | None:
    """Improve a point by Gauss-Newton steps.

    Args:
        problem: The problem.
        distance: The distance to minimise.
        place: The initial point [P].
        jacobian: Derivatives of the prediction, on this or a coarser grid [M,P].
        level: Index of the grid.

    Returns:
        The result; None if the run at the initial point fails.
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
    """Return the step that minimises the linear model's sum of squares within the ranges."""
    from scipy.optimize import lsq_linear

    matrix, residual = distance.weigh(jacobian), distance.residual(predicted)
    # The normal equations have one row per value, so they are far smaller than the Jacobian.
    square, slope = matrix.T @ matrix, matrix.T @ residual
    low = np.maximum(-place, -LONGEST) - 1e-12
    high = np.minimum(1 - place, LONGEST) + 1e-12
    factor = np.linalg.cholesky(square + 1e-12 * np.trace(square) * np.eye(len(place)))
    return np.asarray(lsq_linear(factor.T, -np.linalg.solve(factor, slope), (low, high)).x)
