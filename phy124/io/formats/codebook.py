"""A few values that stand for many: codebooks of 256 numbers, palettes of vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SIZE = 256
ROUNDS = 20
"""Rounds of Lloyd's algorithm; the error falls by less than 1 % after ten."""

COMPONENTS = 8
"""Principal components by which vectors are told apart."""


def codebook(values: NDArray) -> NDArray[np.float64]:
    """The 256 values, rising, whose nearest one is closest to `values [N]` in the mean square.

    Lloyd's algorithm in one dimension: since the values are sorted, the mean of each cell is a
    difference of two sums. It starts from as many values of each quantile as of each part of the
    range, so that neither crowds nor outliers are forgotten.
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


def nearest(codes: NDArray, values: NDArray) -> NDArray[np.uint8]:
    """Index of the nearest code of each value."""
    return np.searchsorted((codes[1:] + codes[:-1]) / 2, values).astype(np.uint8)


def palette(vectors: NDArray, most: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """At most so many vectors that stand for all of `vectors [N,D]`, and which stands for each.

    Up to `most` vectors stand for themselves. More are halved at the median of their widest
    principal component until there are `most` cells, each with its mean.

    Args:
        vectors: What is to be stood for.
        most: Largest number of entries, a power of 2.
    """
    count = len(vectors)
    if count <= most:
        return np.asarray(vectors, np.float32), np.arange(count)
    cell = np.zeros(count, np.int64)
    components = _principal(vectors)
    for level in range(int(np.log2(most))):
        order = _halved(components, cell, 1 << level)
        cell[order] = np.arange(count) * (2 << level) // count
    sizes = np.bincount(cell, minlength=most)
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    means = np.add.reduceat(vectors[np.argsort(cell, kind="stable")], starts, axis=0)
    return (means / sizes[:, None]).astype(np.float32), cell


def _principal(vectors: NDArray) -> NDArray[np.float32]:
    """The largest principal components [N,C]; along the others hardly anything differs."""
    centred = vectors - vectors.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return np.ascontiguousarray(centred @ axes[:, -COMPONENTS:], np.float32)


def _halved(vectors: NDArray, cell: NDArray[np.int64], cells: int) -> NDArray[np.int64]:
    """The order of vectors by cell, and within it by the cell's coordinate of largest variance."""
    sizes = np.bincount(cell, minlength=cells)[:, None]
    order = np.argsort(cell, kind="stable")
    starts = np.concatenate([[0], np.cumsum(sizes[:, 0])[:-1]])
    sums = np.add.reduceat(vectors[order], starts, axis=0)
    squares = np.add.reduceat(np.square(vectors[order]), starts, axis=0)
    widest = (squares / sizes - np.square(sums / sizes)).argmax(axis=1)
    return np.lexsort((vectors[np.arange(len(vectors)), widest[cell]], cell))
