"""Measures the CPU time that a simulation has spent, which `time.budget` limits.

The time of other programs is not counted, so a run does not stop because of them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from phy124.mpm.threads import Team


class Spent:
    """CPU time of the busiest thread of the simulation [s]; the time of other programs does not
    count.

    On a GPU, wall-clock time is used, since GPU time is not measured per program.
    """

    def __init__(self, team: Team[int], device: str) -> None:
        """Set the time to zero.

        Args:
            team: The threads that simulate.
            device: Warp device.
        """
        self._team, self._on_cpu = team, device == "cpu"
        self.before = 0.0
        """Time spent in earlier `counting` contexts [s]."""
        self._start = self._now()

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count time within this context; the same thread must enter and leave it."""
        self._start = self._now()
        try:
            yield
        finally:
            self.before = self.total()
            self._start = self._now()

    def total(self) -> float:
        """Return the time counted so far [s]; call it from the thread that counts."""
        pairs = zip(self._now(), self._start, strict=True)
        return self.before + max(now - start for now, start in pairs)

    def _now(self) -> list[float]:
        """Return a clock reading per thread [s]; the difference of two readings is CPU time."""
        if not self._on_cpu:
            return [time.perf_counter()]
        return [time.thread_time(), *self._team.seconds[1:]]
