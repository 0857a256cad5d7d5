"""Minimises the misfit: Sobol points, then CMA-ES (Hansen 2016), then Gauss-Newton steps."""

import warnings
from typing import NamedTuple

import numpy as np

from phy124.errors import InputError
from phy124.runtime.installation import install_command
from phy124.studies.fit.observation import Values
from phy124.studies.fit.problem import Distance, Problem, predict_near

PART = 0.6
"""Maximum fraction of the time budget that the search may use."""
START = 0.2
"""Initial standard deviation of CMA-ES, as a fraction of the range."""
SETTLED = 3e-3
"""The search ends when the standard deviation of CMA-ES is below this fraction of the range."""
GENERATIONS = 60
"""Maximum number of generations of CMA-ES."""


class Start(NamedTuple):
    """The initial point of a search."""

    place: Values
    cost: float


def screen(problem: Problem, distance: Distance, seed: int) -> Start:
    """Evaluate points that fill the ranges evenly; return the best point.

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
        limit = "all runs in these ranges fail."
        raise InputError("find", ", ".join(problem.names), limit, "Choose other ranges.")
    best = int(np.argmin(costs))
    return Start(drawn[best], costs[best])


def log2_screened(count: int) -> int:
    """Return the base-2 logarithm of the number of evaluated points, for `count` values."""
    return 3 + (count > 1) + (count > 3)


def generation_size(count: int) -> int:
    """Return the number of runs in a generation of CMA-ES, an even number that suits two cores."""
    return 2 * ((5 + int(3 * np.log(count))) // 2)


def search(problem: Problem, distance: Distance, start: Start, seed: int) -> Values:
    """Search for the point with the smallest cost on the coarsest grid.

    Args:
        problem: The problem.
        distance: The cost function.
        start: The initial point.
        seed: Seed of the random generations.

    Raises:
        InputError: The package `cma` is not installed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the import warns if matplotlib is missing
            import cma
    except ImportError:
        command = install_command("fit")
        raise InputError(
            "fit", "cma", "the package cma is not installed.", f"Run {command}."
        ) from None
    best, least = start
    count = len(best)
    # CMA-ES needs at least two coordinates; a second coordinate without effect costs little.
    begin = best if count > 1 else np.append(best, 0.5)
    options = {"bounds": [0, 1], "seed": seed + 1, "popsize": generation_size(count)}
    options |= {"tolx": SETTLED, "maxiter": GENERATIONS}
    options |= {"verbose": -9, "verb_disp": 0, "verb_log": 0}
    strategy = cma.CMAEvolutionStrategy(begin, START, options)
    while not strategy.stop() and not problem.late(PART):
        asked = strategy.ask()
        places = [np.asarray(place[:count], float) for place in asked]
        costs = [*map(distance.cost, problem.predict(places, 0))]
        # The logarithm keeps the order of the costs and makes differences between small costs
        # visible.
        strategy.tell(asked, np.log(np.maximum(costs, 1e-30)).tolist())
        if min(costs) < least:
            best, least = places[int(np.argmin(costs))], min(costs)
        if float(np.max(strategy.result.stds[:count])) < SETTLED:
            break
    return best


LONGEST = 0.15
"""Maximum length of a Gauss-Newton step, as a fraction of the range."""
SHORTEST = 1e-3
"""The refinement ends when a Gauss-Newton step is shorter than this fraction of the range."""
INFORMATIVE = 0.01
"""Shortest Gauss-Newton step that corrects the derivatives, as a fraction of the range.

The effect of shorter steps is no larger than the random differences between runs.
"""
ROUNDS = 6
HALVES = (1.0, 0.5)
"""Fractions of a Gauss-Newton step that are tried in parallel."""


class Refined(NamedTuple):
    """The result of a refinement."""

    place: Values
    predicted: Values
    jacobian: Values
    """Derivatives of the prediction [M,P], corrected after each step (Broyden 1965)."""


def refine(
    problem: Problem, distance: Distance, place: Values, jacobian: Values, level: int
) -> Refined:
    """Improve a point by Gauss-Newton steps.

    Args:
        problem: The problem.
        distance: The cost function.
        place: The initial point [P].
        jacobian: Derivatives of the prediction [M,P], on this or a coarser grid.
        level: Index of the grid.

    Raises:
        InputError: The run at the initial point stops early.
    """
    (predicted,) = predict_near(problem, [place], level)
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
    """Return the least-squares step of the linear model within the ranges."""
    from scipy.optimize import lsq_linear

    matrix, residual = distance.weigh(jacobian), distance.residual(predicted)
    # The normal equations have only one row per value, so they are much smaller than the Jacobian.
    square, slope = matrix.T @ matrix, matrix.T @ residual
    low = np.maximum(-place, -LONGEST) - 1e-12
    high = np.minimum(1 - place, LONGEST) + 1e-12
    factor = np.linalg.cholesky(square + 1e-12 * np.trace(square) * np.eye(len(place)))
    return np.asarray(lsq_linear(factor.T, -np.linalg.solve(factor, slope), (low, high)).x)
