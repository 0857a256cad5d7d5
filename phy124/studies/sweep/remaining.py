"""How long the rest of a sweep takes, told from the clips made so far and what each has to do."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from phy124.budget.cost import USUAL, Work
from phy124.errors import InputError
from phy124.scene import Scene
from phy124.studies.sweep.plan import Plan
from phy124.studies.sweep.work import Row

SAMPLED = 256
"""Clips that stand for all, evenly chosen."""
ORIGIN = 1e-3
"""Weight, per clip, of the wish that no work takes no time."""
FEWEST = 3
"""Clips that must be made before anything is told."""


class Remaining:
    """The clips of one run: how much work they are, and how fast it is done."""

    def __init__(
        self, plan: Plan, numbers: Sequence[int], clock: Callable[[], float] = time.time
    ) -> None:
        """Look at some of the clips.

        Args:
            plan: The sweep.
            numbers: Which clips of it are made.
            clock: Tells the time [s], as the rows do.
        """
        self._plan, self._numbers, self._clock = plan, numbers, clock
        self._start: float | None = None
        self._last = -1
        self._moments = np.zeros(5)
        """Sums over the clips made: 1, work, seconds, work squared, work times seconds."""
        places = np.linspace(0, len(numbers) - 1, min(SAMPLED, len(numbers))).astype(int)
        self._sample = [(numbers[place], self._work_of(numbers[place])) for place in places]

    def ended(self, row: Row) -> None:
        """Take note of a clip that was made."""
        if "seconds" not in row:
            return
        seconds = row["seconds"]["clip"]
        if self._start is None:
            self._start = row["written"] - seconds
        self._last = max(self._last, row["index"])
        work = self._work_of(row["index"])
        self._moments += (1.0, work, seconds, work**2, work * seconds)

    def left(self, clips: int) -> float | None:
        """Time until so many more are made [s]; None before it can be told."""
        count, work, seconds = self._moments[:3]
        if self._start is None or count < FEWEST:
            return None
        fixed, per_work = line(self._moments)
        spent = self._clock() - self._start
        # While one worker hands in its clip, each other has half of one.
        others = max(0.0, seconds / spent - 1.0)
        made = (fixed * count + per_work * work) * (1.0 + others / 2 / count)
        ahead = [work for index, work in self._sample if index > self._last]
        mean = float(np.mean(ahead or [work for _, work in self._sample]))
        return clips * (fixed + per_work * mean) * spent / made

    def _work_of(self, index: int) -> float:
        """What a clip costs a usual machine [s]; nothing if it is refused."""
        try:
            scene = self._plan.scene_of(self._plan.item(index))
            return load(scene, films=self._plan.sweep.films)
        except InputError:
            return 0.0


def load(scene: Scene, *, films: bool) -> float:
    """What the clip of a scene costs a usual machine [s], besides the Gaussians it shares."""
    costs = USUAL["cpu"].seconds(Work.of(scene))
    stages = ("simulate", "deform", "film") if films else ("simulate", "deform")
    return sum(costs[stage] for stage in stages)


def line(moments: np.ndarray) -> tuple[float, float]:
    """Line of seconds over work, neither of whose numbers is negative.

    Least squares, with a little weight on a line through zero: while all clips are alike, they tell
    nothing else than that twice the work takes twice as long.

    Args:
        moments: Sums of 1, work, seconds, work squared, work times seconds.
    """
    count, work, seconds, squared, both = moments.tolist()
    normal = [[(1 + ORIGIN) * count, work], [work, squared]]
    fixed, slope = np.linalg.solve(normal, [seconds, both]).tolist()
    if slope < 0:
        return seconds / count, 0.0
    return (fixed, slope) if fixed >= 0 else (0.0, seconds / work)
