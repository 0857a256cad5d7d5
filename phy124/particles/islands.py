"""Finds the separate pieces of an object, such as two balls or the links of a chain.

Gaussians belong to separate pieces if at least one empty fine voxel lies between them everywhere,
and if each piece has a closed surface outside the other pieces. Other surfaces may be the two sides
of a wall, or parts of a captured surface with gaps.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.particles.dilation import dilate

Mask = NDArray[np.bool_]

CONNECTED = np.ones((3, 3, 3))
"""Voxels are connected by faces, edges and corners, so that a thin slanted sheet stays whole."""
FINER = 2
"""Number of fine voxels along the side of a voxel."""
CLOSED = 0.1
"""Smallest volume of the cavity in a separate piece, relative to the volume of its surface."""
LEAST = 0.01
"""Smallest fraction of an object in a separate piece: of its surface, and of its volume."""
CELLS = 4
"""Smallest volume of a separate piece [cells]. Smaller pieces share the nodes of other pieces."""


def divide(
    points: NDArray, owner: NDArray, means: NDArray, shape: tuple[int, ...]
) -> NDArray[np.int64]:
    """Return the number of the separate piece to which each Gaussian belongs [N].

    Args:
        points: Samples in the Gaussians [S,3], in voxels.
        owner: Index of the Gaussian of each sample [S].
        means: Centres of the Gaussians [N,3].
        shape: Number of voxels along each axis.
    """
    surface = _connect(points, owner, len(means))
    sizes = np.bincount(surface[owner])
    large = np.flatnonzero(sizes >= LEAST * sizes.sum())
    single = np.zeros(len(means), np.int64)
    if len(large) < 2:
        return single
    closed = {}
    for k in large.tolist():
        occupied = np.zeros(shape, bool)
        occupied[tuple(points[surface[owner] == k].astype(np.int64).T)] = True
        inside = _fill(occupied)
        if inside is not None:
            closed[k] = occupied, inside
    outermost = [
        k
        for k, (occupied, _) in closed.items()
        if not any(
            (occupied & inside).sum() > occupied.sum() / 2
            for other, (_, inside) in closed.items()
            if other != k
        )
    ]
    if len(outermost) < 2:
        return single
    belongs = np.isin(surface, outermost)
    _, nearest = scipy.spatial.KDTree(means[belongs]).query(means)
    return np.searchsorted(outermost, surface[belongs][nearest])


def _connect(points: NDArray, owner: NDArray, count: int) -> NDArray[np.int64]:
    """Return the number of the connected surface to which each Gaussian belongs [N]."""
    index = np.floor(FINER * (points - points.min(axis=0))).astype(np.int64)
    occupied = np.zeros(index.max(axis=0) + 1, bool)
    occupied[tuple(index.T)] = True
    labels, number = scipy.ndimage.label(occupied, CONNECTED)  # pyright: ignore
    if number == 1:
        return np.zeros(count, np.int64)
    # The samples of a Gaussian are connected, even if they are far apart.
    links = np.ones(len(owner), np.int8), (owner, count + labels[tuple(index.T)] - 1)
    graph = scipy.sparse.coo_matrix(links, shape=(count + number, count + number))
    _, surface = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return np.unique(surface[:count], return_inverse=True)[1].astype(np.int64)


def _fill(surface: Mask) -> Mask | None:
    """Return the voxels inside a closed surface; None if the surface is not closed."""
    thick = dilate(surface, 1)
    labels, _ = scipy.ndimage.label(~thick)  # pyright: ignore
    outside = labels == labels[0, 0, 0]
    cavity = ~(outside | thick)
    if cavity.sum() <= CLOSED * surface.sum():
        return None
    inside: Mask = ~dilate(outside, 1)
    return inside


@dataclass(frozen=True, eq=False)
class Islands:
    """The separate pieces of an object."""

    first: NDArray[np.int64]
    """Index of the grid's first voxel [3]."""
    voxel: float
    """Side of a voxel [m]."""
    labels: NDArray[np.int64]
    """Number of the nearest piece at each voxel [X,Y,Z]."""
    of_parts: Sequence[NDArray[np.int64]]
    """Number of the piece at each voxel of each part [X,Y,Z]; several parts may fill a voxel."""
    number: int
    """Number of pieces that move independently."""
    small: int
    """Number of pieces that are too small to move independently."""

    def at(self, x: NDArray) -> NDArray[np.int32]:
        """Return the number of the nearest piece at positions x [M,3], m."""
        return self.labels[self.voxels_at(x)].astype(np.int32)

    def voxels_at(self, x: NDArray) -> tuple[NDArray[np.int64], ...]:
        """Return the indices along each axis of the voxels at positions x [M,3], m."""
        index = np.floor(x / self.voxel).astype(np.int64) - self.first
        return tuple(np.clip(index, 0, np.array(self.labels.shape) - 1).T)

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
    first: NDArray[np.int64], voxel: float, fractions: Sequence[NDArray[np.float32]], dx: float
) -> Islands:
    """Return the separate pieces of an object. A small piece belongs to the nearest large piece.

    Args:
        first: Index of the grid's first voxel [3].
        voxel: Side of a voxel [m].
        fractions: Fractions of the voxels that each part of the object fills [X,Y,Z].
        dx: Side of the cells in which small pieces are measured [m].
    """
    parts, count, volumes = [], 0, []
    for fraction in fractions:
        labels, number = scipy.ndimage.label(fraction > 0, CONNECTED)  # pyright: ignore
        volumes.append(np.bincount(labels.ravel(), fraction.ravel())[1:] * voxel**3)
        parts.append(np.where(labels > 0, labels + count, 0))
        count += number
    if count < 2:
        single = np.zeros(parts[0].shape, np.int64)
        return Islands(first, voxel, single, [single], 1, 0)
    volume = np.concatenate(volumes)
    visible = volume >= LEAST * volume.sum()
    large = visible & (volume >= CELLS * dx**3)
    large[np.argmax(volume)] = True
    number = np.append(-1, np.where(large, np.cumsum(large) - 1, -1))
    fullest = np.argmax(fractions, axis=0)[None]
    labels = number[np.take_along_axis(np.stack(parts), fullest, axis=0)[0]]
    nearest = scipy.ndimage.distance_transform_edt(
        labels < 0, return_distances=False, return_indices=True
    )
    labels = labels[tuple(nearest)]
    of_parts = [np.where(number[part] < 0, labels, number[part]) for part in parts]
    small = int((visible & ~large).sum())
    return Islands(first, voxel, labels, of_parts, int(large.sum()), small)
