"""Finds the words of memory for which threads of one launch race."""

from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from races.record import ATOMIC, READ, WRITE

WORD = 4
PAIRS = {
    "write-write": (WRITE, WRITE),
    "read-write": (READ, WRITE),
    "write-atomic": (WRITE, ATOMIC),
    "read-atomic": (READ, ATOMIC),
}
"""Pairs of accesses by two threads to one word that are a race."""


def conflicts(entries: NDArray, arrays: Mapping[str, tuple[int, int]]) -> Counter[str]:
    """Return the number of racing words by kind and array, such as "read-write grid_out".

    Args:
        entries: The accesses of one launch.
        arrays: First address of each of its arrays, and one past the last.
    """
    words, kinds, tasks = _by_word(_shared(entries, arrays))
    if not len(words):
        return Counter()
    place, first = np.unique(words, return_inverse=True)
    low = np.full((3, len(place)), np.iinfo(np.int64).max)
    high = np.full((3, len(place)), -1, np.int64)
    np.minimum.at(low, (kinds, first), tasks)
    np.maximum.at(high, (kinds, first), tasks)
    result: Counter[str] = Counter()
    for pair, (single, other) in PAIRS.items():
        both = (high[single] >= 0) & (high[other] >= 0)
        several = np.minimum(low[single], low[other]) < np.maximum(high[single], high[other])
        for word in place[both & several]:
            result[f"{pair} {_name(int(word), arrays)}"] += 1
    return result


def _shared(entries: NDArray, arrays: Mapping[str, tuple[int, int]]) -> NDArray:
    """Return the accesses inside the arrays; others are to memory that is private to a thread."""
    inside = np.zeros(len(entries), bool)
    for start, stop in arrays.values():
        inside |= (entries["address"] >= start) & (entries["address"] < stop)
    return entries[inside]


def _by_word(entries: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Return address, kind and thread of every access, once for each word that it touches."""
    length = np.maximum(entries["bytes"] // WORD, 1).astype(np.int64)
    row = np.repeat(np.arange(len(entries)), length)
    within = np.arange(len(row)) - np.repeat(np.cumsum(length) - length, length)
    words = entries["address"][row].astype(np.int64) + WORD * within
    return words, entries["kind"][row], entries["task"][row].astype(np.int64)


def _name(address: int, arrays: Mapping[str, tuple[int, int]]) -> str:
    return next(name for name, (start, stop) in arrays.items() if start <= address < stop)
