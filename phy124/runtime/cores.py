"""Counts the CPU cores that this process may use, and how many of them are free."""

import os
import time
from pathlib import Path

from phy124.errors import InputError
from phy124.runtime.cgroups import cpu_quota

MOST_THREADS = 256
"""Maximum number of threads of a run."""
SIBLINGS = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
"""File in which Linux lists the hardware threads of a core."""


def cores() -> int:
    """Return the number of hardware threads for this process, limited by its cgroups' quota."""
    return _within_quota(_hardware_threads())


def physical_cores() -> int:
    """Return the number of physical cores for this process; if unknown, of hardware threads."""
    try:
        mine = os.sched_getaffinity(0)
        return _within_quota(len({Path(SIBLINGS.format(thread)).read_text() for thread in mine}))
    except (AttributeError, OSError):
        return cores()


def free_cores() -> int:
    """Return the number of usable cores that no other program uses, at least 1."""
    # The quota limits only this process, so other programs do not count.
    return max(1, min(physical_cores(), _hardware_threads() - _others_running()))


def _hardware_threads() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _within_quota(threads: int) -> int:
    """Limit a number of threads to the number of whole CPUs in the quota.

    A thread on a fraction of a CPU would delay the other threads.
    """
    return max(1, int(min(threads, cpu_quota())))


def refuse_threads(threads: int | None) -> None:
    """Check that a number of threads is possible; None: chosen automatically.

    Raises:
        InputError: The number is below 1 or above `MOST_THREADS`.
    """
    if threads is None or 1 <= threads <= MOST_THREADS:
        return
    limit = f"a run can use 1 to {MOST_THREADS} threads."
    remedy = f"Choose at most the number of cores, {cores()} here, or remove the option."
    raise InputError("threads", threads, limit, remedy)


def _others_running() -> int:
    """Return the number of running threads of other programs; 0 if the number is unknown."""
    counts = []
    for _ in range(5):
        try:
            running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
            # This process's threads are subtracted, because threads of libraries may spin briefly.
            stats = [path.read_text("latin-1") for path in Path("/proc/self/task").glob("*/stat")]
        except OSError:
            return 0
        counts.append(
            int(running) - sum(text.rpartition(")")[2].split()[0] == "R" for text in stats)
        )
        time.sleep(0.002)
    return max(0, min(counts))
