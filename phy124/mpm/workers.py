"""Workers: each processes a part of the particles and scatters to nodes of its own.

A worker scatters its particles into private nodes, updates its layers of the shared grid from all
private nodes, and then gathers. A single worker has all particles and scatters to the shared grid.
Which particles and nodes several workers have: phy124/mpm/slabs.py. How they run in parallel:
phy124/mpm/threads.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeVar, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.measure import COUNT, SPEEDS
from phy124.mpm.grid import Grid
from phy124.mpm.model import Group, Model
from phy124.mpm.stage import Named
from phy124.runtime.cores import free_cores

MIN_PARTICLES = 10_000
"""Of a worker; with fewer, its barriers cost more than it brings."""
GATHER = -1
"""The last phase of a substep; workers wait for each other between phases."""
SCHEDULE, WINDOW, REPAIR, FOLLOW = HOST = ("schedule", "window", "repair", "follow")
"""Stages of the host: the choice of substeps and all else between launches, the recording of
launches for a window that has moved, the mending of broken deformations, and what is called after
each substep: progress, budget and observers."""
Result = TypeVar("Result")
Timings = dict[str, list[float]]
"""Stage -> seconds and number of launches."""


@dataclass
class Part:
    """The particles of one group that a worker processes."""

    group: Group
    particles: slice
    """The run of particles that holds them."""
    chosen: wp.array
    """Which of these they are; empty: all."""
    count: int
    """How many they are."""
    nodes: Grid
    """The nodes they are scattered to: the shared grid of the body, or nodes of their own."""
    maxima: wp.array
    """What measuring them finds (phy124/kernels/measure.py)."""

    def indices(self) -> slice | NDArray[np.int64]:
        """Indices of its particles among all."""
        if len(self.chosen) == 0:
            return self.particles
        return self.particles.start + np.asarray(self.chosen.numpy(), np.int64)

    def among(self, indices: NDArray[np.int32]) -> NDArray[np.int32]:
        """Those of some particles that belong to it."""
        run = self.particles
        if len(self.chosen) == 0:
            return indices[(indices >= run.start) & (indices < run.stop)]
        return indices[np.isin(indices, run.start + self.chosen.numpy())]


@dataclass
class Worker:
    """Some of the particles, and the launches for them."""

    maxima: wp.array
    """What measuring finds: `COUNT` numbers for each body, or for each of its parts."""
    speeds: wp.array
    """Results of measuring the speeds alone [SPEEDS]."""
    parts: list[Part] = field(default_factory=list)
    phases: list[list[Named]] = field(default_factory=list)
    """Launches of pushes, if any; of scatter; of update and walls in one or more; of gather."""
    measures: list[wp.Launch] = field(default_factory=list)
    """Launches that measure what limits the substep."""
    glances: list[wp.Launch] = field(default_factory=list)
    """Launches that measure speeds only."""
    timings: Timings = field(default_factory=dict)

    def run(self, phase: int) -> None:
        """Run one phase of a substep; what lies between two launches counts for the second."""
        before = time.perf_counter()
        for name, launch in self.phases[phase]:
            launch()
            after = time.perf_counter()
            entry = self.timings.setdefault(name, [0.0, 0])
            entry[0] += after - before
            entry[1] += 1
            before = after

    def measure(self) -> None:
        """Measure the limits of the substep and the extent of its particles."""
        self.maxima.fill_(-np.inf)
        for launch in self.measures:
            launch.launch()

    def glance(self) -> None:
        """Measure the speeds and velocity gradients of its particles."""
        self.speeds.zero_()
        for launch in self.glances:
            launch.launch()


def lone_worker(model: Model, grids: Sequence[Grid]) -> Worker:
    """One worker that scatters all particles to the shared grid of their body."""
    maxima = numbers(COUNT * len(grids), model)
    every = wp.zeros(0, dtype=int, device=model.device)
    parts = []
    for group in model.groups:
        own = cast("wp.array", maxima[COUNT * group.body : COUNT * (group.body + 1)])
        parts.append(Part(group, group.particles, every, len(group), grids[group.body], own))
    return Worker(maxima, numbers(SPEEDS, model), parts)


def numbers(count: int, model: Model) -> wp.array:
    """Zeros in the model's precision [count]."""
    return wp.zeros(count, dtype=model.real, device=model.device)


def usable_workers(particles: int, device: str, asked: int | None = None) -> int:
    """As many as are asked for, or as have a free core and enough particles; one on a GPU."""
    if device != "cpu":
        return 1
    if asked is not None:
        return asked
    enough = particles // MIN_PARTICLES
    return 1 if enough < 2 else min(enough, free_cores())


def timed(timings: Timings, name: str, work: Callable[[], Result]) -> Result:
    """Run `work`, add its duration to a stage, and return its result."""
    start = time.perf_counter()
    result = work()
    entry = timings.setdefault(name, [0.0, 0])
    entry[0] += time.perf_counter() - start
    entry[1] += 1
    return result
