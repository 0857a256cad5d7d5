"""Runs tasks in parallel in spawned processes, while the caller continues."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from phy124.runtime.memory import share_heap
from phy124.runtime.startup import start

BEAT = 0.2
"""Longest time between two calls of the function `beat` [s]."""
Task = TypeVar("Task")
Result = TypeVar("Result")


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor | None]:
    """Provide a pool of `count` processes, which are terminated at the end of the context.

    The processes are spawned, because a forked process would contain the threads of Warp. If
    `count` is 0 or 1, there is no pool, and `as_done` runs the tasks in this process.
    """
    if count < 2:
        yield None
        return
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()


def as_done(
    pool: ProcessPoolExecutor | None,
    work: Callable[[Task], Result],
    tasks: Iterable[Task],
    beat: Callable[[], object],
) -> Iterator[tuple[Task, Result]]:
    """Yield each task with its result as soon as the task is finished.

    Args:
        pool: The processes; if None, the tasks run one after another in this process.
        work: The function to run; it must be picklable if there is a pool.
        tasks: The arguments of the calls, in order.
        beat: Function that is called at least every `BEAT` seconds, or before each task if there is
            no pool; it may raise Cancelled.

    Raises:
        OSError: A worker process was killed, most likely because of a lack of memory.
    """
    if pool is None:
        for task in tasks:
            beat()
            yield task, work(task)
        return
    waiting = {pool.submit(work, task): task for task in tasks}
    while waiting:
        done, _ = wait(waiting, BEAT, FIRST_COMPLETED)
        try:
            for future in done:
                yield waiting.pop(future), future.result()
        except BrokenProcessPool:
            text = "a worker process was killed; run the same command with fewer workers"
            raise OSError(text) from None
        beat()


def _begin() -> None:
    """Start Warp in a worker process, and ignore Ctrl-C, which the parent process handles."""
    share_heap()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    start()
