"""Time: what a fit will take, told before it begins, and how much of it is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phy124.accuracy.forecast import Forecaster
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.scene import Scene
from phy124.simulation.parts import WHOLE, Crop
from phy124.studies.fit.refine import HALVES
from phy124.studies.fit.search import generation, screening

FEWEST = 6
"""Generations without which a search is none."""
USUAL = 20
"""Generations that most searches take."""
ROUNDS = 3
"""Steps of refinement that most grids take."""
STARTING = 3.0
"""Time until worker processes are ready [s]."""


@dataclass
class Budget:
    """A number of seconds, and what of it is spent."""

    seconds: float
    expected: int = 0
    """Runs that are expected."""
    clock: Callable[[], float] = time.perf_counter
    _begun: float = field(init=False)

    def __post_init__(self) -> None:
        self._begun = self.clock()

    @property
    def spent(self) -> float:
        """Since it began [s]."""
        return self.clock() - self._begun

    def late(self, part: float) -> bool:
        """Whether more than a part of it is spent."""
        return self.spent > part * self.seconds


@dataclass(frozen=True)
class Outlook:
    """What a fit is expected to take."""

    grids: tuple[int, ...]
    each: tuple[float, ...]
    """Time of one run on each grid, one core [s]."""
    values: int
    """How many are to be found."""
    workers: int

    def runs(self, generations: int = USUAL) -> list[int]:
        """Runs on each grid, if the search has so many generations."""
        steps, slopes = len(HALVES) * ROUNDS + 1, 2 * self.values
        first = 2 ** screening(self.values) + generations * generation(self.values)
        found = [first + 2 * slopes + 2 * steps] + [steps] * (len(self.grids) - 1)
        found[-1] += slopes + steps
        return found

    def wall(self, generations: int) -> float:
        """Time if all workers are always busy [s]."""
        work = np.dot(self.runs(generations), self.each)
        return float(work) / self.workers + (STARTING if self.workers > 1 else 0.0)

    def refuse(self, seconds: float) -> None:
        """Refuse a budget that is too small.

        Raises:
            InputError: It is.
        """
        least = self.wall(FEWEST)
        if seconds < least:
            limit = f"the least that this fit takes is about {least:.0f} s ({self.sentence()})."
            remedy = f"Give --seconds {1.2 * self.wall(USUAL):.0f}."
            raise InputError("seconds", f"{seconds:g}", limit, remedy)

    def data(self) -> dict[str, Any]:
        """Plain data for scripts."""
        return {
            "grids": self.grids, "each": self.each, "runs": self.runs(),
            "workers": self.workers, "seconds": self.wall(USUAL), "least": self.wall(FEWEST),
        }  # fmt: skip

    def sentence(self) -> str:
        """For people."""
        runs, told = self.runs(), []
        for cells, each, count in zip(self.grids, self.each, runs, strict=True):
            told.append(f"{count} runs of {each:.2f} s on {cells} cells")
        return f"about {', '.join(told)}, {self.workers} at once: {self.wall(USUAL):.0f} s"


def outlook(
    gaussians: Gaussians, scenes: Sequence[Scene], values: int, workers: int, crop: Crop = WHOLE
) -> Outlook:
    """What a fit is expected to take.

    Args:
        gaussians: The object.
        scenes: The scene in the middle of the ranges, on each grid.
        values: How many are to be found.
        workers: Processes that run at once.
        crop: Where the object is in its picture.
    """
    forecaster, each = Forecaster("cpu", threads=1), []
    for scene in scenes:
        told = forecaster.forecast(gaussians, scene, crop=crop).stages
        each.append(told["particles"] + told["simulate"] + told["deform"])
    grids = tuple(scene.resolution.cells for scene in scenes)
    return Outlook(grids, tuple(each), values, max(workers, 1))
