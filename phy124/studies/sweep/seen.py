"""Remembers keys in eight bytes each, so that a driver of millions of clips stays small."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

HEXADECIMAL = 16
"""Digits of a key that are remembered: any two of 1e6 keys share them with a chance of 3e-8."""
RECENT = 4096
"""Keys that are kept in a set of Python until they join the others."""


class Seen:
    """Keys, which are hexadecimal."""

    def __init__(self, keys: Iterable[str] = ()) -> None:
        self._sorted = np.empty(0, np.uint64)
        self._recent: set[int] = set()
        for key in keys:
            self.add(key)

    def add(self, key: str) -> None:
        """Remember a key."""
        self._recent.add(_number(key))
        if len(self._recent) >= RECENT:
            recent = np.fromiter(self._recent, np.uint64, len(self._recent))
            self._sorted = np.union1d(self._sorted, recent)
            self._recent.clear()

    def __contains__(self, key: str) -> bool:
        number = _number(key)
        if number in self._recent:
            return True
        place = np.searchsorted(self._sorted, np.uint64(number))
        return bool(place < len(self._sorted) and self._sorted[place] == number)


def _number(key: str) -> int:
    return int(key[:HEXADECIMAL], 16)
