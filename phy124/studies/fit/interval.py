"""Intervals: a bootstrap over groups of measurements, and what the grid's own error leaves open.

Each draw takes as many groups as there are, with repetition, and makes one Gauss-Newton step from
the fitted place, so that none needs a run. Errors that a group shares (a badly tracked point, a
limb that the grid bends wrongly) widen the interval as they must.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.studies.fit.observation import Groups, Kind
from phy124.studies.fit.table import Values

DRAWS = 1000
PROBABILITY = 0.95


class Spread(NamedTuple):
    """How far values may be off."""

    errors: Values
    """Half of each interval, as a part of the range [P]."""
    covariance: Values
    """[P,P]."""


def bootstrap(
    jacobian: Values, residual: Values, groups: Groups, kinds: Sequence[Kind], seed: int
) -> Spread:
    """Spread of the fitted values under repetition of the measurements.

    Args:
        jacobian: Derivatives of the weighted prediction [M,P].
        residual: Weighted differences at the fitted place [M].
        groups: Which measurements err together [M].
        kinds: Kinds of measurements; each is drawn by itself.
        seed: Of the draws.
    """
    from scipy.special import stdtrit

    count, width = int(groups.max()) + 1, jacobian.shape[1]
    squares, slopes = np.zeros((count, width, width)), np.zeros((count, width))
    np.add.at(squares, groups, jacobian[:, :, None] * jacobian[:, None, :])
    np.add.at(slopes, groups, jacobian * residual[:, None])
    slopes -= slopes.mean(0)
    taken = _drawn(groups, kinds, count, np.random.default_rng(seed))
    matrices = np.einsum("bg,gij->bij", taken, squares)
    matrices += 1e-9 * np.trace(squares.sum(0)) * np.eye(width)
    steps = -np.linalg.solve(matrices, (taken @ slopes)[..., None])[..., 0]
    free = max(count - width, 1)
    covariance = np.atleast_2d(np.cov(steps.T)) * count / free
    factor = float(stdtrit(free, 0.5 + PROBABILITY / 2))
    return Spread(factor * np.sqrt(np.diag(covariance)), covariance)


def _drawn(
    groups: Groups, kinds: Sequence[Kind], count: int, random: np.random.Generator
) -> Values:
    """How often each group is taken in each draw [DRAWS,G]."""
    taken = np.zeros((DRAWS, count))
    for kind in kinds:
        own = np.unique(groups[kind.place])
        taken[:, own] = random.multinomial(len(own), np.full(len(own), 1 / len(own)), DRAWS)
    return taken


def extrapolated(
    grids: Sequence[int], places: Sequence[Values], cells: float
) -> tuple[Values, Values]:
    """The place on another grid, and how far that is from the finest one.

    A body's surface is known to a part of a cell, so the first power of the spacing is taken
    (Richardson); with one grid nothing is known.

    Args:
        grids: Cells across the object, from coarse to fine.
        places: The fitted place on each.
        cells: Of the other grid; infinity for one without an error.
    """
    finest = places[-1]
    if len(places) < 2:
        return finest, np.zeros_like(finest)
    coarse, fine, other = 1 / grids[-2], 1 / grids[-1], 1 / cells
    shift = (finest - places[-2]) * (fine - other) / (coarse - fine)
    return finest + shift, np.abs(shift)


def unexplained(grids: Sequence[int], coarse: Sequence[float], fine: Sequence[float]) -> Values:
    """Error of the finest grid in each kind of measurement, as a part of the misfit on it.

    A misfit m holds errors of the measurements, the same on each grid, and those of the grid, which
    shrink with its spacing h: m^2 = a^2 + (c h)^2. Two grids tell c.

    Args:
        grids: Cells across the object, from coarse to fine.
        coarse: Root mean square misfit of each kind on the last grid but one.
        fine: The same on the last one.
    """
    more = (np.asarray(coarse) / np.maximum(fine, 1e-12)) ** 2 - 1
    return np.sqrt(np.maximum(more, 0) / ((grids[-1] / grids[-2]) ** 2 - 1))


def shifted(
    jacobian: Values, parts: Values, groups: Groups, kinds: Sequence[Kind]
) -> NDArray[np.float64]:
    """How far errors of the model may shift each value, if their size is known and no more [P].

    Errors of a grid have few shapes (singular values of those of the twins make two to four), so
    that they must be expected to look as much like the effect of a value as they can. The longest
    shift by errors of norm e is e sqrt((J^T J)^-1) (least squares).

    Args:
        jacobian: Derivatives of the weighted prediction [M,P], in units of the misfit.
        parts: Size of the errors in each kind of measurement, as a part of its misfit.
        groups: Which measurements err together [M].
        kinds: Kinds of measurements.
    """
    counts = [len(np.unique(groups[kind.place])) for kind in kinds]
    size = float(np.sqrt(np.dot(counts, np.square(parts))))
    square = jacobian.T @ jacobian
    inverse = np.linalg.inv(square + 1e-12 * np.trace(square) * np.eye(len(square)))
    return size * np.sqrt(np.diag(inverse))
