"""A second thread that works through a queue in step with the first, and their barrier.

Warp's CPU kernels release Python's global lock, so two threads can run kernels at the same time.
The barrier spins inside a kernel, since putting a thread to sleep and waking it would take longer
than a phase of a substep.
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
"""Spins of a barrier that only yield the core, and how long it sleeps between further ones [s]."""
Task = TypeVar("Task")


class SecondThread(Generic[Task]):
    """Runs `work` on one task after another while the thread that puts them goes on.

    Load every kernel that `work` launches before entering `running`, since loading is not
    thread-safe.
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
        """Within this context, tasks can be put."""
        # An error may be left from the last time, if another one was raised before.
        self._barrier, self._queue, self._error = Barrier(2), [], None
        thread = threading.Thread(target=self._follow, args=(self._barrier,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            # Ctrl-C may have ended the first thread anywhere, also between two barriers.
            self._barrier.abandoned = True
            thread.join()
            self._barrier = None

    def put(self, task: Task) -> None:
        """Wait until it has finished its previous task, and let it start this one.

        Raises what the previous task raised.
        """
        self._hand_over(task)

    def join(self) -> None:
        """Wait until it has finished its task; raises what that raised."""
        self._hand_over(None)

    def _hand_over(self, task: Task | None) -> None:
        # A list, since the other thread may read it after the next task has been put.
        self._queue.append(task)
        if self._barrier:
            self._barrier.wait(0)
        error, self._error = self._error, None
        if error:
            raise error

    def _follow(self, barrier: Barrier) -> None:
        """The second thread: runs tasks as they come until the barrier is abandoned."""
        for count in itertools.count():
            if not barrier.wait(1):
                return
            task = self._queue[count]
            try:
                if task is not None:
                    self._work(task)
            except Exception as error:  # The first thread raises it after the barrier.
                self._error = error


class Barrier:
    """A barrier at which a number of threads wait for each other."""

    def __init__(self, parties: int) -> None:
        self._counter = wp.zeros(32, dtype=int, device="cpu")
        self._tickets = [wp.zeros(16, dtype=int, device="cpu") for _ in range(parties)]
        self._views = [ticket.numpy() for ticket in self._tickets]
        self._launches = [self._record(ticket, parties) for ticket in self._tickets]
        self.abandoned = False
        """Whether threads need not wait any more."""

    def _record(self, ticket: wp.array, parties: int) -> Any:
        outputs = [self._counter, ticket]
        return wp.launch(meet, 1, inputs=[parties], outputs=outputs, device="cpu", record_cmd=True)

    def wait(self, party: int) -> bool:
        """Wait until all have arrived; False if the barrier was abandoned."""
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
    """Yield the core to another thread that wants it."""
    os.sched_yield() if hasattr(os, "sched_yield") else time.sleep(0)


def free_cores() -> int:
    """Number of this process's cores that no other program's thread wants right now."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return cores - _others_running()


def _others_running() -> int:
    """Number of other programs' threads that want a core; 0 where the system does not tell."""
    counts = []
    for _ in range(5):
        try:
            running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
            # Threads that libraries in this process leave spinning for a moment do not count.
            own = [path.read_text() for path in Path("/proc/self/task").glob("*/stat")]
        except OSError:
            return 0
        counts.append(int(running) - sum(text.rpartition(")")[2].split()[0] == "R" for text in own))
        time.sleep(0.002)
    return max(0, min(counts))
