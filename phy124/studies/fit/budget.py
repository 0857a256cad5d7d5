"""Forecasts the time of a fit before the first run, and measures the time used so far."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phy124.accuracy.forecast import Forecaster
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import prepare
from phy124.studies.fit.search import HALVES, generation_size, log2_screened

FEWEST = 6
"""Smallest number of generations (of CMA-ES) with which a search is useful."""
USUAL = 20
"""Number of generations (of CMA-ES) that a search typically needs."""
ROUNDS = 3
"""Number of Gauss-Newton steps that the refinement on one grid typically needs."""
STARTING = 3.0
"""Time that the worker processes need to start [s]."""


@dataclass
class Budget:
    """The time budget of a fit [s]."""

    seconds: float
    expected: int = 0
    """Predicted number of runs."""
    clock: Callable[[], float] = time.perf_counter
    _begun: float = field(init=False)

    def __post_init__(self) -> None:
        self._begun = self.clock()

    @property
    def spent(self) -> float:
        """Time since the budget was created [s]."""
        return self.clock() - self._begun

    def late(self, part: float) -> bool:
        """Return whether more than the fraction `part` of the budget has been used."""
        return self.spent > part * self.seconds


@dataclass(frozen=True)
class Outlook:
    """Forecast of a fit."""

    grids: tuple[int, ...]
    each: tuple[float, ...]
    """Time of one simulation on each grid with a single thread [s]."""
    values: int
    """Number of values to fit."""
    workers: int
    once: float = 0.0
    """Additional time of the first run on each grid in a process [s], summed over the grids."""

    def runs(self, generations: int = USUAL) -> list[int]:
        """Return the number of simulations on each grid."""
        steps, slopes = len(HALVES) * ROUNDS + 1, 2 * self.values
        first = 2 ** log2_screened(self.values) + generations * generation_size(self.values)
        counts = [first + 2 * slopes + 2 * steps] + [steps] * (len(self.grids) - 1)
        counts[-1] += slopes + steps
        return counts

    def wall(self, generations: int) -> float:
        """Return the time of the fit [s] if all workers are always busy."""
        work = np.dot(self.runs(generations), self.each)
        # Without workers, this process has already prepared the object for the forecast.
        return float(work) / self.workers + (STARTING + self.once if self.workers > 1 else 0.0)

    def refuse(self, seconds: float) -> None:
        """Refuse a time budget [s] that is too short.

        Raises:
            InputError: The budget is shorter than a fit with the fewest useful generations.
        """
        least = self.wall(FEWEST)
        if seconds < least:
            limit = f"this fit takes at least about {least:.0f} s ({self.sentence()})."
            remedy = f"Give --seconds {1.2 * self.wall(USUAL):.0f}."
            raise InputError("seconds", f"{seconds:g}", limit, remedy)

    def data(self) -> dict[str, Any]:
        """Return the forecast as plain data."""
        times = {"seconds": self.wall(USUAL), "least": self.wall(FEWEST)}
        runs = {"grids": self.grids, "each": self.each, "runs": self.runs()}
        return {**runs, "workers": self.workers, **times}

    def sentence(self) -> str:
        """Describe the forecast in one sentence."""
        rows = zip(self.runs(), self.each, self.grids, strict=True)
        parts = [f"{count} runs of {each:.2f} s on {cells} cells" for count, each, cells in rows]
        time = f"{self.wall(USUAL):.0f} s with {self.workers} at a time"
        return f"about {', '.join(parts)}: {time}"


def make_outlook(
    gaussians: Gaussians, scenes: Sequence[Scene], values: int, workers: int, crop: Crop = WHOLE
) -> Outlook:
    """Forecast the time of a fit.

    Args:
        gaussians: The object.
        scenes: One scene per grid, with all values in the middle of their ranges.
        values: Number of values to fit.
        workers: Number of worker processes.
        crop: Rectangle of the picture that contains the object.
    """
    forecaster, each, once = Forecaster(RunContext(threads=1)), [], 0.0
    for scene in scenes:
        stages = forecaster.forecast(gaussians, scene, crop=crop).stages
        again = RunContext(threads=1)  # results of the first preparation are cached
        prepare(gaussians, scene, again, crop=crop)
        particles = again.watch.seconds["particles"]
        each.append(particles + stages["simulate"] + stages["deform"])
        once += max(stages["particles"] - particles, 0.0)
    grids = tuple(scene.resolution.cells for scene in scenes)
    return Outlook(grids, tuple(each), values, max(workers, 1), once)
