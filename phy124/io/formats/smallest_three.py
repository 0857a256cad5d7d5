"""Unit quaternions by their three smallest components, as most packed formats keep them.

The largest component is left out; since q and -q are one rotation it can be made positive, and is
the root of what the others' squares lack of 1. The others are at most 1 / sqrt 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Places of the components that stay, by the place of the one that is left out."""


def reduced(quats: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The three smallest components [N,3], and which one is left out [N]."""
    quats = np.asarray(quats, np.float64)
    which = np.abs(quats).argmax(axis=1)
    sign = np.where(np.take_along_axis(quats, which[:, None], 1) < 0, -1.0, 1.0)
    return np.take_along_axis(quats, OTHERS[which], 1) * sign, which


def completed(others: NDArray, which: NDArray) -> NDArray[np.float32]:
    """Unit quaternions [N,4] from three components [N,3] and which one was left out [N]."""
    which = np.asarray(which, np.int64)
    out = np.empty((len(others), 4), np.float32)
    np.put_along_axis(out, OTHERS[which], others.astype(np.float32), 1)
    rest = np.sqrt(np.maximum(1 - np.square(others).sum(axis=1), 0)).astype(np.float32)
    np.put_along_axis(out, which[:, None], rest[:, None], 1)
    return out
