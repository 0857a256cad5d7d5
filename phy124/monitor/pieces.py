"""Pieces: which particles are still connected to those they were connected to at rest.

Space is divided into cubes. Particles in the same cube, or in cubes that touch, are connected; an
empty layer of cubes separates two pieces.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

FAR = 4096
"""Number of cubes along an axis above which empty space is left out before labelling."""
MOST = 50_000_000
"""Largest number of cubes to label; particles more scattered than that form no pieces."""


class Pieces:
    """The pieces that particles at rest, `rest` [P,3] m, form with cubes of a side [m].

    Particles of different objects, `object_id` [P], are never of one piece.
    """

    def __init__(self, rest: NDArray, side: float, object_id: NDArray | None = None) -> None:
        self._side, self._object = side, object_id
        self._body = labels(self._apart(rest), side)
        if self._body is not None:
            self._sizes = np.bincount(self._body)

    def loose(self, x: NDArray) -> int:
        """Number of particles that are not in the largest part of the piece they belonged to.

        Args:
            x: Current positions [P,3], m.
        """
        now = labels(self._apart(x), self._side)
        if now is None or self._body is None or now.max() == 0:
            return 0
        pairs, counts = np.unique(self._body * (now.max() + 1) + now, return_counts=True)
        largest = np.zeros(len(self._sizes), int)
        np.maximum.at(largest, pairs // (now.max() + 1), counts)
        return int((self._sizes - largest).sum())

    def _apart(self, x: NDArray) -> NDArray:
        """The particles with those of each object moved away from the others."""
        if self._object is None or not np.isfinite(x).all():
            return x
        moved = x.astype(np.float64)
        moved[:, 0] += self._object * (np.ptp(moved[:, 0]) + 3 * self._side)
        return moved


def labels(x: NDArray, side: float) -> NDArray[np.int64] | None:
    """The number of each particle's piece [P]; None if they are scattered too far.

    Args:
        x: Positions [P,3], m.
        side: Side of a cube [m].
    """
    if len(x) == 0 or not np.isfinite(x).all():
        return None
    columns = [_cubes(column, side) for column in x.T]
    size = tuple(int(column.max()) + 1 for column in columns)
    if math.prod(size) > MOST:
        return None
    at = (columns[0] * size[1] + columns[1]) * size[2] + columns[2]
    occupied = np.zeros(size, bool)
    occupied.reshape(-1)[at] = True
    numbered, count = scipy.ndimage.label(occupied, np.ones((3, 3, 3)))  # pyright: ignore
    if count == 1:
        return np.zeros(len(x), np.int64)
    found: NDArray[np.int64] = numbered.reshape(-1)[at].astype(np.int64) - 1
    return found


def _cubes(column: NDArray, side: float) -> NDArray[np.int64]:
    """Index of each particle's cube along one axis, from 0.

    If they are scattered far, gaps are narrowed to two cubes, which keeps pieces apart.
    """
    places = (column - column.min()) / side
    if places.max() < FAR:
        return places.astype(np.int64)
    found, which = np.unique(np.floor(places), return_inverse=True)
    steps = np.minimum(np.diff(found, prepend=found[:1]), 2)
    return np.cumsum(steps).astype(np.int64)[which.reshape(-1)]
