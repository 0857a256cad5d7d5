"""Measures the CPU time of a simulation, without other programs; `time.budget` limits this time."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from phy124.mpm.threads import Team


class Spent:
    """CPU time of the busiest thread [s].

    On a GPU, wall-clock time is used, since GPU time is not measured per program.
    """

    def __init__(self, team: Team, device: str) -> None:
        self._team, self._on_cpu = team, device == "cpu"
        self.earlier = 0.0
        """Time in earlier `counting` contexts [s]."""
        self._start = self._now()

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Count time within this context; one thread must both enter and leave the context."""
        self._start = self._now()
        try:
            yield
        finally:
            self.earlier = self.total()
            self._start = self._now()

    def total(self) -> float:
        """Return the time counted so far [s]; call from the counting thread."""
        pairs = zip(self._now(), self._start, strict=True)
        return self.earlier + max(now - start for now, start in pairs)

    def _now(self) -> list[float]:
        """Return a clock reading per thread [s]; differences are CPU times."""
        if not self._on_cpu:
            return [time.perf_counter()]
        return [time.thread_time(), *self._team.seconds[1:]]
