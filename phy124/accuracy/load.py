"""The load of the machine by other programs, which turns a forecast into a range."""

from __future__ import annotations

import math
import threading
import time
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from phy124.runtime.cores import cores

SPIN = 0.3
"""Time for which threads spin to measure the fraction of a core that each gets [s]."""
ENOUGH, LONGEST = 0.2, 4.0
"""Smallest fraction of `SPIN` that a thread must run, and the longest duration as a multiple."""
BLOCK = bytes(1 << 18)
"""Data that a spinning thread reads without holding Python's global lock."""
ALONE = 0.93
"""Fraction of a core above which no other program uses it."""
SECOND_THREAD = 1.5
"""Factor on the time of a simulation that cannot use a second thread for lack of a free core."""
MINIMUM, MAXIMUM = 0.8, 1.5
"""Range of the time of runs relative to forecasts on an idle machine (docs/lab/forecasts.md)."""
BUSY = 1.2
"""Factor by which the range is wider on a busy machine, since the load changes during a run."""
FRESH = 10.0
"""Time for which a measurement is valid [s]."""


@dataclass(frozen=True)
class Load:
    """Factors by which work takes longer because of other programs on this machine."""

    thread: float = 1.0
    """Factor for the work of one thread."""
    simulation: float = 1.0
    """Factor for a simulation."""

    @classmethod
    def measure(cls, device: str = "cpu") -> Load:
        """Measure the load from the fraction of the cores that spinning threads get for a moment.

        It includes priorities, the limits of a container and how the system shares its cores, but
        not the past. Other work of this process counts as load. A run on a GPU is hardly affected.
        """
        if device != "cpu":
            return cls()
        fraction = _measure_fraction(1)
        thread = 1.0 if fraction > ALONE else 1 / fraction
        free = fraction > ALONE and (cores() == 1 or _measure_fraction(2) > ALONE)
        return cls(thread, thread if free else SECOND_THREAD * thread)

    def of(self, stage: str) -> float:
        """Return the factor for a stage of a run."""
        return self.simulation if stage == "simulate" else self.thread

    def mean(self, other: Load) -> Load:
        """Return the mean of two loads, for work between two measurements."""
        thread = (self.thread + other.thread) / 2
        return Load(thread, (self.simulation + other.simulation) / 2)

    @property
    def busy(self) -> bool:
        """Whether other programs are busy."""
        return self.simulation > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Return the shortest and longest time [s] of a run that takes `seconds` under this load.

        Programs that start or end during the run are not predicted.
        """
        wider = unsure * (BUSY if self.busy else 1.0)
        return MINIMUM / wider * seconds, MAXIMUM * wider * seconds


class LoadMeter:
    """Measures the load when it is needed and the last measurement is too old.

    A measurement takes 0.6 s of all cores.
    """

    def __init__(self, device: str = "cpu") -> None:
        """Measure nothing yet.

        Args:
            device: Warp device of the runs.
        """
        self.latest = Load()
        """The last measurement; before the first one, that of an idle machine."""
        self._device, self._measured = device, -math.inf
        self._measuring = threading.Lock()

    def load(self) -> Load:
        """Return the load, measured again if the last measurement is too old."""
        if time.monotonic() > self._measured + FRESH:
            self.measure()
        return self.latest

    def measure(self) -> Load:
        """Measure the load now."""
        with self._measuring:  # two simultaneous measurements would count each other as load
            self.latest = Load.measure(self._device)
            self._measured = time.monotonic()
            return self.latest


def format_span(span: tuple[float, float]) -> str:
    """Format a range of times [s]: "12 to 18 s", "1.5 to 2.3 min"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _measure_fraction(threads: int) -> float:
    """Return the mean fraction of a core that each of several spinning threads gets."""
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(_spin, [SPIN] * threads)) / threads


def _spin(seconds: float) -> float:
    """Return the fraction of a core that this thread gets while it spins for some seconds.

    It spins longer if it hardly ran in that time.
    """
    start, start_cpu, passed, ran = time.perf_counter(), time.thread_time(), 0.0, 0.0
    while passed < seconds or (ran < ENOUGH * seconds and passed < LONGEST * seconds):
        zlib.crc32(BLOCK)
        passed, ran = time.perf_counter() - start, time.thread_time() - start_cpu
    return max(ran, 1e-3) / passed
