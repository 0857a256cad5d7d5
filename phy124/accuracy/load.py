"""How busy the machine is, and what that makes of a forecast: a range instead of one number."""

from __future__ import annotations

import os
import time
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

SPIN = 0.3
"""Seconds for which threads spin to see how much of a core each gets."""
ENOUGH, LONGEST = 0.2, 4.0
"""Fraction of these it must get for that to tell something, and how often as long it may take."""
BLOCK = bytes(1 << 18)
"""What a spinning thread reads, without Python's lock."""
ALONE = 0.93
"""Fraction of a core from which nobody else has it."""
SECOND_THREAD = 1.5
"""How much longer a simulation takes without the second thread, which it has if a core is free."""
MINIMUM, MAXIMUM = 0.8, 1.5
"""What runs took, in forecasts, where nothing else was at work (docs/results/accuracy.md)."""
BUSY = 1.2
"""How much wider the range is beside others: they come and go within a run."""


@dataclass(frozen=True)
class Load:
    """How many times longer things take here than on a quiet machine, because of others."""

    thread: float = 1.0
    """What one thread does."""
    simulation: float = 1.0
    """A simulation."""

    @classmethod
    def measured(cls, device: str = "cpu") -> Load:
        """From what threads of our own get of the cores for a moment.

        That knows the priorities of others, the limits of a container and how a system shares its
        cores, and nothing of the past. What this very process computes meanwhile counts as others.
        A run on a GPU hardly notices them.
        """
        if device != "cpu":
            return cls()
        one = _received(1)
        thread = 1.0 if one > ALONE else 1 / one
        free = one > ALONE and (_cores() == 1 or _received(2) > ALONE)
        return cls(thread, thread if free else SECOND_THREAD * thread)

    def of(self, stage: str) -> float:
        """How many times longer a stage of a run takes."""
        return self.simulation if stage == "simulate" else self.thread

    def mean(self, other: Load) -> Load:
        """Half way to another load, for what lay between two looks."""
        thread = (self.thread + other.thread) / 2
        return Load(thread, (self.simulation + other.simulation) / 2)

    @property
    def busy(self) -> bool:
        """Whether others are at work now."""
        return self.simulation > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Between what times a run lies that takes `seconds` as things are.

        Others who end or begin meanwhile are not foreseen.
        """
        wider = unsure * (BUSY if self.busy else 1.0)
        return MINIMUM / wider * seconds, MAXIMUM * wider * seconds


def spoken(span: tuple[float, float]) -> str:
    """A span of seconds in words: "12 to 18 s", "1.5 to 2.3 min"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _received(threads: int) -> float:
    """Mean fraction of a core that threads get which all want one."""
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(_spun, [SPIN] * threads)) / threads


def _spun(seconds: float) -> float:
    """Fraction of a core that this thread gets, from a spin of so many seconds.

    One that hardly had its turn in that time goes on until it had.
    """
    begun, own, passed, got = time.perf_counter(), time.thread_time(), 0.0, 0.0
    while passed < seconds or (got < ENOUGH * seconds and passed < LONGEST * seconds):
        zlib.crc32(BLOCK)
        passed, got = time.perf_counter() - begun, time.thread_time() - own
    return max(got, 1e-3) / passed


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
