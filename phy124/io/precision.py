"""How exactly a file can tell places apart, and where float32 would lose what it says.

float32 has 24 bits: 4,600 km from the origin, where Earth-centred captures lie, its values are half
a metre apart. Centres are therefore kept about an origin of their own where that matters, which is
subtracted in double precision.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FAR = 4
"""Distance from the origin, in sizes of the object, beyond which float32 blurs double precision."""
FINE = 20_000
"""Steps of float32 across an object that are enough for it to stay where it is."""
COARSE = 4000
"""Steps across an object below which a file is called coarse."""
ENOUGH = 100_000
"""Centres that are looked at."""
LARGEST = 1e38
"""About the largest value of float32."""
ENDS = (1, 99)
"""Percentiles between which an object lies, so that single outliers do not count."""


def centred(means: NDArray) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Centres [N,3] about an origin [3], which is 0 unless float32 would blur them there."""
    middle, extent = _middle(means)
    blurred = extent < FINE * spacing(middle)
    if not step_of(means):
        blurred |= FAR * extent < np.abs(middle).max()
    origin = np.zeros(3)
    if blurred and extent > 0:
        # A multiple of a power of two, so that centres given in float32 lose nothing.
        unit = 2.0 ** np.ceil(np.log2(extent))
        origin = np.rint(middle / unit) * unit
    with np.errstate(over="ignore", invalid="ignore"):
        near = means.astype(np.float64) - origin if origin.any() else means
        return near.astype(np.float32), origin


def in_place(means: NDArray[np.float32], origin: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Centres [N,3] that are given about an origin [3]; None if float32 would blur them there."""
    there = means.astype(np.float64) + origin
    found = there.astype(np.float32)
    middle, extent = _middle(there)
    exact = np.array_equal(found, there)
    return found if exact or extent >= FINE * spacing(middle) else None


def step_of(means: NDArray) -> float:
    """Distance of neighbouring values where centres [N,3] are float32 numbers, else 0."""
    some = _some(means)
    if not len(some) or not np.array_equal(some, some.astype(np.float32)):
        return 0.0
    return spacing(_middle(means)[0])


def too_coarse(means: NDArray, step: float) -> str | None:
    """A sentence if an object is so small that a file's steps show; else None.

    Args:
        means: Centres [N,3], from any origin.
        step: Distance of neighbouring values in the file.
    """
    extent = _middle(means)[1]
    if not step or extent >= COARSE * step or len(means) < 2:
        return None
    across = max(round(extent / step), 1)
    return (
        f"The file's places come in steps of {step:.2g}, about {across:,} across the object: its "
        "numbers are too coarse there. Export it in double precision, or nearer to the origin."
    )


def spacing(place: NDArray) -> float:
    """Distance of neighbouring float32 values at a place [3], along its farthest axis."""
    return float(np.spacing(np.float32(np.abs(place).max())))


def _middle(means: NDArray) -> tuple[NDArray[np.float64], float]:
    """Where an object lies [3], and the longest of its sides."""
    some = _some(means)
    if not len(some):
        return np.zeros(3), 0.0
    low, middle, high = np.percentile(some, [ENDS[0], 50, ENDS[1]], axis=0)
    return middle, float((high - low).max())


def _some(means: NDArray) -> NDArray[np.float64]:
    """Centres that float32 can hold, all over the file."""
    some = means[:: max(1, len(means) // ENOUGH)].astype(np.float64)
    return some[(np.abs(some) < LARGEST).all(axis=1)]
