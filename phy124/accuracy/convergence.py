"""Orders of convergence, and Richardson's estimate of the remaining error of each level.

The result at grid spacing h is modelled as exact + h^p e + scatter h^p, with a field e common to
all grids and a random part. The distance of two levels is then about C |h_i^p - h_j^p|, from which
p follows (logarithms, all pairs). exact and e are fitted to all levels with weights h^-2p; the
error of a level is h^p e plus the scatter (Richardson 1911; Roache 1998; a least-squares fit as in
Eca, Hoekstra 2014). Only the distances between the levels are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

ORDERS = (0.5, 3.0)
"""Range in which the order is searched."""
TRUSTED = (1.0, 2.0)
"""Range of orders used to estimate errors: free surfaces are of first order, the inside of second.

Levels that are too coarse show a lower order, which would make the errors guesses.
"""
SAFETY = 1.25
"""Factor on errors if the observed order is more than `NEAR` outside this range (Roache 1998)."""
NEAR = 0.1
AGREE = 1e-5
"""Distance, in the unit of the results, below which levels are equal up to rounding."""


@dataclass(frozen=True)
class Convergence:
    """Order and errors of three or more levels, estimated from the distances between them."""

    order: float | None
    """Observed order; None if the levels do not converge."""
    errors: tuple[float, ...] = ()
    """Estimated error of each level, in the unit of the distances; empty if there is none."""
    why_not: str = ""
    """Why there are no errors."""
    note: str = ""
    """Why the errors are only rough."""
    exact: tuple[float, ...] = ()
    """Weights of the levels in the extrapolated result; they sum to 1."""
    inside: float = 0.0
    """Mean square distance of the levels from that result, with these weights."""
    factor: float = 1.0
    """Safety factor."""

    @property
    def error(self) -> float | None:
        """Error of the finest level."""
        return self.errors[-1] if self.errors else None

    def error_of(self, apart: NDArray) -> float | None:
        """Return the error of any result from its distances to the levels [L]; None if unknown."""
        if not self.exact:
            return None
        square = float(apart**2 @ np.array(self.exact)) - self.inside
        return self.factor * float(np.sqrt(max(square, 0.0)))


def fit_order(spacings: Sequence[float], errors: Sequence[float]) -> float:
    """Return the slope of log error over log spacing by least squares, for exact errors."""
    return float(np.polyfit(np.log(spacings), np.log(np.abs(errors)), 1)[0])


def richardson(spacings: Sequence[float], apart: NDArray, *, agree: float = AGREE) -> Convergence:
    """Estimate the order, and the error of each of three or more levels.

    Args:
        spacings: Grid spacings, from coarse to fine [L].
        apart: Distances between the levels' results [L,L].
        agree: Distance below which levels count as equal; the largest distance is then the error.
    """
    h, levels = np.array(spacings), len(spacings)
    if levels < 3:
        return Convergence(None, why_not="fewer than three levels: no order can be observed")
    if apart.max() < agree:
        exact, error = (*[0.0] * (levels - 1), 1.0), float(apart.max())
        note = "all levels agree: this motion does not depend on the grid"
        return Convergence(None, (error,) * levels, note=note, exact=exact)
    if apart[-2, -1] >= apart[0, -1] or not apart[np.triu_indices(levels, 1)].all():
        return Convergence(None, why_not="not converging: finer grids do not come closer")
    observed = _observe_order(h, apart)
    trusted = float(np.clip(observed, *TRUSTED))
    fit = _fit(h, apart, trusted)
    if abs(observed - trusted) > NEAR:
        note = f"the observed order is outside {TRUSTED[0]:g} to {TRUSTED[1]:g}: errors are rough"
        errors = tuple(SAFETY * error for error in fit.errors)
        fit = replace(fit, errors=errors, factor=SAFETY, note=note)
    return replace(fit, order=observed)


def longest_convergence(
    spacings: Sequence[float], clips: Sequence[NDArray], size: float = 1.0
) -> tuple[Convergence, int]:
    """Estimate the errors over as many of the first frames as converge.

    Levels that follow different paths after some event, as when one topples and another does not,
    still converge until then.

    Args:
        spacings: Grid spacings, from coarse to fine [L].
        clips: Positions [F,N,3] of the same points on each level.
        size: Divisor of the distances.

    Returns:
        The convergence and the number of frames it holds for; all frames if no beginning converges.
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
        # At the lowest order searched, the finest grids are hardly closer than the coarsest.
        if start.errors and (start.order is None or start.order > ORDERS[0]):
            return start, count
    return whole, frames


def _observe_order(h: NDArray, apart: NDArray) -> float:
    """Return the p for which the distances of all pairs are closest to C |h_i^p - h_j^p|."""
    orders, pairs = np.linspace(*ORDERS, 251), np.triu_indices(len(h), 1)
    power = h[:, None] ** orders
    ratio = np.log(apart[pairs][:, None] / (power[pairs[0]] - power[pairs[1]]))
    return float(orders[ratio.std(axis=0).argmin()])


def _fit(h: NDArray, apart: NDArray, p: float) -> Convergence:
    """Fit exact + h^p e to the levels."""
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
    """Return the mean squares of combinations of levels [K,L] whose weights sum to zero."""
    return np.maximum(-0.5 * np.einsum("ki,ij,kj->k", rows, apart**2, rows), 0.0)


def distances(results: Sequence[NDArray]) -> NDArray[np.float64]:
    """Return the RMS distances [L,L] between results [...,3] of the same points."""
    apart = np.zeros((len(results), len(results)))
    for i, j in combinations(range(len(results)), 2):
        gap = results[i].astype(np.float64) - results[j]
        apart[i, j] = apart[j, i] = np.sqrt((gap**2).sum(axis=-1).mean())
    return apart


def guess_errors(
    spacings: tuple[float, float], difference: float, order: float
) -> tuple[float, float]:
    """Guess the errors of two levels from their difference and an assumed order."""
    coarse, fine = (h**order for h in spacings)
    error = difference * fine / (coarse - fine)
    return error + difference, error
