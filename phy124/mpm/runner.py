"""Runs the phases of a substep, and other tasks, on all workers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from phy124.mpm.threads import Team
from phy124.mpm.workers import Timings, run_timed

Task = Callable[[int, int], None]
"""Function that runs a task (a phase or another task) of a worker, by numbers of worker and task.
"""


class Runner:
    """Runs all workers one after another, or on separate threads that wait for each other between
    phases.
    """

    def __init__(self, count: int, work: Task, timings: Timings) -> None:
        """Prepare the threads.

        Args:
            count: Number of workers.
            work: Function that runs a phase or another task of one worker.
            timings: Stages of the first worker, to which the waiting time is added.
        """
        self.team = Team[int](count, work)
        self._work, self._timings = work, timings

    def on_threads(self) -> AbstractContextManager[None]:
        """Return a context within which each worker runs on a separate thread.

        All kernels that the workers launch must have been loaded.
        """
        return self.team.running() if self.team.size > 1 else nullcontext()

    def run(self, phase: int) -> None:
        """Run a phase after all threads have reached it."""
        if self.team.alive:
            run_timed(self._timings, "wait", lambda: self.team.put(phase))
            self._work(0, phase)
        else:
            self._run_in_turn(phase)

    def join(self) -> None:
        """Wait for the other threads."""
        if self.team.alive:
            run_timed(self._timings, "wait", self.team.join)

    def complete(self, task: int) -> None:
        """Run a task on all workers and wait; no stage includes the waiting time."""
        if self.team.alive:
            self.team.put(task)
            self._work(0, task)
            self.team.join()
        else:
            self._run_in_turn(task)

    def _run_in_turn(self, task: int) -> None:
        for member in range(self.team.size):
            self._work(member, task)
