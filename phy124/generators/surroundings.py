"""Detects whether a file of Gaussians shows a background or a sky besides an object.

With surroundings, the bounding box would be too large, and the object would move together with its
surroundings.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.particles import clean, visible_area

SAMPLE = 100_000
"""Number of Gaussians that are examined."""
MOST = 0.8
"""Fraction that is assumed to belong to the object: of the visible area or, if there is a sky, of
the Gaussians that do not belong to the sky.
"""
SMALL = 0.3
"""A background is reported if the object's longest side is below this fraction of the box around
all Gaussians.
"""
AROUND = 1.25
"""Size of the recommended crop box, relative to the object."""
TAIL = 1e-3
"""Fraction of the Gaussians that is ignored as outliers at each end of each axis."""
ROUNDS = 4
"""Number of iterations for the object's centre."""
FAR = 3.0
"""Smallest distance of a sky from the centre, relative to the object's radius."""
THIN = 0.2
"""Largest standard deviation of a sky's distances from the centre, relative to their mean."""
MANY = 0.01
"""Smallest fraction of the Gaussians that belong to a sky.

At least seven of the eight octants must also contain this fraction of the sky's Gaussians.
"""


def surroundings(
    gaussians: Gaussians, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> list[str]:
    """Return sentences about an object's surroundings, and the `--crop` option that removes them.

    The Gaussians and their `origin` [3] have the axes and units of the file.
    """
    visible = np.flatnonzero(gaussians.longest > 0)
    if not len(visible):
        return []
    some, _ = clean(gaussians.select(visible[:: 1 + len(visible) // SAMPLE]))
    means = some.means.astype(np.float64)
    around = _sky(means) or _place(means, visible_area(some))
    if around is None:
        return []
    box = ",".join(format_corners(np.array(around.box) + origin))
    return [f"{around.words} --crop={box} removes the surroundings."]


def format_corners(corners: NDArray[np.float64]) -> tuple[str, str]:
    """Return the two corners [2,3] of a box as text, rounded to a hundredth of its longest side."""
    side, largest = np.ptp(corners, axis=0).max(), np.abs(corners).max()
    digits = max(4, 3 + math.ceil(math.log10(largest / side))) if side > 0 else 4
    low, high = (",".join(f"{value:.{digits}g}" for value in corner) for corner in corners)
    return low, high


class _Around(NamedTuple):
    words: str
    box: tuple[NDArray[np.float64], NDArray[np.float64]]
    """Lower and upper corner [3], [3] of the crop box."""


def _sky(means: NDArray[np.float64]) -> _Around | None:
    """Find a sky: a shell of centres [N,3] far around the other Gaussians."""
    places = means - np.median(means, axis=0)
    distances = np.linalg.norm(places, axis=1)
    far = distances > np.quantile(distances, 1 - MANY / 2) / 2
    if far.mean() < MANY or far.all():
        return None
    shell, reach = distances[far], float(np.quantile(distances[~far], MOST))
    octants = np.bincount((places[far] > 0) @ [1, 2, 4], minlength=8) >= MANY * far.sum()
    if shell.min() < FAR * reach or shell.std() > THIN * shell.mean() or octants.sum() < 7:
        return None
    low, high = np.quantile(means[~far], [TAIL, 1 - TAIL], axis=0)
    grown = (AROUND - 1) / 2 * (high - low).max()
    words = (
        f"{far.mean():.0%} of the Gaussians surround all others like a sky, "
        f"{shell.mean() / reach:.0f} times as far out as most of the others. They are treated as "
        "a part of the object."
    )
    return _Around(words, (low - grown, high + grown))


def _place(means: NDArray[np.float64], seen: NDArray) -> _Around | None:
    """Find a background around centres [N,3] with the visible areas `seen` [N]."""
    low, high = _part(means, seen)
    whole = np.ptp(np.quantile(means, [TAIL, 1 - TAIL], axis=0), axis=0).max()
    side = float((high - low).max())
    if not 0 < side < SMALL * whole:
        return None
    grown = (AROUND - 1) / 2 * side
    words = (
        f"A box with {side / whole:.0%} of the longest side contains {MOST:.0%} of the visible "
        "area, but all Gaussians are treated as the object."
    )
    return _Around(words, (low - grown, high + grown))


def _part(
    means: NDArray[np.float64], seen: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the corners of a small box that contains the fraction `MOST` of the visible area."""
    part = np.ones(len(means), bool)
    for _ in range(ROUNDS):
        middle = np.array([_median(axis, seen[part]) for axis in means[part].T])
        reach = np.abs(means - middle).max(axis=1)
        order = np.argsort(reach)
        enough = int(np.searchsorted(np.cumsum(seen[order]), MOST * seen.sum()))
        part = reach <= reach[order[min(enough, len(order) - 1)]]
    return means[part].min(axis=0), means[part].max(axis=0)


def _median(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[int(np.searchsorted(total, total[-1] / 2))]])
