"""Workers: each worker processes a part of the particles, on a separate set of nodes.

With several workers, the particles of each group are divided into slabs with equal numbers of
particles. The particles are sorted in layers along the longest axis (phy124/simulation/setup.py).
If the slabs have too many nodes in total, the particles are divided again by their current
positions. Workers then access their particles through lists of indices, so a substep becomes up to
twice as expensive. Particles are therefore rarely divided again.
"""

import itertools
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.measure import COUNT, SPEEDS
from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.model import Group, Model, State
from phy124.mpm.stage import Named
from phy124.mpm.timestep import Maxima
from phy124.runtime.cores import free_cores

MIN_PARTICLES = 10_000
"""Smallest number of particles per worker; with fewer, barriers cost more than they save."""
GATHER = -1
"""Index of the last phase of a substep; workers wait for each other between phases."""
SCHEDULE, WINDOW, REPAIR, FOLLOW = HOST = ("schedule", "window", "repair", "follow")
"""Names under which reports list the times of the host. `schedule`: choosing substeps, and all
other work between kernel launches. `window`: recording the kernel launches again for a moved window
of the grid. `repair`: resetting particles with invalid deformations. `follow`: the functions that
are called after each substep (progress, time limit and observers).
"""
NODES = 16
"""Particles are divided again only if the workers' slabs have more nodes per particle than this."""
GROWN = 1.25
"""Particles are divided again if the ratio of slab nodes to window nodes grew by this factor."""
GAP = 1
"""Gap between two workers' nodes [nodes], because SIMD code reads one additional node."""
LINE = 4
"""Number of nodes in a cache line; no two workers write to the same cache line."""
Result = TypeVar("Result")
Timings = dict[str, list[float]]
"""Seconds and number of kernel launches, keyed by the name of a stage."""


