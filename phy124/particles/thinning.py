"""Reduces the number of Gaussians; the remaining Gaussians are enlarged to cover the same area.

The object keeps its size and nearly its volume.
"""

import inspect
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.content import MOST_KEPT
from phy124.particles.cleaning import clean, compute_bounds
from phy124.particles.extent import keep_extent
from phy124.particles.solid import find_interior
from phy124.particles.surface import shortest_axes

FEW = 0.5
"""A note is shown if a generator makes fewer Gaussians than this fraction of the number."""
FEWEST, MOST = 100, MOST_KEPT
GIANT = 1e4
"""A Gaussian with a larger area, relative to the median, counts as background or as an error."""
BITS = 16
CHANGED = 0.02
"""A note is shown if the object's volume changes by more than this fraction."""


def check_count(count: int | None) -> None:
    """Check a requested number of Gaussians.

    Raises:
        InputError: If the number is outside the range from `FEWEST` to `MOST`.
    """
    if count is not None and not FEWEST <= count <= MOST:
        limit = f"it must be from {FEWEST} to {MOST:,}."
        raise InputError("gaussians", count, limit, "Write, for example, 20000.")


def with_count(make: Any, count: int | None) -> Any:
    """Bind `count` to a generator's function that has this option."""
    check_count(count)
    if count is None or "count" not in inspect.signature(make).parameters:
        return make
    return partial(make, count=count)


def note_few(make: Any, made: int, count: int | None) -> list[str]:
    """Return a note if a generator with the option `count` made much fewer Gaussians."""
    if count is None or made > FEW * count or "count" not in inspect.signature(make).parameters:
        return []
    return [
        f"The generator made {made:,} Gaussians instead of {count:,}: --gaussians is approximate."
    ]


def thin(gaussians: Gaussians, count: int | None, *, seed: int = 0) -> Gaussians:
    """Keep at most `count` Gaussians, enlarged to cover the original area.

    The kept Gaussians are evenly spaced along a space-filling curve, weighted by opacity and area.
    Areas are limited to `GIANT`. Flat Gaussians keep their thickness, because thick ones would
    move the faces of the object.
    """
    if count is None or len(gaussians) <= count:
        return gaussians
    areas = _compute_areas(gaussians)
    largest = GIANT * np.median(areas)
    weight = gaussians.opacities * np.sqrt(np.minimum(areas, largest)) + 1e-30
    along = np.argsort(_morton_order(gaussians.means), kind="stable")
    ends = np.cumsum(weight[along])
    steps = (np.arange(count) + np.random.default_rng(seed).random()) / count * ends[-1]
    chosen = np.unique(along[np.searchsorted(ends, steps)])
    cover = np.where(areas <= largest, gaussians.opacities * areas, 0)
    covered, left = float(cover.sum()), float(cover[chosen].sum())
    growth = np.sqrt(covered / left) if left > 0 else 1.0
    kept = gaussians.select(chosen)
    shortest = kept.scales == kept.scales.min(axis=1, keepdims=True)
    is_flat = shortest_axes(kept).any(axis=1, keepdims=True)
    scales = np.where(is_flat & shortest, kept.scales, kept.scales * growth)
    return keep_extent(replace(kept, scales=scales), gaussians, kept.deviations())


def note_volume(before: Gaussians, after: Gaussians) -> list[str]:
    """Return a note if `thin` changed the object's volume noticeably.

    Raises:
        InputError: If no visible Gaussian is left.
    """
    if after is before:
        return []
    first, last = (_relative_volume(clean(gaussians)[0]) for gaussians in (before, after))
    change = last / first - 1 if first > 0 else 0.0
    if abs(change) <= CHANGED:
        return []
    more = "larger" if change > 0 else "smaller"
    return [
        f"With {len(after):,} of {len(before):,} Gaussians, the object's volume and mass are "
        f"{abs(change):.1%} {more}. Give --gaussians a larger number."
    ]


def _relative_volume(gaussians: Gaussians) -> float:
    """Return the volume of the solid, relative to the cube of its longest side."""
    low, high = compute_bounds(gaussians)
    return find_interior(gaussians).volume / float((high - low).max()) ** 3


def _morton_order(points: NDArray[np.float32]) -> NDArray[np.int64]:
    low, size = points.min(axis=0), float(np.ptp(points, axis=0).max()) or 1.0
    cells = ((points - low) / size * (2**BITS - 1)).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            code |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return code


def _compute_areas(gaussians: Gaussians) -> NDArray[np.float64]:
    """Return the product of the two larger standard deviations of each Gaussian [N], m^2."""
    return np.sort(gaussians.scales, axis=1)[:, 1:].prod(axis=1, dtype=np.float64)
