"""The plan of a sweep: which clip is which, told from its number alone, so none is kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.scene import Scene
from phy124.studies.sweep.axes import Axis, Counted, Listed
from phy124.studies.sweep.declaration import Sweep
from phy124.studies.sweep.storage import matching

BLOCK = 1024
"""Samples that are drawn at once, a power of two."""
MOST = 100_000_000
"""Largest number of clips of one sweep."""
FEWEST_BITS = 30
"""Sobol's sequence is drawn to so many binary digits."""


@dataclass(frozen=True)
class Item:
    """One clip to be made."""

    index: int
    picture: str
    generator: str
    changes: dict[str, Any]
    """Dotted path in the scene -> value."""


class Plan:
    """All clips of a sweep, by their number."""

    def __init__(self, sweep: Sweep) -> None:
        """Find the pictures and read the scene.

        Raises:
            InputError: There is no such picture or scene, no such field of it, too many clips, or
                a distribution without a number of samples.
        """
        self.sweep = sweep
        # The manifest tells the largest force on a wall.
        self.scene = Scene.named(sweep.scene).model_copy(update={"wrenches": True})
        pictures = [path for given in sweep.pictures for path in matching(given)]
        self.axes: dict[str, Axis] = {
            "picture": Listed(values=tuple(dict.fromkeys(pictures))),
            "generator": Listed(values=sweep.generators),
            **sweep.set,
        }
        self._counted = [axis for axis in self.axes.values() if isinstance(axis, Counted)]
        self._refuse_endless()
        self._length = sweep.samples or prod(axis.count for axis in self._counted)
        if self._length > MOST:
            limit = f"all combinations are {self._length:,} clips, the most are {MOST:,}."
            raise InputError("sweep", sweep.scene, limit, "Set samples, or shorten a range.")
        self._block: tuple[int, NDArray[np.float64]] = (-1, np.empty((0, 0)))

    def __len__(self) -> int:
        return self._length

    @property
    def sources(self) -> int:
        """In how many ways Gaussians are made, at most: clips of one way share them."""
        shared = ("picture", "generator", "seed")
        axes = [self.axes[name] for name in shared if name in self.axes]
        counts = [axis.count if isinstance(axis, Counted) else len(self) for axis in axes]
        return min(len(self), prod(counts))

    def __iter__(self) -> Iterator[Item]:
        return (self.item(index) for index in range(len(self)))

    def item(self, index: int) -> Item:
        """The clip of a number; the last axis changes fastest."""
        if self.sweep.samples is None:
            places = np.unravel_index(index, [axis.count for axis in self._counted])
            pairs = zip(self._counted, places, strict=True)
            values: list[Any] = [axis.value(int(place)) for axis, place in pairs]
        else:
            drawn = zip(self.axes.values(), self._point(index), strict=True)
            values = [axis.drawn(float(u)) for axis, u in drawn]
        picture, generator, *others = values
        return Item(index, picture, generator, dict(zip(self.sweep.set, others, strict=True)))

    def scene_of(self, item: Item) -> Scene:
        """The scene of a clip.

        Raises:
            InputError: Its values cannot be used.
        """
        return self.scene.replaced(item.changes)

    def share(self, part: int, parts: int) -> range:
        """Numbers of the clips that one of several machines makes, counted from 1."""
        return range(part - 1, len(self), parts)

    def _refuse_endless(self) -> None:
        """Raise InputError for a distribution if all combinations are asked for."""
        for name, axis in self.axes.items():
            if self.sweep.samples is None and not isinstance(axis, Counted):
                limit = "it is to be drawn, and all combinations are asked for."
                remedy = "Set samples, or give a list or a range."
                raise InputError(f"set.{name}", axis, limit, remedy)

    @cached_property
    def _shift(self) -> NDArray[np.float64]:
        """Moves all samples by the same vector, which keeps them as even as they are."""
        return np.random.default_rng(self.sweep.seed).random(len(self.axes))

    def _point(self, index: int) -> NDArray[np.float64]:
        """A sample in the unit cube: Sobol's sequence, shifted by the seed."""
        number, place = divmod(index, BLOCK)
        if self._block[0] != number:
            from scipy.stats.qmc import Sobol

            sequence = Sobol(len(self.axes), scramble=False, bits=FEWEST_BITS)
            if number:
                sequence.fast_forward(number * BLOCK)
            self._block = number, sequence.random(BLOCK)
        return (self._block[1][place] + self._shift) % 1.0
