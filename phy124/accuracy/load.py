"""How busy the machine is, and what that makes of a forecast: a range instead of one number."""

from __future__ import annotations

import os
import statistics
import time
from dataclasses import dataclass
from pathlib import Path

THREADS = 2
"""Threads of a run on the CPU."""
SPIN, LOOKS = 0.1, 5
"""Seconds that are spun to see how much of a core one gets, and how often others are counted."""
ALONE = 0.93
"""Share of a core from which nobody else has it."""
LEAST, MOST = 0.8, 1.5
"""What runs took, in forecasts, where nothing else was at work (docs/results/accuracy.md)."""
BUSY = 1.2
"""How much wider the range is beside others: they come and go within a run."""


@dataclass(frozen=True)
class Load:
    """What others do on this machine."""

    now: float
    """How many times longer a run takes than on a quiet machine, as things are."""

    @classmethod
    def measured(cls, device: str = "cpu") -> Load:
        """From a spin of 0.1 s; a run on a GPU hardly notices others.

        Three views of how many others want a core, of which the median counts: what is left of a
        core knows their priorities, but not of a core that they leave free; a count of what runs
        knows the moment only; the load average knows the last minute, and our own work in it.
        """
        if device != "cpu":
            return cls(1.0)
        cores, (share, counted) = _cores(), _spun()
        squeezed = 0.0 if share > ALONE else max(cores / share - 1, 0.0)
        lately = os.getloadavg()[0] if hasattr(os, "getloadavg") else squeezed
        views = [squeezed, lately, squeezed if counted is None else counted]
        return cls(_slower(statistics.median(views), cores))

    @property
    def busy(self) -> bool:
        """Whether others are at work now."""
        return self.now > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Between what times a run lies that takes `seconds` as things are.

        Others who end or begin meanwhile are not foreseen.
        """
        wider = unsure * (BUSY if self.busy else 1.0)
        return LEAST / wider * seconds, MOST * wider * seconds


def spoken(span: tuple[float, float]) -> str:
    """A span of seconds in words: "12 to 18 s", "1.5 to 2.3 min"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _spun() -> tuple[float, float | None]:
    """Share of a core that one thread gets, and how many others run meanwhile; None: unknown."""
    begun, own, counts = time.perf_counter(), time.thread_time(), []
    for look in range(LOOKS):
        while time.perf_counter() - begun < SPIN * (look + 1) / LOOKS:
            pass
        counts.append(_others())
    share = max((time.thread_time() - own) / (time.perf_counter() - begun), 0.02)
    known = [count for count in counts if count is not None]
    return share, statistics.mean(known) if known else None


def _others() -> int | None:
    """Threads of others that run or wait for a core now; None where the system does not say."""
    try:
        stat = Path("/proc/stat").read_text()
        mine = sum(_runs(task) for task in Path("/proc/self/task").iterdir())
    except OSError:
        return None
    line = next((line for line in stat.splitlines() if line.startswith("procs_running")), None)
    return None if line is None else max(int(line.split()[1]) - mine, 0)


def _runs(task: Path) -> bool:
    try:
        return (task / "stat").read_text().rpartition(")")[2].split()[0] == "R"
    except OSError:
        return False  # The thread has ended.


def _slower(others: float, cores: int) -> float:
    """How many times longer a run takes beside others that want so many cores."""
    return max(1.0, (others + min(THREADS, cores)) / cores)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
