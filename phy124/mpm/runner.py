"""Runs the phases of a substep, and other tasks, on all workers."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

from phy124.mpm.threads import Task, Team
from phy124.mpm.workers import Timings, run_timed


class Worker(Protocol):
    """The phases and other tasks of one thread (worker)."""

    timings: Timings

    def run(self, task: int, /) -> None:
        """Run the phase or other task with a number."""
        ...


class Runner:
    """Runs all workers one after another, or on threads that wait for each other after phases."""

    def __init__(self, workers: Sequence[Worker]) -> None:
        """Prepare the threads; waiting times are added to the stages of the first worker."""
        self.team = Team(len(workers))
        self._workers = workers

    def on_threads(self) -> AbstractContextManager[None]:
        """Return a context within which each worker runs on a separate thread.

        All kernels that the workers launch must have been loaded.
        """
        return self.team.running() if self.team.size > 1 else nullcontext()

    def run(self, phase: int) -> None:
        """Run a phase of a substep after all threads have reached it."""
        task = self._task(phase)
        if self.team.alive:
            run_timed(self._workers[0].timings, "wait", lambda: self.team.put(task))
            task(0)
        else:
            self.team.complete(task)

    def join(self) -> None:
        """Wait for the other threads."""
        if self.team.alive:
            run_timed(self._workers[0].timings, "wait", self.team.join)

    def complete(self, number: int) -> None:
        """Run a task on all workers and wait; reports do not count the waiting time."""
        self.team.complete(self._task(number))

    def _task(self, number: int) -> Task:
        workers = self._workers
        return lambda member: workers[member].run(number)
