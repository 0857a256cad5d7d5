"""Processes: work that is done side by side by spawned workers, while the caller goes on."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from phy124.runtime.startup import start

BEAT = 0.2
"""Longest time between two calls of `beat` [s]."""
Task = TypeVar("Task")
Result = TypeVar("Result")


@contextmanager
def processes(count: int) -> Iterator[ProcessPoolExecutor]:
    """Within this context, so many processes; what is still at work at its end is stopped.

    Spawned ones, since a forked process would share the threads of Warp.
    """
    before = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - before:
            child.terminate()


def as_done(
    pool: ProcessPoolExecutor,
    work: Callable[[Task], Result],
    tasks: Iterable[Task],
    beat: Callable[[], object],
) -> Iterator[tuple[Task, Result]]:
    """Each task with its result, as soon as there is one.

    Args:
        pool: The processes.
        work: What they do; it must be possible to pickle it.
        tasks: What is to be done, in this order.
        beat: Called often meanwhile; may raise Cancelled.

    Raises:
        OSError: A worker was killed, most likely for want of memory.
    """
    waiting = {pool.submit(work, task): task for task in tasks}
    while waiting:
        done, _ = wait(waiting, BEAT, FIRST_COMPLETED)
        try:
            for future in done:
                yield waiting.pop(future), future.result()
        except BrokenProcessPool:
            told = "a worker process was killed; run the same command with fewer of them"
            raise OSError(told) from None
        beat()


def _begin() -> None:
    """Ctrl-C reaches all processes of a terminal; the first one decides what it means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    start()
