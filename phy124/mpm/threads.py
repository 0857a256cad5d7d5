"""A team of threads, which run a task in parallel and wait at a barrier before the next task.

Warp's CPU kernels release Python's global lock, so several threads can run kernels at the same
time. The barrier spins inside a kernel, since putting a thread to sleep would take longer than a
phase of a substep.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp

from phy124.kernels.reduction import meet
from phy124.runtime.cores import cores

ROUNDS = 20
"""Number of spins in which a waiting thread only yields its core."""
NAP = 5e-5
"""Time that a waiting thread sleeps between later spins [s]."""
SPINS = 100_000
"""Number of checks of the barrier per spin if every thread has a core to itself. If threads share
cores, a spin has one check.
"""
Task = Callable[[int], None]
"""Function that runs a member's part of a task; the argument is the member's index."""


class Team:
    """Runs tasks on a separate thread for each member; member 0 is the caller's thread.

    The caller starts a task for the other members with `put`, and executes the part of member 0
    itself. The next call of `put` first waits for the other members. Before entering `running`,
    load every kernel that tasks launch, since loading is not thread-safe.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._barrier: Barrier | None = None
        self._tasks: list[Task | None] = [None, None]
        """The last two tasks of the team, since members may read a task after the next task has
        started. The tasks are discarded when the threads end, because tasks keep arrays in memory.
        """
        self._started = 0
        self._errors: list[BaseException | None] = []
        """Exception that each member's last task raised, or None."""
        self.seconds = [0.0] * size
        """CPU time that each member except the first has used [s]."""

    @property
    def alive(self) -> bool:
        """Whether the threads are running."""
        return self._barrier is not None

    @contextmanager
    def running(self) -> Iterator[None]:
        """Start the threads; tasks can be started with `put` within this context."""
        # Errors of the previous context may remain if another error was raised first.
        self._barrier, self._started = Barrier(self.size), 0
        self._errors = [None] * self.size
        threads = [
            threading.Thread(target=self._follow, args=(self._barrier, member), daemon=True)
            for member in range(1, self.size)
        ]
        try:
            for thread in threads:
                thread.start()
            yield
        finally:
            # Ctrl-C may have stopped the first thread at any point, even between two barriers.
            self._barrier.abandoned = True
            for thread in threads:
                if thread.ident is not None:
                    thread.join()
            self._barrier, self._tasks = None, [None, None]

    def put(self, task: Task) -> None:
        """Wait until all members have finished the previous task, then start a task.

        An exception of the previous task is re-raised.
        """
        self._hand_over(task)

    def join(self) -> None:
        """Wait until all members have finished; re-raise any exception."""
        self._hand_over(None)

    def complete(self, task: Task) -> None:
        """Run a task for all members and wait; without threads, the members run in turn."""
        if self.alive:
            self.put(task)
            task(0)
            self.join()
        else:
            for member in range(self.size):
                task(member)

    def _hand_over(self, task: Task | None) -> None:
        self._tasks[self._started % 2] = task
        self._started += 1
        if self._barrier:
            self._barrier.wait(0)
        first = next((error for error in self._errors if error is not None), None)
        if first is not None:
            self._errors = [None] * self.size
            raise first

    def _follow(self, barrier: Barrier, member: int) -> None:
        """Run tasks in one of the other threads until the barrier is abandoned."""
        before = self.seconds[member]
        for count in itertools.count():
            self.seconds[member] = before + time.thread_time()
            if not barrier.wait(member):
                return
            task = self._tasks[count % 2]
            try:
                if task is not None:
                    task(member)
            except (
                BaseException
            ) as error:  # The first thread raises the exception after the barrier.
                self._errors[member] = error


class Barrier:
    """A barrier at which a fixed number of threads wait for each other."""

    def __init__(self, parties: int) -> None:
        self._counter = wp.zeros(32, dtype=int, device="cpu")
        self._tickets = [wp.zeros(16, dtype=int, device="cpu") for _ in range(parties)]
        self._views = [ticket.numpy() for ticket in self._tickets]
        spins = SPINS if parties <= cores() else 1
        self._launches = [self._record(ticket, parties, spins) for ticket in self._tickets]
        self.abandoned = False
        """Whether threads that wait at a barrier should stop waiting."""

    def _record(self, ticket: wp.array, parties: int, spins: int) -> Any:
        inputs, outputs = [parties, spins], [self._counter, ticket]
        return wp.launch(meet, 1, inputs=inputs, outputs=outputs, device="cpu", record_cmd=True)

    def wait(self, party: int) -> bool:
        """Wait until all threads have arrived; return False if the barrier was abandoned."""
        launch, view = self._launches[party], self._views[party]
        launch.launch()
        spun = 0
        while view[0]:
            if self.abandoned:
                return False
            spun += 1
            give_way() if spun < ROUNDS else time.sleep(NAP)
            launch.launch()
        return True


def give_way() -> None:
    """Yield the core to another waiting thread."""
    os.sched_yield() if hasattr(os, "sched_yield") else time.sleep(0)
