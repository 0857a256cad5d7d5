"""Quantises numbers to 256 codes, vectors to a palette, and quaternions to three components.

The largest component of a unit quaternion is not stored: its sign can be made positive, because q
and -q are the same rotation, and its magnitude follows from the unit length. The other components
are at most 1 / sqrt 2 in magnitude.
"""

import numpy as np
from numpy.typing import NDArray

SIZE = 256
ROUNDS = 20
"""Iterations of Lloyd's algorithm; those after the tenth reduce the error by less than 1 %."""

COMPONENTS = 8
"""Number of principal components by which vectors are divided into groups; see `make_palette`."""


def make_codebook(values: NDArray) -> NDArray[np.float64]:
    """Return 256 ascending codes that minimise the mean square distance to `values [N]`.

    The method is Lloyd's algorithm in one dimension. Half of the initial codes are quantiles, for
    dense regions; the other half are evenly spaced, for outliers.
    """
    ordered = np.sort(np.asarray(values, np.float64))
    sums = np.concatenate([[0], np.cumsum(ordered)])
    spread = np.linspace(ordered[0], ordered[-1], SIZE // 2)
    codes = np.sort(np.concatenate([np.quantile(ordered, np.linspace(0, 1, SIZE // 2)), spread]))
    for _ in range(ROUNDS):
        ends = np.searchsorted(ordered, (codes[1:] + codes[:-1]) / 2)
        ends = np.concatenate([[0], ends, [len(ordered)]])
        counts = np.diff(ends)
        means = np.diff(sums[ends]) / np.maximum(counts, 1)
        codes = np.sort(np.where(counts > 0, means, codes))
    return codes


def nearest_codes(codes: NDArray, values: NDArray) -> NDArray[np.uint8]:
    """Return, for each value, the index of the nearest of the ascending codes."""
    return np.searchsorted((codes[1:] + codes[:-1]) / 2, values).astype(np.uint8)


def make_palette(vectors: NDArray, most: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return a palette that approximates `vectors [N,D]`, and the palette index of each vector.

    The palette has at most `most` entries, a power of 2. If there are more vectors, they are
    divided into `most` cells, whose means form the palette. Each cell is split at the median of its
    principal component with the largest variance.
    """
    count = len(vectors)
    if count <= most:
        return np.asarray(vectors, np.float32), np.arange(count)
    cell = np.zeros(count, np.int64)
    components = _principal(vectors)
    for level in range(int(np.log2(most))):
        order = _sort_halves(components, cell, 1 << level)
        cell[order] = np.arange(count) * (2 << level) // count
    sizes = np.bincount(cell, minlength=most)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    means = np.add.reduceat(vectors[np.argsort(cell, kind="stable")], starts, axis=0)
    return (means / sizes[:, None]).astype(np.float32), cell


def _principal(vectors: NDArray) -> NDArray[np.float32]:
    centred = vectors - vectors.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return np.ascontiguousarray(centred @ axes[:, -COMPONENTS:], np.float32)


def _sort_halves(vectors: NDArray, cell: NDArray[np.int64], cells: int) -> NDArray[np.int64]:
    sizes = np.bincount(cell, minlength=cells)[:, None]
    order = np.argsort(cell, kind="stable")
    starts = np.concatenate([[0], np.cumsum(sizes[:, 0])[:-1]])
    sums = np.add.reduceat(vectors[order], starts, axis=0)
    squares = np.add.reduceat(np.square(vectors[order]), starts, axis=0)
    widest = (squares / sizes - np.square(sums / sizes)).argmax(axis=1)
    return np.lexsort((vectors[np.arange(len(vectors)), widest[cell]], cell))


OTHERS = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Indices of the three stored components, for each index of the component that is not stored."""


def drop_largest(quats: NDArray) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return each quaternion's three smallest components [N,3], and the index [N] of the fourth.

    Signs are changed so that the fourth component is positive.
    """
    quats = np.asarray(quats, np.float64)
    which = np.abs(quats).argmax(axis=1)
    sign = np.where(np.take_along_axis(quats, which[:, None], 1) < 0, -1.0, 1.0)
    return np.take_along_axis(quats, OTHERS[which], 1) * sign, which


def restore_largest(others: NDArray, which: NDArray) -> NDArray[np.float32]:
    """Return unit quaternions [N,4] from three components [N,3] and the index [N] of the fourth."""
    which = np.asarray(which, np.int64)
    out = np.empty((len(others), 4), np.float32)
    np.put_along_axis(out, OTHERS[which], others.astype(np.float32), 1)
    rest = np.sqrt(np.maximum(1 - np.square(others).sum(axis=1), 0)).astype(np.float32)
    np.put_along_axis(out, which[:, None], rest[:, None], 1)
    return out