@dataclass
class Part:
    """The particles of one group that a worker processes."""

    group: Group
    particles: slice
    """Range of indices that contains all particles of the part."""
    chosen: wp.array
    """Indices of the part's particles in this range; empty if the part is the whole range."""
    count: int
    nodes: Grid
    """The nodes to which the part scatters: the body's grid, or nodes of this worker only."""
    maxima: wp.array
    """Maxima measured over the particles of the part (phy124/kernels/measure.py)."""

    def indices(self) -> slice | NDArray[np.int64]:
        """Return the indices of the part's particles among all particles."""
        if len(self.chosen) == 0:
            return self.particles
        return self.particles.start + np.asarray(self.chosen.numpy(), np.int64)

    def among(self, indices: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the items of `indices` that belong to particles of the part."""
        run = self.particles
        if len(self.chosen) == 0:
            return indices[(indices >= run.start) & (indices < run.stop)]
        return indices[np.isin(indices, run.start + self.chosen.numpy())]


@dataclass
class Worker:
    """The particles that one worker processes, and the kernel launches for these particles."""

    maxima: wp.array
    """Measured maxima of particles: `COUNT` numbers for each body, or for each part."""
    speeds: wp.array
    """Measured maxima of speed and velocity gradient of the worker's particles [SPEEDS]."""
    parts: list[Part] = field(default_factory=list)
    phases: list[list[Named]] = field(default_factory=list)
    """Launches of each phase: pushes (if there are any), scatter, grid update and walls, gather."""
    measures: list[wp.Launch] = field(default_factory=list)
    """Kernel launches that measure the limits of the substep."""
    glances: list[wp.Launch] = field(default_factory=list)
    """Kernel launches that measure only speeds and velocity gradients."""
    timings: Timings = field(default_factory=dict)

    def run(self, phase: int) -> None:
        """Run one phase of a substep."""
        run_launches(self.timings, self.phases[phase])

    def measure(self) -> None:
        """Measure the limits of the substep and the extent of the worker's particles."""
        self.maxima.fill_(-np.inf)
        for launch in self.measures:
            launch.launch()

    def glance(self) -> None:
        """Measure the speeds and velocity gradients of the worker's particles."""
        self.speeds.zero_()
        for launch in self.glances:
            launch.launch()


class Slabs:
    """Division of the particles among several workers."""

    def __init__(self, model: Model, state: State, grids: Sequence[Grid], count: int) -> None:
        self._model, self._state, self._grids = model, state, grids
        length = COUNT * len(model.groups)
        self.workers = [
            Worker(numbers(length, model), numbers(SPEEDS, model)) for _ in range(count)
        ]
        self.pool = wp.zeros(0, dtype=types(model.real).vec4, device=model.device)
        """The nodes of all slabs; a slab contains the nodes to which a single worker scatters."""
        self.boxes: list[wp.array] = []
        """The lowest node and the extent of each slab, for each body."""
        self.starts: list[wp.array] = []
        """The index of each slab's first node in `pool`, for each body."""
        self.runs: list[wp.array] = []
        """The nodes of each worker in the array `pool`."""
        self._owner = np.zeros(len(model), np.int16)
        self._share = 0.0
        """Ratio of slab nodes to window nodes after the last division of the particles."""
        self.divide()

    @property
    def parts(self) -> list[Part]:
        """The parts of the particles of all workers."""
        return [part for worker in self.workers for part in worker.parts]

    @property
    def share(self) -> float:
        """Number of nodes in all slabs, divided by the number of nodes in the windows."""
        shared = sum(grid.count for grid in self._grids)
        return sum(part.nodes.count for part in self.parts) / max(shared, 1)

    @property
    def outgrown(self) -> bool:
        """Whether the slabs have grown enough for a new division to save time."""
        if self._share == 0:
            self._share = self.share
        return len(self.pool) > NODES * len(self._model) and self.share > GROWN * self._share

    def divide(self, order: NDArray[np.integer] | None = None) -> None:
        """Give workers equal numbers of each group's particles.

        The particles are divided in the order `order` [P]; None: in the order of the memory.
        """
        count = len(self.workers)
        order = np.arange(len(self._model)) if order is None else order
        for group in self._model.groups:
            edges = group.start + np.linspace(0, len(group), count + 1).astype(int)
            for worker in range(count):
                self._owner[order[edges[worker] : edges[worker + 1]]] = worker
        self._share = 0.0
        self._share_out()

    def divide_again(self, lower: NDArray, upper: NDArray) -> None:
        """Divide the particles along the longest axis of the box between two corners [m]."""
        x: NDArray[Any] = self._state.x.numpy()
        layer = layers(np.clip(x, lower, upper), int(np.argmax(upper - lower)), self._model.dx)
        orders = [
            group.start + np.argsort(layer[group.particles], kind="stable")
            for group in self._model.groups
        ]
        self.divide(np.concatenate(orders))

    def fit(self, rows: NDArray[np.float64], *, force: bool) -> bool:
        """Fit each worker's nodes (slabs) to its particles; return whether the nodes changed.

        `rows` [parts,COUNT] are measurements. `force` is true if the common window has changed.
        """
        reaches = [self._reach(part, row) for part, row in zip(self.parts, rows, strict=True)]
        if not force and all(map(_has_space, self.parts, reaches)):
            return False
        # All slabs are fitted at the same time, so that none of them has to be fitted again soon.
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
        """Return the nodes that a part's particles can use; None if all are outliers."""
        grid = self._grids[part.group.body]
        return grid.reach(*Maxima.of(row).corners) if np.isfinite(row).all() else None

    def place(self, boxes: Sequence[tuple[NDArray, NDArray]]) -> None:
        """Allocate cleared nodes for each slab; `boxes` are the slabs' lowest nodes and
        sizes [3].
        """
        rooms = [-(-(int(np.prod(size)) + GAP) // LINE) * LINE for _, size in boxes]
        starts = [0, *itertools.accumulate(rooms)]
        device = self._model.device
        self.pool = wp.zeros(starts[-1], dtype=self.pool.dtype, device=device)
        self.boxes, self.starts = [], []
        for body in range(self._model.bodies):
            slabs = [i for i, part in enumerate(self.parts) if part.group.body == body]
            corners = np.array([corner for i in slabs for corner in boxes[i]], np.int32)
            self.boxes.append(wp.array(corners.reshape(-1, 3), dtype=wp.vec3i, device=device))
            self.starts.append(wp.array([starts[i] for i in slabs], dtype=int, device=device))
        for part, (low, size), start, room in zip(self.parts, boxes, starts, rooms, strict=False):
            part.nodes.use(np.array(low), np.array(size), self._nodes(start, start + room))
        ends = itertools.accumulate((len(worker.parts) for worker in self.workers), initial=0)
        self.runs = [self._nodes(starts[a], starts[b]) for a, b in itertools.pairwise(ends)]

    def _nodes(self, first: int, last: int) -> wp.array:
        return cast("wp.array", self.pool[first:last])

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot of the state, as plain data and arrays."""
        boxes = [[part.nodes.low.tolist(), part.nodes.size.tolist()] for part in self.parts]
        count = len(self.workers)
        return {"workers": count, "owner": self._owner.copy(), "share": self._share, "boxes": boxes}

    def restore(self, snapshot: dict[str, Any]) -> bool:
        """Restore the division from a snapshot; return False if the number of workers differs."""
        if snapshot.get("workers") != len(self.workers):
            self.divide()
            return False
        owner = np.asarray(snapshot["owner"], np.int16)
        if not np.array_equal(owner, self._owner):
            self._owner = owner.copy()
            self._share_out()
        self._share = snapshot["share"]
        self.place([(np.array(low), np.array(size)) for low, size in snapshot["boxes"]])
        return True

    def _share_out(self) -> None:
        for index, worker in enumerate(self.workers):
            parts = (self._part(index, group) for group in self._model.dry_groups)
            worker.parts = [part for part in parts if part is not None]

    def _part(self, index: int, group: Group) -> Part | None:
        model = self._model
        members = np.flatnonzero(self._owner[group.particles] == index)
        if len(members) == 0:
            return None
        first, last = int(members[0]), int(members[-1]) + 1
        run, chosen = slice(group.start + first, group.start + last), members[:0]
        if last - first > len(members):
            run, chosen = group.particles, members
        nodes = Grid(model.origin, model.dx, real=model.real, device=model.device)
        place = COUNT * model.groups.index(group)
        maxima = cast("wp.array", self.workers[index].maxima[place : place + COUNT])
        indices = wp.array(chosen.astype(np.int32), dtype=int, device=model.device)
        return Part(group, run, indices, len(members), nodes, maxima)


def lone_worker(model: Model, grids: Sequence[Grid]) -> Worker:
    """Return a single worker, which scatters all particles directly to the bodies' grids."""
    maxima = numbers(COUNT * len(grids), model)
    every = wp.zeros(0, dtype=int, device=model.device)
    parts = []
    for group in model.dry_groups:
        row = cast("wp.array", maxima[COUNT * group.body : COUNT * (group.body + 1)])
        parts.append(Part(group, group.particles, every, len(group), grids[group.body], row))
    return Worker(maxima, numbers(SPEEDS, model), parts)


def numbers(count: int, model: Model) -> wp.array:
    """Return an array of zeros in the model's precision [count]."""
    return wp.zeros(count, dtype=model.real, device=model.device)


def usable_workers(particles: int, device: str, asked: int | None = None) -> int:
    """Return the requested or, by default, the fastest number of workers; 1 on a GPU."""
    if device != "cpu":
        return 1
    if asked is not None:
        return asked
    enough = particles // MIN_PARTICLES
    return 1 if enough < 2 else min(enough, free_cores())


def run_timed(timings: Timings, name: str, work: Callable[[], Result]) -> Result:
    """Run `work`, add its duration to a stage, and return its result."""
    start = time.perf_counter()
    result = work()
    entry = timings.setdefault(name, [0.0, 0])
    entry[0] += time.perf_counter() - start
    entry[1] += 1
    return result


def add_timings(parts: Iterable[Timings]) -> Timings:
    """Return the sums of the seconds and kernel launches of each stage."""
    total: Timings = {}
    for part in parts:
        for name, (seconds, launches) in part.items():
            before = total.get(name, [0.0, 0])
            total[name] = [before[0] + seconds, before[1] + launches]
    return total


def run_launches(timings: Timings, named: Sequence[Named]) -> None:
    """Run kernel launches in order, and add up their times.

    The time between two launches counts as time of the later launch.
    """
    before = time.perf_counter()
    for name, launch in named:
        launch()
        after = time.perf_counter()
        entry = timings.setdefault(name, [0.0, 0])
        entry[0] += after - before
        entry[1] += 1
        before = after


def layers(x: NDArray, axis: int, dx: float) -> NDArray[np.int16]:
    """Return the layer of each point [P]; cells with side dx [m] form layers along an axis."""
    layer = np.floor((x[:, axis] - x[:, axis].min()) / dx)
    return np.minimum(layer, np.iinfo(np.int16).max).astype(np.int16)


def _has_space(part: Part, reach: tuple[NDArray, NDArray] | None) -> bool:
    """Return whether the margin around a part's particles suffices until the next measurement."""
    if reach is None:
        return True
    nodes, (low, high) = part.nodes, reach
    spare = min((low - nodes.low).min(), (nodes.low + nodes.size - high).min())
    return bool(spare >= MARGIN // 2)
