"""Estimates the order of convergence, and the discretisation error of each grid level.

The result at grid spacing h is modelled as u + h^p e + h^p s. The exact result u and the field e
are common to all grids, and the scatter s is random. The results of two levels i and j then differ
by about C abs(h_i^p - h_j^p), with a constant C. The order p is fitted to the logarithms of the
distances between all pairs of levels. The fields u and e are fitted to all levels by least squares
with weights h^-2p (Eca, Hoekstra 2014). The error of a level is h^p e + h^p s (Richardson 1911;
Roache 1998). Only the distances between the levels are needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

ORDERS = (0.5, 3.0)
"""Smallest and largest order of convergence that is searched for."""
TRUSTED = (1.0, 2.0)
"""Range of convergence orders that may be used to estimate errors.

Free surfaces converge with first order, and the interior with second order. On grids that are too
coarse, the measured order is below 1, and errors estimated with this order are unreliable.
"""
SAFETY = 1.25
"""Factor on the errors if the order is outside `TRUSTED` by more than `NEAR` (Roache 1998)."""
NEAR = 0.1
AGREE = 1e-5
"""Two results count as equal if the distance between them is at most this value, in the unit of the
results."""


@dataclass(frozen=True)
class Convergence:
    """Order of convergence and errors of grids (levels), from distances between their results."""

    order: float | None
    """Observed order of convergence. It is None if the results on the grids do not converge, or if
    they all agree."""
    errors: tuple[float, ...] = ()
    """Estimated error on each grid, in the unit of the distances; empty without an estimate."""
    why_not: str = ""
    """Reason why there is no estimate of the errors."""
    note: str = ""
    """Remark on the estimated errors, such as the reason why they are only rough."""
    exact: tuple[float, ...] = ()
    """Weights of the grids' results in the extrapolated result; the weights sum to 1."""
    inside: float = 0.0
    """Mean, weighted by `exact`, of the square distances between the grids' results and the
    extrapolated result."""
    factor: float = 1.0
    """Safety factor by which the errors are multiplied."""

    @property
    def error(self) -> float | None:
        """Estimated error on the finest grid; None if there is no estimate."""
        return self.errors[-1] if self.errors else None

    def error_of(self, apart: NDArray) -> float | None:
        """Estimate the error of a result from its distances to the results on all grids [L].

        Returns:
            The error, or None if there is no extrapolated result.
        """
        if not self.exact:
            return None
        square = float(apart**2 @ np.array(self.exact)) - self.inside
        return self.factor * float(np.sqrt(max(square, 0.0)))


def fit_order(spacings: Sequence[float], errors: Sequence[float]) -> float:
    """Return the order of convergence of grids whose errors are known.

    The order is the slope of a straight line, fitted by least squares, in a log-log plot of the
    error over the spacing.
    """
    return float(np.polyfit(np.log(spacings), np.log(np.abs(errors)), 1)[0])


def richardson(spacings: Sequence[float], apart: NDArray, *, agree: float = AGREE) -> Convergence:
    """Estimate the order of convergence and the error on each grid, from three or more grids.

    Args:
        spacings: Grid spacings, from coarse to fine [L].
        apart: Distance between the results of each pair of levels [L,L].
        agree: Levels count as equal if the distance between them is at most this value. If all
            levels are equal, the error is the largest distance between them.
    """
    h, levels = np.array(spacings), len(spacings)
    if levels < 3:
        return Convergence(None, why_not="fewer than three levels: no order can be observed")
    if apart.max() < agree:
        exact, error = (*[0.0] * (levels - 1), 1.0), float(apart.max())
        note = "all levels agree: this motion does not depend on the grid"
        return Convergence(None, (error,) * levels, note=note, exact=exact)
    if apart[-2, -1] >= apart[0, -1] or not apart[np.triu_indices(levels, 1)].all():
        return Convergence(
            None, why_not="no convergence: results on finer grids are no closer together"
        )
    observed = _observe_order(h, apart)
    trusted = float(np.clip(observed, *TRUSTED))
    fit = _fit(h, apart, trusted)
    if abs(observed - trusted) > NEAR:
        note = (
            f"the observed order is outside {TRUSTED[0]:g} to {TRUSTED[1]:g}, "
            "so the errors are rough estimates"
        )
        errors = tuple(SAFETY * error for error in fit.errors)
        fit = replace(fit, errors=errors, factor=SAFETY, note=note)
    return replace(fit, order=observed)


