"""How busy the machine is, and what that makes of a forecast: a range instead of one number."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

THREADS = 2
"""Threads of a run on the CPU."""
SPIN = 0.03
"""Seconds that are spun to see how much of a core one gets."""
ALONE = 0.93
"""Share of a core from which nobody else is at work."""
LEAST, MOST = 0.85, 1.2
"""What runs took, in forecasts, where nothing else was at work (docs/accuracy.md)."""


@dataclass(frozen=True)
class Load:
    """What others do on this machine."""

    now: float
    """How many times longer a run takes than on a quiet machine, as things are."""
    lately: float
    """The same by the load of the last minute."""

    @classmethod
    def measured(cls, device: str = "cpu") -> Load:
        """From a spin of 30 ms and the load average; a run on a GPU hardly notices others."""
        if device != "cpu":
            return cls(1.0, 1.0)
        cores, share = _cores(), _share()
        others = 0.0 if share > ALONE else max(cores / share - 1, 0.0)
        load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
        return cls(_slower(others, cores), _slower(load, cores))

    @property
    def busy(self) -> bool:
        """Whether others are at work now."""
        return self.now > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Between what times a run lies that takes `seconds` as things are.

        At best the others end now; at worst all of the last minute come back.
        """
        worse = max(1.0, self.lately / self.now)
        return LEAST / unsure * seconds / self.now, MOST * unsure * worse * seconds


def spoken(span: tuple[float, float]) -> str:
    """A span of seconds in words: "12 to 18 s", "1.5 to 2.3 min"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _share() -> float:
    """Share of a core that one thread gets."""
    begun, own = time.perf_counter(), time.thread_time()
    while time.perf_counter() - begun < SPIN:
        pass
    return max((time.thread_time() - own) / (time.perf_counter() - begun), 0.02)


def _slower(others: float, cores: int) -> float:
    """How many times longer a run takes beside others that want so many cores."""
    return max(1.0, (others + min(THREADS, cores)) / cores)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
