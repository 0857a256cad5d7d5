"""Lanes: the particles' shares of two CPU threads, each with nodes of its own to scatter to.

Particles are sorted along x, so each half touches a slab of layers. A worker scatters its half into
private nodes, then brings its part of the shared grid up to date from both, then gathers. Between
these phases the threads meet. Warp's CPU kernels release Python's lock.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.barrier import meet
from phy124.mpm.grid import MARGIN, Grid

if TYPE_CHECKING:
    from phy124.mpm.solver import Solver

LEAST_PARTICLES = 20_000
"""Below this the meetings cost more than the second thread brings."""
ROUNDS, NAP = 20, 5e-5
"""Rounds of spinning at a meeting between which others may have the core, then sleep [s]."""
Timings = dict[str, list[float]]
Named = tuple[str, Callable[[], Any]]
Recorded = tuple[str, "wp.Launch | None"]


@dataclass
class Worker:
    """One thread's share."""

    runs: list[tuple[int, int]]
    """Its part of each group's particles, first and past the last."""
    nodes: Grid
    """Where it scatters to: the shared grid if it is alone, else private nodes."""
    maxima: wp.array
    """What `measure` finds among its particles [9]."""
    phases: list[list[Named]] = field(default_factory=list)
    """Work between two meetings: scatter, update, gather."""
    looks: list[wp.Launch] = field(default_factory=list)
    """Measures what limits the substep."""
    timings: Timings = field(default_factory=dict)
    """Seconds and launches by stage."""

    def run(self, phase: int) -> None:
        """One phase of a substep."""
        for name, launch in self.phases[phase]:
            timed(self.timings, name, launch)


class Barrier:
    """A barrier for a number of threads."""

    def __init__(self, parties: int) -> None:
        self.counter = wp.zeros(32, dtype=int, device="cpu")
        self.tickets = [wp.zeros(16, dtype=int, device="cpu") for _ in range(parties)]
        self.views = [ticket.numpy() for ticket in self.tickets]
        self.launches = [self._record(ticket, parties) for ticket in self.tickets]
        self.over = False
        """Whether nobody needs to wait any more."""

    def _record(self, ticket: wp.array, parties: int) -> Any:
        inputs = [self.counter, ticket, parties]
        return wp.launch(meet, 1, inputs=inputs, device="cpu", record_cmd=True)

    def wait(self, who: int) -> bool:
        """Come back when all have arrived; False if they never will."""
        launch, view = self.launches[who], self.views[who]
        launch.launch()
        spun = 0
        while view[0]:
            if self.over:
                return False
            spun += 1
            give_way() if spun < ROUNDS else time.sleep(NAP)
            launch.launch()
        return True


def give_way() -> None:
    """Let another thread have the core, if one wants it; to sleep would cost more than a phase."""
    os.sched_yield() if hasattr(os, "sched_yield") else time.sleep(0)


def timed(timings: Timings, name: str, work: Callable[[], Any]) -> None:
    """Do work and add its seconds to a stage."""
    start = time.perf_counter()
    work()
    entry = timings.setdefault(name, [0.0, 0])
    entry[0] += time.perf_counter() - start
    entry[1] += 1


def usable_threads(particles: int) -> int:
    """Two if there are enough particles and a second core is free, else one."""
    if particles < LEAST_PARTICLES:
        return 1
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return 2 if cores - _others_running() >= 2 else 1


def _others_running() -> int:
    """Threads of other programs that want a core right now; 0 where the system does not tell."""
    counts = []
    for _ in range(5):
        try:
            running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
            # Libraries leave threads of ours spinning for a moment; they are not others.
            own = [path.read_text() for path in Path("/proc/self/task").glob("*/stat")]
        except OSError:
            return 0
        counts.append(int(running) - sum(text.rpartition(")")[2].split()[0] == "R" for text in own))
        time.sleep(0.002)
    return max(0, min(counts))


def cut(runs: list[tuple[int, int]], workers: int) -> list[list[tuple[int, int]]]:
    """Each run of particles cut evenly: for each worker its part of every run."""
    edges = [np.linspace(start, stop, workers + 1).astype(int).tolist() for start, stop in runs]
    return [[(edge[i], edge[i + 1]) for edge in edges] for i in range(workers)]


def fit_part(part: Grid, whole: Grid, lower: NDArray, upper: NDArray, *, force: bool) -> bool:
    """Make private nodes cover a worker's particles, whole layers of the shared window.

    True if they changed; `force` if the shared window did.
    """
    low, high = whole.reach(lower, upper)
    least = MARGIN // 2
    roomy = low[0] - part.low[0] >= least and part.low[0] + part.size[0] - high[0] >= least
    if part.count and roomy and not force:
        return False
    first = max(int(low[0]) - MARGIN, int(whole.low[0]))
    last = min(int(high[0]) + MARGIN, int(whole.low[0] + whole.size[0]))
    part.rebase(
        np.array([first, *whole.low[1:]]), np.array([max(last - first, 0), *whole.size[1:]])
    )
    return True


def grids(solver: Solver) -> list[Grid]:
    """The shared grid, and the private ones of workers that have them."""
    private = [worker.nodes for worker in solver.workers if worker.nodes is not solver.grid]
    return [solver.grid, *private]


def taken(records: Iterable[Recorded]) -> list[tuple[str, wp.Launch]]:
    """Without the boundaries that are out of reach of the window: they have no launch."""
    return [(name, launch) for name, launch in records if launch is not None]


def work(records: Iterable[Recorded]) -> list[Named]:
    """What to call for each record."""
    return [(name, launch.launch) for name, launch in taken(records)]
