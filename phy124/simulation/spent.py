"""Time that substeps have taken, without that which other programs took from them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

from phy124.mpm.threads import Team


class Spent:
    """Seconds of the simulation: processor time of the thread that uses most.

    On a GPU, which is not shared out like that, they are seconds of the clock.
    """

    def __init__(self, team: Team[int], device: str) -> None:
        """Nothing has been spent yet.

        Args:
            team: The threads that simulate.
            device: Warp device.
        """
        self._team, self._on_cpu = team, device == "cpu"
        self.before = 0.0
        """What was spent in former stretches [s]."""
        self._begun = self._now()

    @contextmanager
    def counting(self) -> Iterator[None]:
        """Within this context, which one thread enters and leaves, time counts."""
        self._begun = self._now()
        try:
            yield
        finally:
            self.before = self.total()
            self._begun = self._now()

    def total(self) -> float:
        """Seconds so far, to be asked by the thread that counts."""
        pairs = zip(self._now(), self._begun, strict=True)
        return self.before + max(now - begun for now, begun in pairs)

    def _now(self) -> list[float]:
        """Seconds of each thread, of which differences count."""
        if not self._on_cpu:
            return [time.perf_counter()]
        return [time.thread_time(), *self._team.seconds[1:]]
