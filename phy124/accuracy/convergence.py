"""Orders of convergence, and Richardson's estimate of what the finest level still lacks.

For an error C h^p at grid spacing h, two levels are C |h_i^p - h_j^p| apart. C and p are fitted
to the distances of all pairs of levels (logarithms, least squares), and C h^p of the finest is
its own error (Richardson 1911; Roache 1998; the fit as in Eca, Hoekstra 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

ORDERS = (0.5, 3.0)
"""Orders are held to this range: a lower one makes every error a guess."""
AGREE = 1e-5
"""Distance, in the unit of the results, below which levels agree within rounding."""
MISFIT = 0.35
"""RMS of log(distance / fit) from which the levels scatter too much for a good estimate."""


@dataclass(frozen=True)
class Convergence:
    """What three or more levels say about their own errors."""

    order: float | None
    """Observed order; None if the levels do not converge."""
    error: float | None
    """Estimated error of the finest level, in the unit of the distances."""
    why_not: str = ""
    """Why there is no number, in words."""
    note: str = ""
    """Why the number is a rough one, in words."""


def fitted_order(spacings: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of log error over log spacing, by least squares: where errors are known exactly."""
    return float(np.polyfit(np.log(spacings), np.log(np.abs(errors)), 1)[0])


def richardson(spacings: Sequence[float], apart: NDArray, *, agree: float = AGREE) -> Convergence:
    """Order and own error of the finest of three or more levels.

    Args:
        spacings: From coarse to fine [L].
        apart: Distances between the levels' results [L,L].
        agree: Levels closer than this agree, and their greatest distance is the error.
    """
    h, pairs = np.array(spacings), np.triu_indices(len(spacings), 1)
    if len(h) < 3:
        return Convergence(None, None, "fewer than three levels: no order can be observed")
    to_finest, measured = apart[:-1, -1], apart[pairs]
    if measured.max() < agree:
        note = "all levels agree: this motion does not depend on the grid"
        return Convergence(None, float(measured.max()), note=note)
    if not np.all(measured > 0) or not np.all(np.diff(to_finest) < 0):
        return Convergence(None, None, "not converging: finer grids do not come closer")
    orders = np.linspace(*ORDERS, 251)
    power = h[:, None] ** orders
    ratio = np.log(measured[:, None] / (power[pairs[0]] - power[pairs[1]]))
    misfit = ratio.std(axis=0)
    best = int(misfit.argmin())
    scale = np.exp(ratio[:, best].mean())
    note = ""
    if best in (0, len(orders) - 1):
        note = f"the observed order is outside {ORDERS[0]:g} to {ORDERS[1]:g}: errors are rough"
    elif misfit[best] > MISFIT:
        note = "the levels scatter about one order: errors are rough"
    return Convergence(float(orders[best]), float(scale * power[-1, best]), note=note)


def distances(results: Sequence[NDArray]) -> NDArray[np.float64]:
    """RMS distances [L,L] between results [...,3] of the same points."""
    apart = np.zeros((len(results), len(results)))
    for i, j in combinations(range(len(results)), 2):
        gap = results[i].astype(np.float64) - results[j]
        apart[i, j] = apart[j, i] = np.sqrt((gap**2).sum(axis=-1).mean())
    return apart


def extrapolated(
    spacings: tuple[float, float], difference: float, order: float
) -> tuple[float, float]:
    """Errors of two levels from their difference, for an assumed order: a first guess."""
    coarse, fine = (h**order for h in spacings)
    error = difference * fine / (coarse - fine)
    return error + difference, error
