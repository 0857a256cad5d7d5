"""Refinement: a few Gauss-Newton steps, whose derivatives may come from a coarser grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from phy124.studies.fit.problem import Distance, Problem
from phy124.studies.fit.table import Values

LONGEST = 0.15
"""Longest step, as a part of the range."""
SHORTEST = 1e-3
"""Step at which it ends."""
TOLD = 0.01
"""Step from which on derivatives learn from it, as a part of the range: over a shorter one runs
differ by chance as much as by the value."""
ROUNDS = 6
HALVES = (1.0, 0.5)
"""Parts of a step that are tried at once."""


class Refined(NamedTuple):
    """A place that no further step makes better."""

    place: Values
    predicted: Values
    jacobian: Values
    """Derivatives of the prediction [M,P], brought up to date by the steps (Broyden 1965)."""


def refine(
    problem: Problem, distance: Distance, place: Values, jacobian: Values, level: int
) -> Refined | None:
    """The best place near another one; None if the run fails there.

    Args:
        problem: What predicts.
        distance: What is made small.
        place: Where it begins.
        jacobian: Derivatives of the prediction, on this grid or a coarser one [M,P].
        level: The grid.
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
        costs = [distance.cost(one) for one in seen]
        best = int(np.argmin(costs))
        found = seen[best]
        if found is None:
            break
        moved = places[best] - place
        square = float(moved @ moved)
        if square > TOLD**2:
            change = found - predicted - jacobian @ moved
            jacobian = jacobian + np.outer(change, moved) / square
        if costs[best] >= distance.cost(predicted):
            break
        place, predicted = places[best], found
        if np.abs(moved).max() < SHORTEST:
            break
    return Refined(place, predicted, jacobian)


def _step(distance: Distance, place: Values, predicted: Values, jacobian: Values) -> Values:
    """The step to the least sum of squares of the linear model within the ranges."""
    from scipy.optimize import lsq_linear

    matrix, residual = distance.weighted(jacobian), distance.residual(predicted)
    # Normal equations: as many rows as values instead of measurements.
    square, slope = matrix.T @ matrix, matrix.T @ residual
    low = np.maximum(-place, -LONGEST) - 1e-12
    high = np.minimum(1 - place, LONGEST) + 1e-12
    factor = np.linalg.cholesky(square + 1e-12 * np.trace(square) * np.eye(len(place)))
    return np.asarray(lsq_linear(factor.T, -np.linalg.solve(factor, slope), (low, high)).x)
