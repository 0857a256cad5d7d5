"""Workers: the points and nodes that each thread processes, and the launches of each thread."""

from dataclasses import dataclass, field

import warp as wp

from phy124.mpm.stage import Named
from phy124.mpm.workers import Timings, run_launches

MEASURE, PLACE = -1, -2
"""Two tasks besides the phases: to measure the points' motion, and to place the points."""


@dataclass
class Worker:
    """The points and nodes of one thread, and the thread's launches."""

    points: slice
    """Span of the worker's points; the points fill a whole number of cells."""
    nodes: slice
    """Span of the nodes that the worker moves."""
    touched: slice
    """Span of the nodes that the worker's cells use."""
    forces: wp.array
    """Forces of the stress in the worker's cells on the nodes, N."""
    pushes: wp.array
    """Forces on the nodes due to pushes on the worker's points, N."""
    maxima: wp.array
    """Largest speed and strain rate of the worker's points."""
    phases: list[list[Named]] = field(default_factory=list)
    """Launches of a substep by phase; threads wait for each other between phases."""
    tasks: dict[int, list[Named]] = field(default_factory=dict)
    """Launches of the other tasks; their numbers are negative, and their callers time them."""
    timings: Timings = field(default_factory=dict)

    def run(self, task: int) -> None:
        """Run a phase or another task."""
        if task >= 0:
            run_launches(self.timings, self.phases[task])
            return
        for _, launch in self.tasks[task]:
            launch()
