"""Workers: each processes a part of the particles and scatters to nodes of its own.

Particles are sorted along x, so each half touches a slab of layers. A worker scatters its part into
private nodes, updates its layers of the shared grid from all private nodes, and then gathers. A
single worker has all particles and scatters to the shared grid. How workers run in parallel:
phy124/mpm/threads.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.maxima import COUNT
from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.model import Group, Model
from phy124.mpm.stage import Named
from phy124.mpm.threads import free_cores

MIN_PARTICLES = 20_000
"""Below this the barriers cost more than the second thread brings."""
SCATTER, UPDATE, GATHER = range(3)
"""The phases of a substep between which workers wait for each other."""
Timings = dict[str, list[float]]
"""Stage -> seconds and number of launches."""


@dataclass
class Worker:
    """A part of the particles, and the launches for it."""

    runs: list[tuple[int, int]]
    """Its part of each group's particles: the first, and one past the last."""
    nodes: Grid
    """The nodes it scatters to: the shared grid if it is alone, otherwise private nodes."""
    maxima: wp.array
    """What measuring its particles finds (phy124/kernels/maxima.py)."""
    phases: list[list[Named]] = field(default_factory=list)
    """Launches of scatter, update and gather."""
    measures: list[wp.Launch] = field(default_factory=list)
    """Launches that measure what limits the substep."""
    timings: Timings = field(default_factory=dict)

    def run(self, phase: int) -> None:
        """Run one phase of a substep."""
        for name, launch in self.phases[phase]:
            timed(self.timings, name, launch)

    def measure(self) -> None:
        """Measure the limits of the substep and the extent of its particles."""
        self.maxima.fill_(-np.inf)
        for launch in self.measures:
            launch.launch()

    def parts(self, groups: Sequence[Group]) -> Iterator[tuple[Group, slice]]:
        """The groups in which it has particles, each with its part."""
        for group, (start, stop) in zip(groups, self.runs, strict=True):
            if stop > start:
                yield group, slice(start, stop)


def make_workers(model: Model, grid: Grid, count: int) -> list[Worker]:
    """One worker that scatters to the shared grid, or several with nodes of their own."""
    workers = []
    for runs in cut([(group.start, group.stop) for group in model.groups], count):
        nodes = grid
        if count > 1:
            nodes = Grid(model.origin, model.dx, real=model.real, device=model.device)
        maxima = wp.zeros(COUNT, dtype=model.real, device=model.device)
        workers.append(Worker(runs, nodes, maxima))
    return workers


def usable_workers(model: Model) -> int:
    """Two on the CPU if there are enough particles and a second core is free, otherwise one."""
    if model.device != "cpu" or len(model) < MIN_PARTICLES:
        return 1
    return 2 if free_cores() >= 2 else 1


def cut(runs: list[tuple[int, int]], parts: int) -> list[list[tuple[int, int]]]:
    """Cuts each run of particles evenly: for each worker, its part of every run."""
    edges = [np.linspace(start, stop, parts + 1).astype(int).tolist() for start, stop in runs]
    return [[(edge[i], edge[i + 1]) for edge in edges] for i in range(parts)]


def fit_part(part: Grid, whole: Grid, lower: NDArray, upper: NDArray, *, force: bool) -> bool:
    """Make private nodes cover a worker's particles with whole layers of the shared window.

    Args:
        part: The private nodes.
        whole: The shared window.
        lower: Lowest corner of the worker's particles [3], m.
        upper: Highest corner [3], m.
        force: Whether the shared window has changed.

    Returns:
        Whether the private nodes changed.
    """
    low, high = whole.reach(lower, upper)
    spare = MARGIN // 2
    roomy = low[0] - part.low[0] >= spare and part.low[0] + part.size[0] - high[0] >= spare
    if part.count and roomy and not force:
        return False
    first = max(int(low[0]) - MARGIN, int(whole.low[0]))
    last = min(int(high[0]) + MARGIN, int(whole.low[0] + whole.size[0]))
    part.rebase(
        np.array([first, *whole.low[1:]]), np.array([max(last - first, 0), *whole.size[1:]])
    )
    return True


def layers_of(workers: Sequence[Worker], grid: Grid) -> list[tuple[int, int] | None]:
    """The layers of the shared grid that each worker updates; None: all."""
    if len(workers) == 1:
        return [None]
    low, layers = grid.low[0], int(grid.size[0])
    first, second = (worker.nodes for worker in workers)
    middle = int((first.low[0] + first.size[0] + second.low[0]) // 2 - low)
    middle = min(max(middle, 0), layers)
    return [(0, middle), (middle, layers)]


def timed(timings: Timings, name: str, work: Callable[[], Any]) -> None:
    """Run `work` and add its duration to a stage."""
    start = time.perf_counter()
    work()
    entry = timings.setdefault(name, [0.0, 0])
    entry[0] += time.perf_counter() - start
    entry[1] += 1
