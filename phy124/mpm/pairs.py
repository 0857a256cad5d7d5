"""Pairs: computes the contact between bodies, and the impulses between them.

Kernels are launched only for pairs with overlapping windows, so bodies that are far apart take no
computing time.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Wrench
from phy124.kernels.arguments import types
from phy124.kernels.contacts import MOMENT, SUMS
from phy124.kernels.pairs import make_pair
from phy124.mpm.grid import Grid
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.stage import Recorded

STAGE = "pairs"
"""Name under which reports list the time for contact between bodies."""
ROOM = 16
"""Length of the array in which a worker sums a pair's impulses. With this length, no two workers
write to the same cache line.
"""
Box = tuple[NDArray[np.int64], NDArray[np.int64]]


class Pair(NamedTuple):
    """Contact parameters of two bodies with the indices `first` and `second`."""

    first: int
    second: int
    friction: float = 0.5
    """Coefficient of Coulomb friction between the two bodies."""
    sticky: bool = False
    """Whether the two bodies have equal velocities at every node at which both have mass."""


class Pairs(Kept):
    """All pairs of bodies of a run."""

    kept = ("_sums", "_begun", "_added")

    def __init__(self, model: Model, listed: Sequence[Pair], workers: int) -> None:
        """Allocate the sums; `listed` are the pairs whose contact differs from the default.

        Raises:
            ValueError: A pair does not consist of two bodies of the model, or a pair is listed
                twice.
        """
        numbers = list(itertools.combinations(range(model.bodies), 2))
        chosen = {tuple(sorted(pair[:2])): pair for pair in listed}
        if len(chosen) < len(listed) or not chosen.keys() <= set(numbers):
            raise ValueError(
                f"pairs {list(listed)} must be different pairs of {model.bodies} bodies"
            )
        pairs = [chosen.get(number, Pair(*number)) for number in numbers]
        self.all = [pair for pair in pairs if not {pair.first, pair.second} <= model.held]
        """All pairs of bodies, except pairs of two fixed bodies."""
        self._model = model
        shape = (workers, len(self.all), ROOM)
        self._sums = wp.zeros(shape, dtype=wp.float64, device=model.device)
        self._added = np.zeros((len(self.all), SUMS))
        """For each pair, the sum of the impulses that other solvers compute [pairs,6]."""
        self._begun = self._total()
        self._fill = fill_of(model)

    def begin(self) -> None:
        """Start summing the impulses between bodies."""
        self._begun = self._total()

    def _total(self) -> NDArray[np.float64]:
        """Return each pair's impulse and moment of the first body on the second [pairs,6]."""
        return np.asarray(self._sums.numpy()).sum(axis=0)[:, :SUMS] + self._added

    def add(self, first: int, second: int, impulse: NDArray, moment: NDArray) -> None:
        """Add an impulse that another solver computes.

        Args:
            first: Index of a body.
            second: Index of the body on which the impulse acts.
            impulse: Impulse of the first body on the second [3], N s.
            moment: Moment of the impulse about the origin [3], N m s.
        """
        for index, pair in enumerate(self.all):
            if {pair.first, pair.second} == {first, second}:
                sign = 1 if pair.first == first else -1
                self._added[index] += sign * np.concatenate([impulse, moment])

    def impulse(self) -> NDArray[np.float64]:
        """Return the impulse of fixed bodies on all other bodies since the start [3], N s."""
        return self._signs() @ self._total()[:, :MOMENT]

    def rows(self) -> tuple[wp.array, wp.array]:
        """Return sums of impulses, with a row for each worker and pair, and a sign for each row.

        The sign is 1 if the first body of the pair is fixed, -1 if the second body is fixed, and
        otherwise 0.
        """
        workers, pairs, room = self._sums.shape
        signs = np.tile(self._signs(), workers)
        array = wp.array(signs, dtype=wp.float64, device=self._model.device)
        return self._sums.reshape((workers * pairs, room)), array

    def _signs(self) -> NDArray[np.float64]:
        held = self._model.held
        signs = [(pair.first in held) - (pair.second in held) for pair in self.all]
        return np.array(signs, float)

    def sums_of(self, index: int) -> wp.array:
        """Return the first worker's sums of impulse and moment between a pair of bodies."""
        return cast("wp.array", self._sums[0, index])

    def wrenches(self, seconds: float) -> dict[tuple[int, int], Wrench]:
        """Return each pair's mean wrench of the first body on the second since the call of `begin`.

        `begin` was called `seconds` ago. The torque is about the origin.
        """
        sums = (self._total() - self._begun) / seconds
        return {
            (pair.first, pair.second): Wrench(row[:MOMENT], row[MOMENT:])
            for pair, row in zip(self.all, sums, strict=True)
        }

    def record(self, grids: Sequence[Grid], worker: int, workers: int) -> list[Recorded]:
        """Record a worker's kernel launches, one for each pair of bodies whose windows overlap.

        Every node is in the layers of exactly one worker, which processes all pairs at this node in
        order.
        """
        boxes = [_overlap(grids[pair.first], grids[pair.second]) for pair in self.all]
        near = [(low[0], high[0]) for low, high in boxes if np.all(high > low)]
        if not near:
            return []
        first, last = min(a for a, _ in near), max(b for _, b in near)
        ends = [first + (last - first) * place // workers for place in (worker, worker + 1)]
        records = []
        for index, (low, high) in enumerate(boxes):
            low[0], high[0] = max(low[0], ends[0]), min(high[0], ends[1])
            if np.all(high > low):
                sums = cast("wp.array", self._sums[worker, index])
                records.append((STAGE, self._launch(self.all[index], low, high - low, grids, sums)))
        return records

    def touching(self, grids: Sequence[Grid]) -> bool:
        """Return whether the windows of any pair overlap."""
        return bool(self.record(grids, 0, 1))

    def _launch(
        self, pair: Pair, low: NDArray, extent: NDArray, grids: Sequence[Grid], sums: wp.array
    ) -> wp.Launch | None:
        model, bodies = self._model, (pair.first, pair.second)
        t, both = types(model.real), [grids[body] for body in bodies]
        fill = t.vec2(*(self._fill[body] for body in bodies))
        yields = t.vec2(*(float(body not in self._model.held) for body in bodies))
        how = [fill, yields, pair.friction, int(pair.sticky)]
        inputs = [wp.vec3i(*low.tolist()), both[0].lattice, *how, *(grid.window for grid in both)]
        outputs = [*(grid.nodes for grid in both), sums]
        return model.launch(make_pair(model.real), tuple(extent.tolist()), inputs, outputs)


def fill_of(model: Model) -> list[float]:
    """Return for each body the fraction of a cell that one kilogram of the body fills [1/kg]."""
    mass, volume = (a.numpy().astype(np.float64) for a in (model.mass, model.volume))
    runs = [model.particles(body) for body in range(model.bodies)]
    return [float(volume[run].sum() / mass[run].sum() / model.dx**3) for run in runs]


def kernels(real: Any) -> list[Any]:
    """Return the kernels of contact between bodies."""
    return [make_pair(real)]


def _overlap(first: Grid, second: Grid) -> Box:
    """Return the first node that lies in both windows, and the node after the last such node."""
    low = np.maximum(first.low, second.low)
    return low, np.minimum(first.low + first.size, second.low + second.size)
