"""Slabs: which particles several workers have, and the private nodes they scatter to.

The particles of each group are cut in the order they have, in which they lie layer by layer along
the longest axis (phy124/simulation/setup.py), into slabs of equal numbers, one for each worker.
The nodes of a slab are those its particles can touch until they are measured again: beside its own
layers only a halo of a few. As the object turns or flows, slabs come to overlap. Once all their
nodes are too many, the particles are cut anew where they are now; workers then find theirs by lists
of indices, which makes a substep up to twice as expensive, and so is the exception.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.measure import COUNT, SPEEDS
from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.maxima import Maxima
from phy124.mpm.model import Group, Model
from phy124.mpm.state import State
from phy124.mpm.workers import Part, Worker, numbers

NODES, GROWN = 16, 1.25
"""Nodes of slabs per particle from which a new cut may pay, or memory would grow without bound; and
how many times as many they must be, per node of the window, as after the last cut."""
GAP, LINE = 1, 4
"""Nodes between two slabs, since SIMD rows touch one node more, and nodes per line of cache: no
two workers ever write to the same one."""


class Slabs:
    """The parts of several workers."""

    def __init__(self, model: Model, state: State, grids: Sequence[Grid], count: int) -> None:
        """Cut the particles for the first time.

        Args:
            model: The particles.
            state: Where they are.
            grids: The shared grid of each body.
            count: Number of workers.
        """
        self._model, self._state, self._grids = model, state, grids
        length = COUNT * len(model.groups)
        self.workers = [
            Worker(numbers(length, model), numbers(SPEEDS, model)) for _ in range(count)
        ]
        self.pool = wp.zeros(0, dtype=types(model.real).vec4, device=model.device)
        """The nodes of all slabs."""
        self.boxes: list[wp.array] = []
        """Lowest node and extent of each slab of each body."""
        self.starts: list[wp.array] = []
        """Where each of these begins in the pool."""
        self.runs: list[wp.array] = []
        """The nodes of each worker."""
        self._owner = np.zeros(len(model), np.int16)
        self._share = 0.0
        """Nodes of slabs per node of the window when it was cut."""
        self.cut()

    @property
    def parts(self) -> list[Part]:
        """The parts of all workers."""
        return [part for worker in self.workers for part in worker.parts]

    @property
    def share(self) -> float:
        """Nodes of all slabs per node of the window."""
        shared = sum(grid.count for grid in self._grids)
        return sum(part.nodes.count for part in self.parts) / max(shared, 1)

    @property
    def outgrown(self) -> bool:
        """Whether there are so many more nodes than after the last cut that a new one pays."""
        if self._share == 0:
            self._share = self.share
        return len(self.pool) > NODES * len(self._model) and self.share > GROWN * self._share

    def cut(self, order: NDArray[np.integer] | None = None) -> None:
        """Give each worker equal numbers of each group, in the order they have or another [P]."""
        count = len(self.workers)
        order = np.arange(len(self._model)) if order is None else order
        for group in self._model.groups:
            edges = group.start + np.linspace(0, len(group), count + 1).astype(int)
            for worker in range(count):
                self._owner[order[edges[worker] : edges[worker + 1]]] = worker
        self._share = 0.0
        self._share_out()

    def cut_anew(self, lower: NDArray, upper: NDArray) -> None:
        """Cut across the axis that is longest now; the particles lie between two corners [m]."""
        x: NDArray[Any] = self._state.x.numpy()
        layer = layers(np.clip(x, lower, upper), int(np.argmax(upper - lower)), self._model.dx)
        sorted_ones = [
            group.start + np.argsort(layer[group.particles], kind="stable")
            for group in self._model.groups
        ]
        self.cut(np.concatenate(sorted_ones))

    def fit(self, rows: NDArray[np.float64], *, force: bool) -> bool:
        """Make the nodes of every slab cover its particles; returns whether they changed.

        Args:
            rows: What was measured among the particles of each part [parts,COUNT].
            force: Whether the shared window has changed.
        """
        reaches = [self._reach(part, row) for part, row in zip(self.parts, rows, strict=True)]
        if not force and all(map(_roomy, self.parts, reaches)):
            return False
        # All at once, so that none needs it again soon.
        boxes = []
        for part, reach in zip(self.parts, reaches, strict=True):
            grid = self._grids[part.group.body]
            low, high = grid.low, grid.low + grid.size
            first, last = reach or (low, low - 2 * MARGIN)
            start = np.clip(first - MARGIN, low, high)
            boxes.append((start, np.clip(last + MARGIN, start, high) - start))
        self.place(boxes)
        return True

    def _reach(self, part: Part, row: NDArray[np.float64]) -> tuple[NDArray, NDArray] | None:
        """The nodes that measured particles can touch; None if they all are outliers."""
        grid = self._grids[part.group.body]
        return grid.reach(*Maxima.of(row).corners) if np.isfinite(row).all() else None

    def place(self, boxes: Sequence[tuple[NDArray, NDArray]]) -> None:
        """Give every slab the nodes from `low` [3] on, `size` [3] of them; all are cleared."""
        rooms = [-(-(int(np.prod(size)) + GAP) // LINE) * LINE for _, size in boxes]
        starts = [0, *itertools.accumulate(rooms)]
        device = self._model.device
        self.pool = wp.zeros(starts[-1], dtype=self.pool.dtype, device=device)
        self.boxes, self.starts = [], []
        for body in range(self._model.bodies):
            own = [i for i, part in enumerate(self.parts) if part.group.body == body]
            corners = np.array([corner for i in own for corner in boxes[i]], np.int32)
            self.boxes.append(wp.array(corners.reshape(-1, 3), dtype=wp.vec3i, device=device))
            self.starts.append(wp.array([starts[i] for i in own], dtype=int, device=device))
        for part, (low, size), start, room in zip(self.parts, boxes, starts, rooms, strict=False):
            part.nodes.use(np.array(low), np.array(size), self._nodes(start, start + room))
        ends = itertools.accumulate((len(worker.parts) for worker in self.workers), initial=0)
        self.runs = [self._nodes(starts[a], starts[b]) for a, b in itertools.pairwise(ends)]

    def _nodes(self, first: int, last: int) -> wp.array:
        """A run of nodes of the pool."""
        return cast("wp.array", self.pool[first:last])

    def snapshot(self) -> dict[str, Any]:
        """The state that `restore` needs, as plain data and arrays."""
        boxes = [[part.nodes.low.tolist(), part.nodes.size.tolist()] for part in self.parts]
        count = len(self.workers)
        return {"workers": count, "owner": self._owner.copy(), "share": self._share, "boxes": boxes}

    def restore(self, snapshot: dict[str, Any]) -> bool:
        """Return to a snapshot; False if it is of another number of workers."""
        if snapshot.get("workers") != len(self.workers):
            self.cut()
            return False
        owner = np.asarray(snapshot["owner"], np.int16)
        if not np.array_equal(owner, self._owner):
            self._owner = owner.copy()
            self._share_out()
        self._share = snapshot["share"]
        self.place([(np.array(low), np.array(size)) for low, size in snapshot["boxes"]])
        return True

    def _share_out(self) -> None:
        """Give the workers their parts."""
        for index, worker in enumerate(self.workers):
            found = [self._part(index, group) for group in self._model.groups]
            worker.parts = [part for part in found if part is not None]

    def _part(self, index: int, group: Group) -> Part | None:
        """A worker's part of a group, if it has one."""
        model = self._model
        own = np.flatnonzero(self._owner[group.particles] == index)
        if len(own) == 0:
            return None
        first, last = int(own[0]), int(own[-1]) + 1
        run, chosen = slice(group.start + first, group.start + last), own[:0]
        if last - first > len(own):
            run, chosen = group.particles, own
        nodes = Grid(model.origin, model.dx, real=model.real, device=model.device)
        place = COUNT * model.groups.index(group)
        maxima = cast("wp.array", self.workers[index].maxima[place : place + COUNT])
        indices = wp.array(chosen.astype(np.int32), dtype=int, device=model.device)
        return Part(group, run, indices, len(own), nodes, maxima)


def layers(x: NDArray, axis: int, dx: float) -> NDArray[np.int16]:
    """Number of the layer of cells of size dx [m], along an axis, in which each point is [P]."""
    layer = np.floor((x[:, axis] - x[:, axis].min()) / dx)
    return np.minimum(layer, np.iinfo(np.int16).max).astype(np.int16)


def _roomy(part: Part, reach: tuple[NDArray, NDArray] | None) -> bool:
    """Whether a part's particles have room to move until they are measured again."""
    if reach is None:
        return True
    nodes, (low, high) = part.nodes, reach
    spare = min((low - nodes.low).min(), (nodes.low + nodes.size - high).min())
    return bool(spare >= MARGIN // 2)
