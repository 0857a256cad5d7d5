"""What a sweep will cost, told from a few of its clips before any is made."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from phy124.accuracy.forecast import Forecaster
from phy124.errors import InputError
from phy124.progress import Progress, silent
from phy124.runtime.context import RunContext
from phy124.runtime.stopwatch import Stopwatch
from phy124.simulation import Simulation, prepare
from phy124.studies.sweep.plan import Item, Plan
from phy124.studies.sweep.work import static_of

TRIED = 8
"""Clips that are looked at."""
NUMBERS = 10
"""Numbers of a Gaussian per frame in a clip: place, orientation, scale."""


class Expected(NamedTuple):
    """What a sweep will take."""

    clips: int
    tried: int
    """From so many of them it is told."""
    seconds: tuple[float, float]
    """Processor time of one clip [s]: its mean, and the standard error of that."""
    bytes: float
    """Of one clip."""

    def wall(self, workers: int) -> float:
        """Time until all are made [s], if all workers are always busy."""
        return self.seconds[0] * self.clips / workers

    def sentence(self, workers: int) -> str:
        """For people."""
        mean, error = self.seconds
        hours = mean * self.clips / 3600
        return (
            f"{self.clips:,} clips of {mean:.2f} s of one core each (standard error {error:.2f} s, "
            f"from {self.tried}): {hours:.2f} CPU-hours, {self.wall(workers) / 3600:.2f} h with "
            f"{workers} workers; {self.bytes * self.clips / 1e9:.2f} GB"
        )


def refused(plan: Plan, progress: Progress = silent) -> Iterator[tuple[Item, str]]:
    """The clips that cannot be made, and why."""
    for item in plan:
        try:
            plan.scene_of(item)
        except InputError as error:
            yield item, str(error)
        progress("plan", item.index + 1, len(plan))


def expected(plan: Plan, device: str = "cpu", progress: Progress = silent) -> Expected:
    """What a sweep will take, from forecasts of a few of its clips.

    Raises:
        InputError: None of those can be made.
    """
    chosen = np.linspace(0, len(plan) - 1, min(TRIED, len(plan))).round().astype(int)
    seconds, sizes, why = [], [], None
    forecaster = Forecaster(device, threads=1)
    for count, index in enumerate(chosen.tolist()):
        try:
            spent, size = _one(plan, plan.item(index), forecaster, device)
        except InputError as error:
            why = error
            continue
        seconds.append(spent)
        sizes.append(size)
        progress("forecast", count + 1, len(chosen))
    if not seconds:
        raise why or InputError("sweep", plan.sweep.scene, "it has no clips.", "Add pictures.")
    error = float(np.std(seconds, ddof=1) / len(seconds) ** 0.5) if len(seconds) > 1 else 0.0
    mean = float(np.mean(seconds))
    return Expected(len(plan), len(seconds), (mean, error), float(np.mean(sizes)))


def _one(plan: Plan, item: Item, forecaster: Forecaster, device: str) -> tuple[float, float]:
    """Seconds and bytes of one clip."""
    watch = Stopwatch()
    made = static_of(
        item.picture, item.generator, plan.scene_of(item), count=plan.sweep.gaussians,
        stand_in=True, device=device, watch=watch,
    )  # fmt: skip
    run = Simulation(
        prepare(
            made.gaussians,
            made.scene,
            RunContext(device=device, watch=watch, threads=1),
            crop=made.crop,
        )
    )
    told = forecaster.of(run, filming=plan.sweep.films)
    own = watch.seconds.get("generate", 0.0) + watch.seconds.get("image", 0.0)
    if made.effort is not None:
        own += made.effort.seconds
    # Clips of one source share its Gaussians.
    own *= plan.sources / len(plan)
    size = made.scene.time.frames * len(run.setup.shown) * NUMBERS * 4.0
    return told.seconds + watch.seconds["particles"] + own, size
