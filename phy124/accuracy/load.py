"""How busy the machine is, which turns a forecast into a range."""

from __future__ import annotations

import math
import threading
import time
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from phy124.runtime.cores import cores

SPIN = 0.3
"""Time for which threads spin to measure how much of a core each gets [s]."""
ENOUGH, LONGEST = 0.2, 4.0
"""Smallest fraction of that time a thread must get, and how many times as long it may take."""
BLOCK = bytes(1 << 18)
"""The data that a spinning thread reads without holding Python's global lock."""
ALONE = 0.93
"""Fraction of a core above which nobody else uses it."""
SECOND_THREAD = 1.5
"""How many times longer a simulation takes without the second thread, used if a core is free."""
MINIMUM, MAXIMUM = 0.8, 1.5
"""Range of the time of runs relative to forecasts on an idle machine (docs/results/accuracy.md)."""
BUSY = 1.2
"""Factor by which the range is wider on a busy machine, since the load changes during a run."""
FRESH = 10.0
"""Time for which a measurement is valid [s]."""


@dataclass(frozen=True)
class Load:
    """How many times longer work takes because of other programs on this machine."""

    thread: float = 1.0
    """Factor for the work of one thread."""
    simulation: float = 1.0
    """Factor for a simulation."""

    @classmethod
    def measured(cls, device: str = "cpu") -> Load:
        """The load, from the fraction of the cores that threads of our own get for a moment.

        This includes priorities, the limits of a container and how the system shares its cores, but
        nothing from the past. What this process computes meanwhile counts as load by others. A run
        on a GPU is hardly affected by it.
        """
        if device != "cpu":
            return cls()
        one = _received(1)
        thread = 1.0 if one > ALONE else 1 / one
        free = one > ALONE and (cores() == 1 or _received(2) > ALONE)
        return cls(thread, thread if free else SECOND_THREAD * thread)

    def of(self, stage: str) -> float:
        """Factor for a stage of a run."""
        return self.simulation if stage == "simulate" else self.thread

    def mean(self, other: Load) -> Load:
        """The mean of two loads, for work between two measurements."""
        thread = (self.thread + other.thread) / 2
        return Load(thread, (self.simulation + other.simulation) / 2)

    @property
    def busy(self) -> bool:
        """Whether other programs are busy."""
        return self.simulation > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Shortest and longest time of a run that takes `seconds` under the current load [s].

        Programs that end or start meanwhile are not predicted.
        """
        wider = unsure * (BUSY if self.busy else 1.0)
        return MINIMUM / wider * seconds, MAXIMUM * wider * seconds


class LoadMeter:
    """Measures the load, which takes 0.6 s of all cores, no more often than it is worth."""

    def __init__(self, device: str = "cpu") -> None:
        """Measure nothing yet.

        Args:
            device: Where the runs are whose time is of interest.
        """
        self.latest = Load()
        """What was measured last; of an idle machine before that."""
        self._device, self._measured = device, -math.inf
        self._measuring = threading.Lock()

    def load(self) -> Load:
        """The load, measured again if the last measurement is too old."""
        if time.monotonic() > self._measured + FRESH:
            self.measure()
        return self.latest

    def measure(self) -> Load:
        """Measure the load now."""
        with self._measuring:  # two measurements at once would see each other as load
            self.latest = Load.measured(self._device)
            self._measured = time.monotonic()
            return self.latest


def spoken(span: tuple[float, float]) -> str:
    """A range of times [s] in words: "12 to 18 s", "1.5 to 2.3 min"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _received(threads: int) -> float:
    """Mean fraction of a core that each of some busy threads gets."""
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(_spun, [SPIN] * threads)) / threads


def _spun(seconds: float) -> float:
    """Fraction of a core that this thread gets, from spinning for so many seconds.

    If it hardly runs in that time, it goes on until it has.
    """
    begun, own, passed, got = time.perf_counter(), time.thread_time(), 0.0, 0.0
    while passed < seconds or (got < ENOUGH * seconds and passed < LONGEST * seconds):
        zlib.crc32(BLOCK)
        passed, got = time.perf_counter() - begun, time.thread_time() - own
    return max(got, 1e-3) / passed
