"""Runs the phases of a substep, and other tasks, on all workers; threads wait for each other."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext

from phy124.lattice.workers import Worker
from phy124.mpm.threads import Team
from phy124.mpm.workers import run_timed

MEASURE, TRIAL = -1, -2
"""Two tasks in addition to the phases: measure the motion, and compute the forces of a trial."""


class Phases:
    """All workers, and the threads on which they run."""

    def __init__(self, workers: Sequence[Worker]) -> None:
        self._workers = workers
        self.team = Team[int](len(workers), self._run_member)

    def on_threads(self) -> AbstractContextManager[None]:
        """Return a context within which each worker runs on its own thread.

        All kernels that the workers launch must have been loaded.
        """
        return self.team.running() if self.team.size > 1 else nullcontext()

    def run(self, phase: int) -> None:
        """Run a phase after all threads have reached it."""
        first = self._workers[0]
        if self.team.alive:
            run_timed(first.timings, "wait", lambda: self.team.put(phase))
            first.run(first.phases[phase])
        else:
            for worker in self._workers:
                worker.run(worker.phases[phase])

    def run_task(self, task: int) -> None:
        """Let all workers measure, or compute the forces of a trial, and wait for them."""
        first = self._workers[0]
        if self.team.alive:
            self.team.put(task)
            _run(first, task)
            self.team.join()
        else:
            for worker in self._workers:
                _run(worker, task)

    def join(self) -> None:
        """Wait for the other threads."""
        if self.team.alive:
            run_timed(self._workers[0].timings, "wait", self.team.join)

    def _run_member(self, member: int, phase: int) -> None:
        """Run a phase or task in one of the other threads."""
        _run(self._workers[member], phase)


def _run(worker: Worker, phase: int) -> None:
    """Run a worker's launches of a phase or task."""
    if phase == TRIAL:  # The stage `frequency` includes the time of trials.
        for _, launch in worker.trials:
            launch()
    else:
        worker.run(worker.measures if phase == MEASURE else worker.phases[phase])
