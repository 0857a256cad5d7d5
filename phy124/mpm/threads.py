"""A second thread that works through a queue in step with the first, and their barrier.

Warp's CPU kernels release Python's lock, so two threads run kernels at once. The barrier spins
inside a kernel: to sleep and be woken would cost more than a phase of a substep.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Generic, TypeVar

import warp as wp

from phy124.kernels.barrier import meet

ROUNDS, NAP = 20, 5e-5
"""Rounds of spinning at a barrier between which others may have the core, then sleep [s]."""
Task = TypeVar("Task")


class SecondThread(Generic[Task]):
    """Runs `work` on tasks, one after another, beside the thread that puts them.

    Load every kernel that `work` launches before `running`: loading is not safe in two threads.
    """

    def __init__(self, work: Callable[[Task], None]) -> None:
        self._work = work
        self._barrier: Barrier | None = None
        self._queue: list[Task | None] = []
        self._error: Exception | None = None

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._barrier is not None

    @contextmanager
    def running(self) -> Iterator[None]:
        """While inside, tasks can be put."""
        # An error may be left of the last time: nobody asks for one after another was raised.
        self._barrier, self._queue, self._error = Barrier(2), [], None
        thread = threading.Thread(target=self._follow, args=(self._barrier,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            # Wherever the first thread was, Ctrl-C may have ended it between two barriers.
            self._barrier.abandoned = True
            thread.join()
            self._barrier = None

    def put(self, task: Task) -> None:
        """Wait until it has done the task before, and let it begin this one.

        Raises what the task before raised.
        """
        self._hand_over(task)

    def join(self) -> None:
        """Wait until it has done its task; raises what that raised."""
        self._hand_over(None)

    def _hand_over(self, task: Task | None) -> None:
        # A list, since the other thread may read late what is put here.
        self._queue.append(task)
        if self._barrier:
            self._barrier.wait(0)
        error, self._error = self._error, None
        if error:
            raise error

    def _follow(self, barrier: Barrier) -> None:
        """The thread: tasks as they come, until the barrier is abandoned."""
        for count in itertools.count():
            if not barrier.wait(1):
                return
            task = self._queue[count]
            try:
                if task is not None:
                    self._work(task)
            except Exception as error:  # The first thread waits at the barrier, and raises it.
                self._error = error


class Barrier:
    """Where a number of threads wait for each other."""

    def __init__(self, parties: int) -> None:
        self._counter = wp.zeros(32, dtype=int, device="cpu")
        self._tickets = [wp.zeros(16, dtype=int, device="cpu") for _ in range(parties)]
        self._views = [ticket.numpy() for ticket in self._tickets]
        self._launches = [self._record(ticket, parties) for ticket in self._tickets]
        self.abandoned = False
        """Whether nobody needs to wait any more."""

    def _record(self, ticket: wp.array, parties: int) -> Any:
        outputs = [self._counter, ticket]
        return wp.launch(meet, 1, inputs=[parties], outputs=outputs, device="cpu", record_cmd=True)

    def wait(self, party: int) -> bool:
        """Come back when all have arrived; False if they never will."""
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
    """Let another thread have the core, if one wants it."""
    os.sched_yield() if hasattr(os, "sched_yield") else time.sleep(0)


def free_cores() -> int:
    """Cores of this process that no other program's threads want at the moment."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return cores - _others_running()


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
