"""Load by other programs on this machine, and its effect on the time of a run."""

from __future__ import annotations

import math
import threading
import time
import zlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from phy124.runtime.cores import cores

SPIN = 0.3
"""Duration of a measurement [s]."""
ENOUGH = 0.2
"""Smallest CPU time of a busy-waiting thread, in units of `SPIN`."""
LONGEST = 4.0
"""Longest duration of a busy-waiting thread, in units of `SPIN`."""
BLOCK = bytes(1 << 18)
"""Checksums of these data are computed without Python's global lock."""
ALONE = 0.93
"""Smallest fraction of its time that a thread gets on a free core."""
SECOND_THREAD = 1.5
"""Factor on the time of a simulation if no core is free for its second thread."""
MINIMUM, MAXIMUM = 0.8, 1.5
"""Range of the ratio of measured to predicted time on an idle machine (docs/lab/forecasts.md)."""
BUSY = 1.2
"""Factor on the range of the predicted time on a busy machine."""
FRESH = 10.0
"""Largest age of a measurement that is reused [s]."""


@dataclass(frozen=True)
class Load:
    """Factors by which other programs slow down a run."""

    thread: float = 1.0
    """Factor for single-threaded work."""
    simulation: float = 1.0

    @classmethod
    def measure(cls, device: str = "cpu") -> Load:
        """Measure the fraction of a core that busy-waiting threads get.

        On a GPU, the factors are 1, because the load hardly affects the run.
        """
        if device != "cpu":
            return cls()
        fraction = _measure_fraction(1)
        thread = 1.0 if fraction > ALONE else 1 / fraction
        free = fraction > ALONE and (cores() == 1 or _measure_fraction(2) > ALONE)
        return cls(thread, thread if free else SECOND_THREAD * thread)

    def of(self, stage: str) -> float:
        """Return the factor by which the load lengthens a stage."""
        return self.simulation if stage == "simulate" else self.thread

    def mean(self, other: Load) -> Load:
        """Return the mean of two loads, for work between two measurements."""
        thread = (self.thread + other.thread) / 2
        return Load(thread, (self.simulation + other.simulation) / 2)

    @property
    def busy(self) -> bool:
        """Whether other programs slow down a simulation."""
        return self.simulation > 1

    def span(self, seconds: float, *, unsure: float = 1.0) -> tuple[float, float]:
        """Return the shortest and longest time [s] of a run that is predicted to take `seconds`.

        The range is widened by `unsure`.
        """
        wider = unsure * (BUSY if self.busy else 1.0)
        return MINIMUM / wider * seconds, MAXIMUM * wider * seconds


class LoadMeter:
    """Measures the load, and reuses recent measurements; a measurement takes about 0.6 s."""

    def __init__(self, device: str = "cpu") -> None:
        self.latest = Load()
        """The last load; at first, that of an idle machine."""
        self._device, self._measured = device, -math.inf
        self._measuring = threading.Lock()

    def load(self) -> Load:
        """Return the load; measure it if the last measurement is too old."""
        if time.monotonic() > self._measured + FRESH:
            self.measure()
        return self.latest

    def measure(self) -> Load:
        """Measure the load now."""
        with self._measuring:  # two simultaneous measurements would disturb each other
            self.latest = Load.measure(self._device)
            self._measured = time.monotonic()
            return self.latest


def format_span(span: tuple[float, float]) -> str:
    """Format a range of times [s], such as "12 to 18 s"."""
    low, high = span
    if high < 90:
        a, b = max(1, round(low)), max(1, round(high))
        return f"{a} s" if a == b else f"{a} to {b} s"
    if high < 5400:
        return f"{low / 60:.1f} to {high / 60:.1f} min"
    return f"{low / 3600:.1f} to {high / 3600:.1f} h"


def _measure_fraction(threads: int) -> float:
    with ThreadPoolExecutor(threads) as pool:
        return sum(pool.map(_spin, [SPIN] * threads)) / threads


def _spin(seconds: float) -> float:
    """Measure the fraction of a core's time that this thread gets, during at least `seconds`."""
    start, start_cpu, passed, ran = time.perf_counter(), time.thread_time(), 0.0, 0.0
    while passed < seconds or (ran < ENOUGH * seconds and passed < LONGEST * seconds):
        zlib.crc32(BLOCK)
        passed, ran = time.perf_counter() - start, time.thread_time() - start_cpu
    return max(ran, 1e-3) / passed


QUIET = Load()
"""Load of an idle machine."""
