"""Plans a sweep; the settings of a clip follow from the clip's index."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.scene import Scene
from phy124.studies.sweep.declaration import Axis, Counted, Listed, Sweep
from phy124.studies.sweep.storage import list_matching

BLOCK = 1024
"""Number of samples that are computed in one step; a power of two."""
MOST = 100_000_000
"""Maximum number of clips of one sweep."""
FEWEST_BITS = 30
"""Number of bits of the Sobol sequence."""


@dataclass(frozen=True)
class Item:
    """The index and the settings of a clip."""

    index: int
    picture: str
    generator: str
    changes: dict[str, Any]
    """Values in the scene, by their dotted paths."""


class Plan:
    """A sequence of all clips of a sweep."""

    def __init__(self, sweep: Sweep) -> None:
        """Find the pictures and read the scene.

        Raises:
            InputError: A picture or the scene does not exist, there are too many clips, or the
                number of samples is not set and an axis is a distribution.
        """
        self.sweep = sweep
        # Wrenches are recorded, because the manifest contains the largest force on a wall.
        self.scene = Scene.named(sweep.scene).model_copy(update={"wrenches": True})
        pictures = [path for pattern in sweep.pictures for path in list_matching(pattern)]
        self.axes: dict[str, Axis] = {
            "picture": Listed(values=tuple(dict.fromkeys(pictures))),
            "generator": Listed(values=sweep.generators),
            **sweep.set,
        }
        self._counted = [axis for axis in self.axes.values() if isinstance(axis, Counted)]
        self._refuse_endless()
        self._length = sweep.samples or prod(axis.count for axis in self._counted)
        if self._length > MOST:
            limit = (
                f"all combinations are {self._length:,} clips, but at most {MOST:,} clips are "
                "allowed."
            )
            raise InputError("sweep", sweep.scene, limit, "Set samples, or use fewer values.")
        self._block: tuple[int, NDArray[np.float64]] = (-1, np.empty((0, 0)))

    def __len__(self) -> int:
        return self._length

    @property
    def sources(self) -> int:
        """Maximum number of different sources; a source is a picture, a generator and a seed."""
        shared = ("picture", "generator", "seed")
        axes = [self.axes[name] for name in shared if name in self.axes]
        counts = [axis.count if isinstance(axis, Counted) else len(self) for axis in axes]
        return min(len(self), prod(counts))

    def __iter__(self) -> Iterator[Item]:
        return (self.item(index) for index in range(len(self)))

    def item(self, index: int) -> Item:
        """Return the clip at an index; the last axis varies fastest."""
        if self.sweep.samples is None:
            places = np.unravel_index(index, [axis.count for axis in self._counted])
            pairs = zip(self._counted, places, strict=True)
            values: list[Any] = [axis.value(int(place)) for axis, place in pairs]
        else:
            drawn = zip(self.axes.values(), self._point(index), strict=True)
            values = [axis.draw(float(u)) for axis, u in drawn]
        picture, generator, *others = values
        return Item(index, picture, generator, dict(zip(self.sweep.set, others, strict=True)))

    def scene_of(self, item: Item) -> Scene:
        """Return the scene of a clip.

        Raises:
            InputError: The values of the clip are not valid in the scene.
        """
        return self.scene.replaced(item.changes)

    def share(self, part: int, parts: int) -> range:
        """Return the indices of the clips in shard `part`, counted from 1, of `parts` shards."""
        return range(part - 1, len(self), parts)

    def _refuse_endless(self) -> None:
        for name, axis in self.axes.items():
            if self.sweep.samples is None and not isinstance(axis, Counted):
                limit = "a distribution has no finite number of combinations."
                remedy = "Set samples, or give a list or a range."
                raise InputError(f"set.{name}", axis, limit, remedy)

    @cached_property
    def _shift(self) -> NDArray[np.float64]:
        """A random shift, added to all samples modulo 1; the samples remain evenly distributed."""
        return np.random.default_rng(self.sweep.seed).random(len(self.axes))

    def _point(self, index: int) -> NDArray[np.float64]:
        number, place = divmod(index, BLOCK)
        if self._block[0] != number:
            from scipy.stats.qmc import Sobol

            sequence = Sobol(len(self.axes), scramble=False, bits=FEWEST_BITS)
            if number:
                sequence.fast_forward(number * BLOCK)
            self._block = number, sequence.random(BLOCK)
        return (self._block[1][place] + self._shift) % 1.0
