"""The processor's cores that this process may use, and those that nobody else wants right now."""

from __future__ import annotations

import os
import time
from pathlib import Path

from phy124.errors import InputError
from phy124.runtime.cgroups import cpu_quota

MOST_THREADS = 256
"""Largest number of threads that may be asked for."""
SIBLINGS = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
"""Where Linux lists the hardware threads that share the core of one of them."""


def cores() -> int:
    """How many hardware threads this process may keep busy: those it may run on, and no more than
    the quota of its control groups pays for.
    """
    return _within_quota(_hardware_threads())


def physical_cores() -> int:
    """How many cores these belong to; all count as cores where the system does not tell."""
    try:
        mine = os.sched_getaffinity(0)
        return _within_quota(len({Path(SIBLINGS.format(one)).read_text() for one in mine}))
    except (AttributeError, OSError):
        return cores()


def free_cores() -> int:
    """How many of these no other program's thread wants right now; at least one."""
    # Others of the machine do not use up this process's quota.
    return max(1, min(physical_cores(), _hardware_threads() - _others_running()))


def _hardware_threads() -> int:
    """How many hardware threads this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _within_quota(threads: int) -> int:
    """So many threads, or as many as the quota pays for in full: they wait for each other."""
    return max(1, int(min(threads, cpu_quota())))


def refuse_threads(threads: int | None) -> None:
    """Make sure that so many threads can be used; None: as many as suit.

    Raises:
        InputError: They are none, or too many.
    """
    if threads is None or 1 <= threads <= MOST_THREADS:
        return
    limit = f"a run takes 1 to {MOST_THREADS} threads."
    remedy = f"Give at most the number of cores, {cores()} here, or leave it out."
    raise InputError("threads", threads, limit, remedy)


def _others_running() -> int:
    """Number of other programs' threads that want a core; 0 where the system does not tell."""
    counts = []
    for _ in range(5):
        try:
            running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
            # Threads that libraries in this process leave spinning for a moment do not count.
            own = [path.read_text("latin-1") for path in Path("/proc/self/task").glob("*/stat")]
        except OSError:
            return 0
        counts.append(int(running) - sum(text.rpartition(")")[2].split()[0] == "R" for text in own))
        time.sleep(0.002)
    return max(0, min(counts))
