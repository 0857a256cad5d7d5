"""Estimates the order of convergence, and the discretisation error of each grid level.

The result at grid spacing h is modelled as u + h^p e + h^p s. The exact result u and the field e
are common to all grids, and the scatter s is random. The results of two levels i and j then differ
by about C abs(h_i^p - h_j^p). The order p is fitted to these differences. The fields u and e are
fitted by least squares with weights h^-2p (Eca, Hoekstra 2014). The error of a level is h^p e + h^p
s (Richardson 1911; Roache 1998).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

ORDERS = (0.5, 3.0)
TRUSTED = (1.0, 2.0)
"""Range of orders that may be used to estimate errors.

Free surfaces converge with first order, and the interior with second order. On grids that are too
coarse, errors estimated with the measured order are unreliable.
"""
SAFETY = 1.25
"""Factor on the errors if the order is outside `TRUSTED` by more than `NEAR` (Roache 1998)."""
NEAR = 0.1
AGREE = 1e-5
"""Largest distance between results that count as equal."""


@dataclass(frozen=True)
class Convergence:
    """Order of convergence and errors of grids (levels)."""

    order: float | None
    """Observed order; None without convergence, or if all results agree."""
    errors: tuple[float, ...] = ()
    """Estimated error on each grid, or empty."""
    why_not: str = ""
    note: str = ""
    """Remark, such as the reason why the errors are rough."""
    exact: tuple[float, ...] = ()
    """Weights of the grids' results in the extrapolated result, with the sum 1."""
    inside: float = 0.0
    """Mean square distance of the grids' results from the extrapolated result, weighted by
    `exact`.
    """
    factor: float = 1.0
    """Safety factor on the errors."""

    @property
    def error(self) -> float | None:
        """Estimated error on the finest grid, or None."""
        return self.errors[-1] if self.errors else None

    def error_of(self, apart: NDArray) -> float | None:
        """Estimate the error of a result from its distances to the results on all grids [L]; None
        without an extrapolated result.
        """
        if not self.exact:
            return None
        square = float(apart**2 @ np.array(self.exact)) - self.inside
        return self.factor * float(np.sqrt(max(square, 0.0)))


def fit_order(spacings: Sequence[float], errors: Sequence[float]) -> float:
    """Return the order of convergence of grids with known errors: the slope in a log-log plot."""
    return float(np.polyfit(np.log(spacings), np.log(np.abs(errors)), 1)[0])


def richardson(spacings: Sequence[float], apart: NDArray, *, agree: float = AGREE) -> Convergence:
    """Estimate the order of convergence and the errors, from three or more grids.

    `spacings` [L] are ordered from coarse to fine, `apart` [L,L] are the distances between results.
    Distances up to `agree` count as zero.
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
    """Estimate the errors from the longest initial part of the clips in which the results converge.

    In later frames, the motions on two grids may differ, for example if the object topples on only
    one of the grids.

    Returns:
        The convergence, and the number of its frames; without convergence, the result for all
        frames.
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
    """Return the order p for which C |h_i^p - h_j^p| best fits the distances."""
    orders, pairs = np.linspace(*ORDERS, 251), np.triu_indices(len(h), 1)
    power = h[:, None] ** orders
    ratio = np.log(apart[pairs][:, None] / (power[pairs[0]] - power[pairs[1]]))
    return float(orders[ratio.std(axis=0).argmin()])


def _fit(h: NDArray, apart: NDArray, p: float) -> Convergence:
    """Fit the model u + h^p e for a fixed order p."""
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
    """Return the mean squares [K] of linear combinations of the results.

    Each row of `rows` [K,L] contains weights with the sum 0.
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
    """Return the errors on two grids (coarse, fine) for an assumed order."""
    coarse, fine = (h**order for h in spacings)
    error = difference * fine / (coarse - fine)
    return error + difference, error
