"""Runs tasks in parallel in spawned processes, while the caller continues."""

import multiprocessing
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from phy124.runtime.memory import share_heap
from phy124.runtime.signals import without_signals
from phy124.runtime.startup import start

BEAT = 0.2
"""Longest time between two calls of the function `beat` [s]."""
LEFT = 5.0
"""Longest wait for the exit codes of ended workers [s]."""
CRASHES = {
    getattr(signal, name)
    for name in ("SIGSEGV", "SIGABRT", "SIGBUS", "SIGFPE", "SIGILL")
    if hasattr(signal, name)
}
"""Signals by which a fault of native code ends the process."""
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
        beat: Function that is called at least every `BEAT` seconds; without a pool, it is called
            before each task. The function may raise Cancelled.

    Raises:
        OSError: A worker process was killed, or it ended before its task was finished.
        RuntimeError: A worker process crashed in native code.
    """
    if pool is None:
        for task in tasks:
            beat()
            yield task, work(task)
        return
    try:
        with without_signals(["SIGINT"]):  # the pool ends workers by SIGTERM
            waiting = {pool.submit(work, task): task for task in tasks}
        while waiting:
            done, _ = wait(waiting, BEAT, FIRST_COMPLETED)
            for future in done:
                yield waiting.pop(future), future.result()
            beat()
    except BrokenProcessPool:
        beat()  # a signal to all processes of a command also interrupts this process
        raise explain_end(_exit_codes(pool)) from None


def _exit_codes(pool: ProcessPoolExecutor) -> set[int]:
    """Return the exit codes of a broken pool's workers; a signal is a negative number.

    While a thread of the pool also waits for a worker, the worker's exit code may be missing. This
    function then waits up to `LEFT` seconds for the exit code.
    """
    workers = [*(pool._processes or {}).values()]  # the pool has no public attribute for them
    end = time.monotonic() + LEFT
    for worker in workers:
        worker.join(max(0.0, end - time.monotonic()))
        while worker.exitcode is None and time.monotonic() < end:
            time.sleep(0.01)
    return {worker.exitcode for worker in workers if worker.exitcode is not None}


def explain_end(codes: set[int]) -> Exception:
    """Return the exception for a pool whose workers ended with these exit codes.

    If one worker ends, the pool ends the others by SIGTERM.
    """
    code = min(codes - {0, -signal.SIGTERM}, default=-signal.SIGTERM)
    if code > 0:
        return OSError(f"a worker process ended with status {code}; repeat the command")
    name = signal.Signals(-code).name
    if -code in CRASHES:
        return RuntimeError(f"a worker process crashed in native code ({name})")
    if name == "SIGKILL":
        return OSError(
            "a worker process was killed (SIGKILL), most likely because the memory was full; "
            "repeat the command with fewer processes (--jobs or --workers)"
        )
    return OSError(f"a worker process was ended from outside ({name}); repeat the command")


def _begin() -> None:
    """Start Warp in a worker process, and ignore Ctrl-C, which the parent process handles."""
    share_heap()
    # On Windows, `without_signals` has no effect.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    start()
