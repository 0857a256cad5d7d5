"""Smooth noise in space, by which the strength of a material varies from lump to lump."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

LENGTH = 0.3
"""Mean wavelength of the noise, relative to the longest side of the body."""
BAND = 0.7, 1.4
"""Smallest and largest wave number, relative to the wave number of the mean wavelength."""
WAVES = 24
"""Number of waves; the values of their sum are approximately normally distributed."""


def lumps(x: NDArray, low: NDArray, high: NDArray) -> NDArray[np.float64]:
    """Return noise of mean 0 and standard deviation 1 at points of a body [P].

    The noise depends only on the position in the body and on a fixed seed, so that the noise is the
    same at every accuracy, and continuous where the material changes.

    Args:
        x: Points [P,3], m.
        low: Lowest corner of the body's bounding box [3], m.
        high: Highest corner [3], m.
    """
    rng = np.random.default_rng(0)
    longest = float(np.max(high - low))
    directions = rng.standard_normal((WAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    numbers = 2 * np.pi / (LENGTH * max(longest, 1e-12)) * rng.uniform(*BAND, WAVES)
    phases = rng.uniform(0, 2 * np.pi, WAVES)
    waves = np.cos((x - low) @ (numbers[:, None] * directions).T + phases)
    return np.sqrt(2 / WAVES) * waves.sum(axis=1)