def longest_convergence(
    spacings: Sequence[float], clips: Sequence[NDArray], size: float = 1.0
) -> tuple[Convergence, int]:
    """Estimate the errors on several grids from the initial part of the clips.

    The longest part is used in which the results on finer grids converge.

    The motions on two grids may become different, for example if the object topples on only one of
    the grids. As long as the motions agree, the results on finer grids converge.

    Args:
        spacings: Grid spacings, from coarse to fine [L].
        clips: Positions [F,N,3] of the same points on each level.
        size: Length by which all distances are divided.

    Returns:
        The convergence, and the number of frames for which it holds. If the levels converge in no
        initial part, the result for all frames is returned.
    """
    frames = len(clips[0])
    square = np.zeros((frames, len(clips), len(clips)))
    for i, j in combinations(range(len(clips)), 2):
        gap = (clips[i].astype(np.float64) - clips[j]) / size
        square[:, i, j] = square[:, j, i] = (gap**2).sum(axis=-1).mean(axis=-1)
    apart = np.sqrt(np.cumsum(square, axis=0) / np.arange(1, frames + 1)[:, None, None])
    whole = richardson(spacings, apart[-1])
    if len(clips) < 3:
        return whole, frames
    for count in range(frames, 1, -1):
        start = richardson(spacings, apart[count - 1])
        # At the lowest order, the distances between levels hardly decrease with the spacing.
        if start.errors and (start.order is None or start.order > ORDERS[0]):
            return start, count
    return whole, frames


def _observe_order(h: NDArray, apart: NDArray) -> float:
    """Return the order p for which C |h_i^p - h_j^p| best fits the distances of pairs of grids."""
    orders, pairs = np.linspace(*ORDERS, 251), np.triu_indices(len(h), 1)
    power = h[:, None] ** orders
    ratio = np.log(apart[pairs][:, None] / (power[pairs[0]] - power[pairs[1]]))
    return float(orders[ratio.std(axis=0).argmin()])


def _fit(h: NDArray, apart: NDArray, p: float) -> Convergence:
    """Fit the model u + h^p e to the results on the grids of spacing h, for a fixed order p."""
    power = h**p
    columns = np.stack([np.ones(len(h)), power], axis=1)
    weighted = columns / power[:, None] ** 2
    exact, field = np.linalg.solve(columns.T @ weighted, weighted.T)
    rest = np.eye(len(h)) - columns @ np.stack([exact, field])
    scatter = (_squares(rest, apart) / power**2).sum() / (len(h) - 2)
    errors = power * np.sqrt(_squares(field[None], apart)[0] + scatter)
    inside = 0.5 * float(exact @ apart**2 @ exact)
    return Convergence(p, tuple(errors.tolist()), exact=tuple(exact.tolist()), inside=inside)


def _squares(rows: NDArray, apart: NDArray) -> NDArray[np.float64]:
    """Return the mean squares [K] of K linear combinations of the L results.

    Each row of `rows` [K,L] contains the weights of one combination, which sum to 0.
    """
    return np.maximum(-0.5 * np.einsum("ki,ij,kj->k", rows, apart**2, rows), 0.0)


def distances(results: Sequence[NDArray]) -> NDArray[np.float64]:
    """Return the RMS distances [L,L] between L results with the same points [...,3]."""
    apart = np.zeros((len(results), len(results)))
    for i, j in combinations(range(len(results)), 2):
        gap = results[i].astype(np.float64) - results[j]
        apart[i, j] = apart[j, i] = np.sqrt((gap**2).sum(axis=-1).mean())
    return apart


def guess_errors(
    spacings: tuple[float, float], difference: float, order: float
) -> tuple[float, float]:
    """Return the errors on two grids (coarse, fine) from the distance of their results.

    The order of convergence is assumed.
    """
    coarse, fine = (h**order for h in spacings)
    error = difference * fine / (coarse - fine)
    return error + difference, error
