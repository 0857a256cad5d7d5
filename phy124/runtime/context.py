"""Run context: where work is computed, who hears of its progress, and what times it."""

from __future__ import annotations

from dataclasses import dataclass, field

from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch


@dataclass(frozen=True)
class RunContext:
    """Device, threads, progress function and stopwatch of one piece of work.

    Everything here may change without changing the result, except for rounding: the number of
    threads and the device determine the order of sums.
    """

    device: str = "cpu"
    """Warp device, "cpu" or "cuda:0"."""
    threads: int | None = None
    """CPU threads; None: as many as have a free core and enough particles."""
    progress: Progress = silent
    """Called with (stage, steps done, steps in all); may raise Cancelled."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """Records the durations of stages."""
