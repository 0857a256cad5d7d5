"""Forecasts the time and size of a sweep from a few clips, and estimates the remaining time."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from phy124.accuracy.forecast import Forecaster
from phy124.budget.cost import USUAL, Work
from phy124.errors import InputError
from phy124.progress import Progress, silent
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.sweep.plan import Item, Plan
from phy124.studies.sweep.work import Row, make_static

TRIED = 8
"""Maximum number of clips from which the sweep is forecast."""
NUMBERS = 10
"""Number of values that a clip stores per Gaussian and frame: position, rotation and scale."""


class Expected(NamedTuple):
    """The predicted computing time and storage size of a sweep."""

    clips: int
    tried: int
    seconds: tuple[float, float]
    """CPU time per clip [s]: its mean, and the standard error of the mean."""
    bytes: float
    """Mean size of a clip [bytes]."""

    def wall(self, workers: int) -> float:
        """Return the time of the sweep [s] if all workers are always busy."""
        return self.seconds[0] * self.clips / workers

    def sentence(self, workers: int) -> str:
        """Describe the forecast in one sentence."""
        mean, error = self.seconds
        hours = mean * self.clips / 3600
        return (
            f"{self.clips:,} clips, each with {mean:.2f} s of CPU time (standard error "
            f"{error:.2f} s, from {self.tried}): {hours:.2f} CPU-hours, "
            f"{self.wall(workers) / 3600:.2f} h with "
            f"{workers} worker{'s' * (workers > 1)}; {self.bytes * self.clips / 1e9:.2f} GB"
        )


def list_refused(plan: Plan, progress: Progress = silent) -> Iterator[tuple[Item, str]]:
    """Yield each clip whose scene is invalid, with the reason."""
    for item in plan:
        try:
            plan.scene_of(item)
        except InputError as error:
            yield item, str(error)
        progress("plan", item.index + 1, len(plan))


def forecast_sweep(plan: Plan, context: RunContext) -> Expected:
    """Forecast the time and size of a sweep from a few clips.

    Raises:
        InputError: None of the selected clips can be computed.
    """
    chosen = np.linspace(0, len(plan) - 1, min(TRIED, len(plan))).round().astype(int)
    seconds, sizes, why = [], [], None
    forecaster = Forecaster(replace(context, threads=1))
    for count, index in enumerate(chosen.tolist()):
        try:
            spent, size = _forecast_clip(plan, plan.item(index), forecaster)
        except InputError as error:
            why = error
            continue
        seconds.append(spent)
        sizes.append(size)
        context.progress("forecast", count + 1, len(chosen))
    if not seconds:
        raise why or InputError(
            "sweep", plan.sweep.scene, "the sweep has no clips.", "Add pictures."
        )
    error = float(np.std(seconds, ddof=1) / len(seconds) ** 0.5) if len(seconds) > 1 else 0.0
    mean = float(np.mean(seconds))
    return Expected(len(plan), len(seconds), (mean, error), float(np.mean(sizes)))


def _forecast_clip(plan: Plan, item: Item, forecaster: Forecaster) -> tuple[float, float]:
    """Forecast the time [s] and the size [bytes] of a clip."""
    context = forecaster.context.aside()
    watch, count = context.watch, plan.sweep.gaussians
    scene, options = plan.scene_of(item), {"count": count, "preview_with_relief": True}
    made = make_static(item.picture, item.generator, scene, context, **options)
    run = Simulation(prepare(made.gaussians, made.scene, context, crop=made.crop))
    forecast = forecaster.of(run, filming=plan.sweep.films)
    making = watch.seconds.get("generate", 0.0) + watch.seconds.get("image", 0.0)
    if made.effort is not None:
        making += made.effort.seconds
    making *= plan.sources / len(plan)  # clips with the same source share their Gaussians
    size = made.scene.time.frames * len(run.setup.shown) * NUMBERS * 4.0
    return forecast.seconds + watch.seconds["particles"] + making, size


SAMPLED = 256
"""Maximum number of clips from which the mean work of all clips is estimated."""
ORIGIN = 1e-3
"""The fit of the line includes the point (no work, no time) with this weight per finished clip."""
FEWEST = 3
"""Number of finished clips after which the remaining time is estimated."""


class Remaining:
    """Estimates the remaining time from the work of the clips and the speed so far."""

    def __init__(
        self, plan: Plan, numbers: Sequence[int], clock: Callable[[], float] = time.time
    ) -> None:
        """Prepare the estimate for the clips with the indices `numbers`; `clock` returns the
        present time [s], as in the column `written` of the manifest.
        """
        self._plan, self._clock = plan, clock
        self._start: float | None = None
        self._last = -1
        self._moments = np.zeros(5)
        """Sums over finished clips of 1, work, seconds, work squared, and work times seconds."""
        places = np.linspace(0, len(numbers) - 1, min(SAMPLED, len(numbers))).astype(int)
        self._sample = [(numbers[place], self._work_of(numbers[place])) for place in places]

    def note_finished(self, row: Row) -> None:
        """Include a finished clip in the estimate of the remaining time."""
        if "seconds" not in row:
            return
        seconds = row["seconds"]["clip"]
        if self._start is None:
            self._start = row["written"] - seconds
        self._last = max(self._last, row["index"])
        work = self._work_of(row["index"])
        self._moments += (1.0, work, seconds, work**2, work * seconds)

    def left(self, clips: int) -> float | None:
        """Return the time for `clips` more clips [s], or None until enough clips are finished."""
        count, work, seconds = self._moments[:3]
        if self._start is None or count < FEWEST:
            return None
        fixed, per_work = fit_line(self._moments)
        spent = self._clock() - self._start
        # When a worker finishes a clip, the other workers have, on average, finished half of
        # theirs.
        others = max(0.0, seconds / spent - 1.0)
        made = (fixed * count + per_work * work) * (1.0 + others / 2 / count)
        ahead = [work for index, work in self._sample if index > self._last]
        mean = float(np.mean(ahead or [work for _, work in self._sample]))
        return clips * (fixed + per_work * mean) * spent / made

    def _work_of(self, index: int) -> float:
        """Return the time of a clip on a typical machine [s]; 0 if the clip is refused."""
        try:
            scene = self._plan.scene_of(self._plan.item(index))
            return work_of(scene, films=self._plan.sweep.films)
        except InputError:
            return 0.0


def work_of(scene: Scene, *, films: bool) -> float:
    """Return the time of a scene's clip on a typical machine [s]."""
    costs = USUAL["cpu"].seconds(Work.of(scene))
    stages = ("simulate", "deform", "film") if films else ("simulate", "deform")
    return sum(costs[stage] for stage in stages)


def fit_line(moments: np.ndarray) -> tuple[float, float]:
    """Fit a line of seconds over work. Return its intercept [s] and its slope; neither is negative.

    If all clips have equal work, only a small penalty on the intercept makes the fit unique.
    `moments` are sums over clips: their number, work, seconds, work squared, and work times
    seconds.
    """
    count, work, seconds, squared, both = moments.tolist()
    normal = [[(1 + ORIGIN) * count, work], [work, squared]]
    fixed, slope = np.linalg.solve(normal, [seconds, both]).tolist()
    if slope < 0:
        return seconds / count, 0.0
    return (fixed, slope) if fixed >= 0 else (0.0, seconds / work)
