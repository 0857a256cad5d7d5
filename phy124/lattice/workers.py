"""Workers: the points and nodes that each thread processes, and the launches of each thread."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp

from phy124.mpm.model import Model
from phy124.mpm.stage import Named
from phy124.mpm.threads import Team
from phy124.mpm.workers import Timings, run_launches

MEASURE, PLACE = -1, -2
"""Tasks that are not phases of a substep: measure the points' motion, and place the points."""


@dataclass
class Worker:
    """The points and nodes of one thread, and the thread's kernel launches."""

    points: slice
    """Range of indices of the worker's points; the points fill a whole number of cells."""
    nodes: slice
    """Range of indices of the nodes that the worker moves."""
    touched: slice
    """Range of indices of the nodes that the worker's cells use."""
    forces: wp.array
    """Forces on the nodes due to the stress in the worker's cells, N."""
    pushes: wp.array
    """Forces on the nodes due to pushes on the worker's points, N."""
    maxima: wp.array
    """Largest speed and strain rate of the worker's points."""
    reach: Any = None
    """Cells, points and nodes that forces reach (`Reach`); None before forces are known."""
    phases: list[list[Named]] = field(default_factory=list)
    """Kernel launches of a substep, for each phase; threads wait for each other between phases."""
    tasks: dict[int, list[Named]] = field(default_factory=dict)
    """Kernel launches of each task that is not a phase; the keys are negative."""
    timings: Timings = field(default_factory=dict)

    def run(self, task: int) -> None:
        """Run a phase of a substep, or another task."""
        if task >= 0:
            run_launches(self.timings, self.phases[task])
            return
        for _, launch in self.tasks[task]:
            launch()


class Division:
    """Prepares kernels whose threads are divided among all workers."""

    def __init__(self, model: Model, team: Team) -> None:
        self._model, self._team = model, team

    def record(
        self, kernel: Any, most: int, inputs: list[Any], outputs: list[Any]
    ) -> Callable[[int], None]:
        """Return a function that runs a kernel with a chosen number of threads.

        Args:
            kernel: The kernel; its first argument is the index of its first thread.
            most: Largest number of threads, at least 1.
            inputs: The other arguments that the kernel reads.
            outputs: Arguments that the kernel writes.
        """
        team = self._team
        shares: list[Any] = [
            self._model.launch(kernel, most, [0, *inputs], outputs) for _ in range(team.size)
        ]

        def run(count: int) -> None:
            edges = np.linspace(0, count, team.size + 1).astype(int).tolist()
            for share, first, last in zip(shares, edges, edges[1:], strict=False):
                share.set_param_at_index(0, first)
                share.set_dim(max(1, last - first))

            def launch_share(member: int) -> None:
                if edges[member + 1] > edges[member]:
                    shares[member].launch()

            team.complete(launch_share)

        return run
