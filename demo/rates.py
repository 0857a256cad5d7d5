"""Costs of a run's stages on this machine, measured at the start and corrected by finished runs.

A substep, a frame and a video each have a fixed cost and a cost per particle or pixel. To prevent
visitors from distorting the costs, small runs are ignored, and the median of the latest runs is
used. A cost may differ from the first measurement only by a limited factor.
"""

from __future__ import annotations

import statistics
import threading
from collections import deque
from dataclasses import replace
from typing import Any

from phy124.budget.cost import Rates, Work
from phy124.scene import Scene

READ = 0.2
"""If the stage `generate` takes at most this time [s], Gaussians were read instead of generated."""
SPREAD = 3.0
"""Largest factor between a corrected cost and the cost measured at the start."""
WINDOW = 5
"""Number of runs from which the median is computed."""
FIXED = 0.7
"""Largest fraction of a usual run's time that may be attributed to fixed costs."""
MINIMUM = 0.2
"""A run corrects a cost only if its work is at least this fraction of the first measurement's work.
"""


class Learned:
    """Costs of each stage per unit of work, corrected by finished runs; thread-safe."""

    def __init__(self) -> None:
        self.now = Rates()
        self.measured: Rates | None = None
        """Costs per unit of work in the first measurement."""
        self._first: Work | None = None
        self._seen: dict[str, deque[float]] = {}
        self._lock = threading.Lock()

    def calibrate(
        self, small: tuple[dict[str, Any], Scene], usual: tuple[dict[str, Any], Scene]
    ) -> None:
        """Compute the costs per unit of work from the reports of a tiny run and of a usual run."""
        (little, spent_little), (much, spent) = _observe(*small), _observe(*usual)
        substep = _per(spent_little["simulate"], little.substeps) or self.now.substep
        video = _per(spent_little["film"], little.videos) or self.now.video
        fixed = replace(
            self.now,
            substep=_at_most(FIXED, spent["simulate"], much.substeps, substep),
            video=_at_most(FIXED, spent["film"], much.videos, video),
        )
        costs = _variable(fixed, much, spent)
        with self._lock:
            self.now = self.measured = replace(fixed, **costs)
            self._first = much
            # The measurement is stored twice, so that the first run of a visitor does not determine
            # the median.
            self._seen = {name: deque([value] * 2, WINDOW) for name, value in costs.items()}

    def assume(self, rates: Rates, work: Work) -> None:
        """Use these costs, which finished runs correct, if this process cannot measure costs."""
        with self._lock:
            self.now = self.measured = rates
            self._first = work

    def learn(self, report: dict[str, Any], scene: Scene) -> None:
        """Correct the costs per unit of work by the times in the report of a finished run."""
        work, spent = _observe(report, scene)
        with self._lock:
            if self.measured is None or self._first is None:
                return
            costs = _variable(self.now, work, spent)
            if work.particles < MINIMUM * self._first.particles:
                costs.pop("particle", None)
            if work.pixels < MINIMUM * self._first.pixels:
                costs.pop("pixel", None)
                costs.pop("shine", None)
            for name, value in costs.items():
                usual = vars(self.measured)[name]
                value = min(max(value, usual / SPREAD), usual * SPREAD)
                self._seen.setdefault(name, deque([usual] * 2, WINDOW)).append(value)
            medians = {name: statistics.median(seen) for name, seen in self._seen.items()}
            self.now = replace(self.now, **medians)

    @property
    def minimum(self) -> Rates:
        """Smallest known costs per unit of work: built-in, first measured, or current."""
        return Rates().minimum(self.measured or self.now).minimum(self.now)


def _observe(report: dict[str, Any], scene: Scene) -> tuple[Work, dict[str, float]]:
    spent = {stage["name"]: stage["seconds"] for stage in report["stages"]}
    spent["film"] = spent.get("render", 0.0) + spent.get("encode", 0.0)
    for name in ("generate", "simulate", "deform", "shine"):
        spent.setdefault(name, 0.0)
    spent["generate"] /= 1 + len(report.get("sources", {}))
    names = "substeps", "particles", "frames", "gaussians"
    work = Work.from_counts(scene, *(report[name] for name in names))
    return work, spent


def _variable(rates: Rates, work: Work, spent: dict[str, float]) -> dict[str, float]:
    """Return the costs per particle, frame and pixel; omit costs that are undetermined."""
    fixed = {
        "particle": rates.substep * work.substeps + rates.node * work.nodes,
        "pixel": rates.video * work.videos,
    }
    costs = {
        # Gaussians that are read from a file take little time, so they are ignored.
        "generate": spent["generate"] if spent["generate"] > READ else None,
        "particle": _per(spent["simulate"] - fixed["particle"], work.particles),
        "frame": _per(spent["deform"], work.frames),
        "pixel": _per(spent["film"] - fixed["pixel"], work.pixels),
        "shine": _per(spent["shine"], work.redrawn),
    }
    return {name: value for name, value in costs.items() if value}


def _per(seconds: float, amount: float) -> float | None:
    """Return the time per unit of work [s]; None if the time or the amount is not positive."""
    return seconds / amount if amount > 0 and seconds > 0 else None


def _at_most(fraction: float, seconds: float, amount: float, cost: float) -> float:
    """Return the cost, limited to a fraction of the stage's time per unit of work."""
    usual = _per(seconds, amount)
    return cost if usual is None else min(cost, fraction * usual)
