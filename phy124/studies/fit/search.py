"""The search on the coarsest grid: Sobol's points, then CMA-ES (Hansen 2016) from the best."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np

from phy124.errors import InputError
from phy124.runtime.installation import install_command
from phy124.studies.fit.problem import Distance, Problem
from phy124.studies.fit.table import Values

PART = 0.6
"""Part of the time that the search may take."""
START = 0.2
"""Standard deviation of the first generation, as a part of the range."""
SETTLED = 3e-3
"""Standard deviation at which the search ends: the steps after it go on from there."""
GENERATIONS = 60
"""Most generations."""


def screened(problem: Problem, distance: Distance, seed: int) -> Values:
    """The best of some places that are spread evenly.

    Raises:
        InputError: The run fails at all of them.
    """
    from scipy.stats.qmc import Sobol

    count = len(problem.names)
    shift = np.random.default_rng(seed).random(count)
    drawn = (Sobol(count, scramble=False).random_base2(screening(count)) + shift) % 1.0
    seen = problem.predict([*drawn], 0)
    costs = [distance.cost(one) for one in seen]
    if all(one is None for one in seen):
        limit = "the run fails everywhere in these ranges."
        raise InputError("find", ", ".join(problem.names), limit, "Choose other ranges.")
    return drawn[int(np.argmin(costs))]


def screening(count: int) -> int:
    """Logarithm to base 2 of how many places are screened for so many values."""
    return 3 + (count > 1) + (count > 3)


def generation(count: int) -> int:
    """Number of runs of one generation, even so that two cores share them."""
    return 2 * ((5 + int(3 * np.log(count))) // 2)


def search(
    problem: Problem,
    distance: Distance,
    start: Values,
    seed: int,
    told: Callable[[float], object] = lambda cost: None,
) -> Values:
    """The best place on the coarsest grid.

    Args:
        problem: What predicts.
        distance: What is made small.
        start: Where the search begins.
        seed: Seed of the random generations.
        told: Called with the least cost after each generation.

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
    # CMA-ES wants two coordinates; a second one that changes nothing costs little.
    begin = start if count > 1 else np.append(start, 0.5)
    options = {
        "bounds": [0, 1], "seed": seed + 1, "popsize": generation(count), "tolx": SETTLED,
        "maxiter": GENERATIONS, "verbose": -9, "verb_disp": 0, "verb_log": 0,
    }  # fmt: skip
    strategy = cma.CMAEvolutionStrategy(begin, START, options)
    best, least = start, np.inf
    while not strategy.stop() and not problem.late(PART):
        asked = strategy.ask()
        places = [np.asarray(one[:count], float) for one in asked]
        costs = [distance.cost(one) for one in problem.predict(places, 0)]
        # The logarithm leaves the order of the places, and tells flat from steep ends apart.
        strategy.tell(asked, np.log(np.maximum(costs, 1e-30)).tolist())
        if min(costs) < least:
            best, least = places[int(np.argmin(costs))], min(costs)
        told(least)
        if float(np.max(strategy.result.stds[:count])) < SETTLED:
            break
    return best
