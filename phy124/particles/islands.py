"""Finds the separate pieces of an object, such as two balls or the links of a chain.

Two surfaces belong to separate pieces if at least one empty voxel lies between them everywhere, and
if each of the surfaces encloses a cavity by itself. Other surfaces may be the two sides of a wall,
or parts of a captured surface with gaps.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

CONNECTED = np.ones((3, 3, 3))
"""Voxels are connected by faces, edges and corners, so that a thin slanted sheet stays whole."""
LEAST = 0.01
"""Smallest fraction of an object in a separate piece: of its surface, and of its volume."""
CELLS = 4
"""Smallest volume of a separate piece [cells]. Smaller pieces share the nodes of other pieces."""


def open_gaps(region: Mask, occupied: Mask, fill: Callable[[Mask], Mask | None]) -> Mask:
    """Return the voxels inside an object without the material that seals gaps between its pieces.

    Args:
        region: Voxels inside the object, found from all surfaces together [X,Y,Z].
        occupied: Voxels with surface [X,Y,Z].
        fill: Returns the voxels inside a closed surface; None for another surface.
    """
    insides = [fill(surface) for surface in _find_surfaces(occupied)]
    closed = [inside for inside in insides if inside is not None]
    if len(closed) < 2:
        return region
    filled: Mask = np.logical_or.reduce(closed)
    rest, number = scipy.ndimage.label(region & ~filled, CONNECTED)  # pyright: ignore
    kept = np.zeros(number + 1, bool)
    kept[rest[occupied]] = True
    kept[0] = False
    opened: Mask = (region & filled) | kept[rest]
    return opened


def _find_surfaces(occupied: Mask) -> Iterator[Mask]:
    """Yield the voxels of each large connected surface; nothing if all voxels are connected."""
    labels, number = scipy.ndimage.label(occupied, CONNECTED)  # pyright: ignore
    sizes = np.bincount(labels.ravel())[1:]
    for k in np.flatnonzero(sizes >= LEAST * sizes.sum()) if number > 1 else ():
        yield labels == k + 1


@dataclass(frozen=True, eq=False)
class Islands:
    """The separate pieces of an object."""

    first: NDArray[np.int64]
    """Index of the grid's first voxel [3]."""
    voxel: float
    """Side of a voxel [m]."""
    labels: NDArray[np.int64]
    """Number of the nearest piece at each voxel [X,Y,Z]."""
    number: int
    """Number of pieces that move independently."""
    small: int
    """Number of pieces that are too small to move independently."""

    def at(self, x: NDArray) -> NDArray[np.int32]:
        """Return the number of the nearest piece at positions x [M,3], m."""
        index = np.floor(x / self.voxel).astype(np.int64) - self.first
        index = np.clip(index, 0, np.array(self.labels.shape) - 1)
        return self.labels[tuple(index.T)].astype(np.int32)

    def notes(self) -> list[str]:
        """Return a note if the object consists of several pieces."""
        notes = []
        if self.number > 1:
            notes.append(
                f"The object consists of {self.number} separate pieces, which move independently."
            )
        if self.small:
            notes.append(
                f"{self.small} separate pieces of the object are smaller than {CELLS} cells; each "
                "is joined to the nearest piece if it is closer than two cells. A larger "
                "accuracy.cells lets them move independently."
            )
        return notes


def find_islands(
    first: NDArray[np.int64], voxel: float, fraction: NDArray[np.float32], dx: float
) -> Islands:
    """Return the separate pieces of an object. A small piece belongs to the nearest large piece.

    Args:
        first: Index of the grid's first voxel [3].
        voxel: Side of a voxel [m].
        fraction: Filled fractions of the voxels [X,Y,Z].
        dx: Side of the cells in which small pieces are measured [m].
    """
    labels, number = scipy.ndimage.label(fraction > 0, CONNECTED)  # pyright: ignore
    if number < 2:
        return Islands(first, voxel, np.zeros(labels.shape, np.int64), 1, 0)
    volume = np.bincount(labels.ravel(), fraction.ravel())[1:] * voxel**3
    visible = volume >= LEAST * volume.sum()
    large = visible & (volume >= CELLS * dx**3)
    large[np.argmax(volume)] = True
    labels = np.append(-1, np.where(large, np.cumsum(large) - 1, -1))[labels]
    nearest = scipy.ndimage.distance_transform_edt(
        labels < 0, return_distances=False, return_indices=True
    )
    small = int((visible & ~large).sum())
    return Islands(first, voxel, labels[tuple(nearest)], int(large.sum()), small)
