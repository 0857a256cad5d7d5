"""Choosing the accuracy for a goal: an error, or a time.

For an error, three cheap levels give their order and errors. The coarsest grid that should meet the
goal is run, and the errors are estimated again from all levels run so far. If these do not converge
yet, one more is run. There is at most one refinement. A level that tears the material
(phy124/monitor/tearing.py) is run again with one more particle per cell and axis, as are all after
it.

For a time, it is the finest grid whose forecast fits.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from phy124.accuracy.convergence import (
    AGREE,
    TRUSTED,
    Convergence,
    distances,
    extrapolated,
    richardson,
)
from phy124.accuracy.difference import pixel_distance
from phy124.accuracy.forecast import Forecast, Forecaster
from phy124.accuracy.goal import MARGIN, UNIT, Goal, too_long
from phy124.accuracy.goal import said as said
from phy124.budget.limits import duration
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.monitor.tearing import Tearing
from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Simulation

CHEAP = (16, 24)
"""Cells across the object of the levels that are run first and may be chosen."""
CHECK = 12
"""A third level, so that an order can be observed."""
CELLS = (8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128)
"""Grids that may be chosen; the finest take minutes, and less than 2 GB, on two cores."""
GUESSED_ORDER = 1.0
"""Order assumed if the cheap levels show none; free surfaces are of first order."""
FAR = 2.5
"""Largest ratio of the next level's cells to those of all before, which say little beyond that."""
FINER = 1.3  # ratio of cells above which a level is clearly finer
DENSEST = 4.0
"""Largest number of particles per cell and axis."""
LAST_CHANCE = 0.85
"""Fraction of the target error that a refinement aims at, since there is no second one."""


@dataclass
class Reached:
    """A finished run and how it meets the goal."""

    simulation: Simulation
    clip: Clip
    about: dict[str, Any]
    """The goal, what was chosen and what was achieved, for the report."""


def reach(
    goal: Goal,
    gaussians: Gaussians,
    scene: Scene,
    *,
    elapsed: float = 0.0,
    device: str = "cpu",
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    forecaster: Forecaster | None = None,
    see: Callable[[Simulation], object] = lambda run: None,
    **options: Any,
) -> Reached:
    """Run a scene as accurately, or as fast, as the goal says; its own cells are ignored.

    Args:
        goal: An error or a time.
        gaussians: The object.
        scene: The scene.
        elapsed: Seconds of a target time that have been used already.
        device: Warp device.
        progress: Called with (stage, done, total); may raise Cancelled.
        watch: Where the durations of the stages are recorded.
        forecaster: Predicts times; None: a new one.
        see: Called with each run after each of its frames.
        **options: Options of `Simulation`.

    Raises:
        InputError: No grid meets the goal; it says what the best would achieve.
    """
    forecaster = forecaster or Forecaster(device, options.get("threads"))
    runs = _Runs(gaussians, scene, device, progress, watch or Stopwatch(), options, see)
    if goal.kind == "seconds":
        return _in_time(goal, runs, forecaster, elapsed)
    return _as_exact(goal, runs)


@dataclass
class _Runs:
    """Runs of one scene on several grids, each made once."""

    gaussians: Gaussians
    scene: Scene
    device: str
    progress: Progress
    watch: Stopwatch
    options: dict[str, Any]
    see: Callable[[Simulation], object] = lambda run: None
    """Called with each run after each of its frames."""
    done: dict[int, tuple[Simulation, Clip]] = field(default_factory=dict)
    spent: dict[int, float] = field(default_factory=dict)
    """Cells of each run -> its duration [s]."""

    denser: bool = False
    """Whether a level tore the material, so that there is one more particle per cell and axis."""

    def simulation(self, cells: int) -> Simulation:
        """A run that has not started."""
        base = self.scene.resolution
        per_axis = self.scene.particles_per_axis + self.denser
        accuracy = base.model_copy(update={"cells": cells, "particles_per_axis": per_axis})
        return Simulation(
            self.gaussians,
            self.scene.model_copy(update={"accuracy": accuracy}),
            device=self.device,
            progress=self.progress,
            watch=self.watch,
            **self.options,
        )

    def clip(self, cells: int) -> Clip:
        """The clip on a grid, made if it does not exist yet."""
        if cells not in self.done:
            start = time.perf_counter()
            self._make(cells)
            if cells in self.torn and not self.denser:
                self._make_denser(cells)
            self.spent[cells] = time.perf_counter() - start
        return self.done[cells][1]

    def _make(self, cells: int) -> None:
        simulation = self.simulation(cells)
        self.done[cells] = simulation, self.run(simulation)

    def run(self, simulation: Simulation) -> Clip:
        """The clip of a run."""
        return simulation.run(lambda _: self.see(simulation))

    def _make_denser(self, cells: int) -> None:
        """Run a torn level again with more particles; if those are too many, it stays torn."""
        self.denser = self.scene.particles_per_axis + 1 <= DENSEST
        if self.denser:
            with suppress(InputError):
                self._make(cells)

    @property
    def complete(self) -> bool:
        """Whether no run stopped early."""
        return all(clip.report["complete"] for _, clip in self.done.values())

    @property
    def torn(self) -> list[int]:
        """Levels on which the grid may have torn the material, which are not used."""
        tearing = {level: run.find(Tearing) for level, (run, _) in self.done.items()}
        return sorted(level for level, search in tearing.items() if search and search.likely)

    @property
    def whole(self) -> list[int]:
        """The other levels."""
        return sorted(set(self.done) - set(self.torn))


def _as_exact(goal: Goal, runs: _Runs) -> Reached:
    for each in (CHECK, *CHEAP):
        runs.clip(each)
    if not runs.complete:
        raise _unreachable(goal, "the motion stops early on a coarse grid")
    if runs.torn:
        raise _unreachable(goal, _why_torn(runs))
    found = _estimate(goal, runs)
    error, order = _guess(goal, runs, found)
    meets = min(CHEAP) if found.errors and found.errors[1] <= goal.value else None
    wanted = meets or _coarsest(goal, max(CHEAP), error, order, above=min(CHEAP))
    if wanted is None:
        raise _unreachable(goal, _best(goal, runs, error, order))
    # An order that cannot be trusted says little about what is far finer.
    sure = found.errors and not found.note
    _run(goal, runs, min(wanted, _within(FAR * max(CHEAP)) if sure else _above(max(CHEAP))))
    found = _estimate(goal, runs)
    if not found.errors and not runs.torn:
        _run(goal, runs, _above(max(runs.done)))
        found = _estimate(goal, runs)
    cells, error = _cheapest(found, runs, goal)
    refined = error is not None and error > goal.value and not runs.torn
    if refined:
        finest, (error, order) = max(runs.done), _guess(goal, runs, found)
        error /= LAST_CHANCE
        wanted = _coarsest(goal, finest, error, order, above=finest) or _above(finest)
        _run(goal, runs, min(wanted, _within(FAR * finest)))
        found = _estimate(goal, runs)
        cells, error = _cheapest(found, runs, goal)
    simulation, clip = runs.done[cells]
    return Reached(simulation, clip, _about(goal, cells, error, found, runs, refined))


def _guess(goal: Goal, runs: _Runs, found: Convergence) -> tuple[float, float]:
    """Error of the finest level that is not torn, and the order to continue with."""
    if found.error is not None:
        order = found.order or GUESSED_ORDER
        return found.error, min(max(order, TRUSTED[0]), TRUSTED[1])
    coarse, fine = runs.whole[-2:]
    gap = _gap(goal, runs.clip(coarse), runs.clip(fine), runs.scene)
    return extrapolated((1 / coarse, 1 / fine), gap, GUESSED_ORDER)[1], GUESSED_ORDER


def _run(goal: Goal, runs: _Runs, cells: int) -> None:
    """Run a level; raises InputError if it would take too long or too much memory."""
    try:
        runs.clip(cells)
    except InputError as refusal:
        why = f"it takes D/{cells}, and there {refusal.limit.rstrip('.')}"
        raise _unreachable(goal, why) from None


def _above(cells: int) -> int:
    """The coarsest level that is clearly finer, or the finest of all."""
    return next((n for n in CELLS if n >= FINER * cells), CELLS[-1])


def _within(cells: float) -> int:
    """The finest level up to some number of cells."""
    return max(n for n in CELLS if n <= cells)


def _best(goal: Goal, runs: _Runs, error: float, order: float) -> str:
    """What the finest grid would achieve and take, in words, from the finest level that was run."""
    known, finest = max(runs.done), CELLS[-1]
    best = said(goal.kind, error * (known / finest) ** order)
    seconds = duration(runs.spent[known] * (finest / known) ** GROWTH)
    return f"even D/{finest}, in about {seconds}, would be off by about {best}"


def _about(
    goal: Goal,
    cells: int,
    error: float | None,
    found: Convergence,
    runs: _Runs,
    refined: bool,
) -> dict[str, Any]:
    """The goal and what was achieved, in the goal's unit, for the report."""
    levels, met = runs.whole, error is not None and error <= goal.value
    fraction = None if error is None else error / UNIT[goal.kind](runs.scene)
    return {
        "target": goal.text, "unit": goal.kind, "cells": cells, "levels": levels,
        "errors": list(found.errors), "seconds": [runs.spent[n] for n in levels],
        "order": found.order, "error": error, "fraction": fraction, "refined": refined,
        "met": met, "torn": runs.torn,
        "particles_per_axis": runs.done[cells][0].scene.particles_per_axis,
        "why_not": _why_torn(runs) if runs.torn and not met else found.why_not,
    }  # fmt: skip


def _why_torn(runs: _Runs) -> str:
    tearing = runs.done[runs.torn[0]][0].find(Tearing)
    why = "" if tearing is None else tearing.briefly
    return (
        f"on D/{runs.torn[0]} {why}; a larger accuracy.particles_per_axis, more damping, a stiffer "
        "material or a gentler motion helps"
    )


def _cheapest(found: Convergence, runs: _Runs, goal: Goal) -> tuple[int, float | None]:
    """The coarsest grid run that meets the goal, otherwise the finest; and its error."""
    levels = runs.whole
    for cells, error in zip(levels, found.errors, strict=False):
        if cells >= min(CHEAP) and error <= goal.value:
            return cells, error
    return levels[-1], found.error


def _estimate(goal: Goal, runs: _Runs) -> Convergence:
    """Order and errors of the levels run so far, in the goal's unit."""
    cells = runs.whole
    apart = np.zeros((len(cells), len(cells)))
    for i, j in combinations(range(len(cells)), 2):
        one, other = (runs.done[cells[k]][1] for k in (i, j))
        apart[i, j] = apart[j, i] = _gap(goal, one, other, runs.scene)
    agree = AGREE * UNIT[goal.kind](runs.scene)
    return richardson([1 / n for n in cells], apart, agree=agree)


def _gap(goal: Goal, one: Clip, other: Clip, scene: Scene) -> float:
    """RMS distance of two clips in the goal's unit."""
    if goal.kind == "pixels":
        return pixel_distance(one, other, scene.view)
    unit = scene.object.size if goal.kind == "fraction" else 1.0
    return float(distances([one.surface.means, other.surface.means])[0, 1]) / unit


def _coarsest(goal: Goal, known: int, error: float, order: float, *, above: int = 0) -> int | None:
    """The coarsest grid that should meet the goal, from the error of a known one; or None."""
    for cells in (n for n in CELLS if n >= min(CHEAP) and n > above):
        if error * (known / cells) ** order <= goal.value:
            return cells
    return None


def _unreachable(goal: Goal, why: str) -> InputError:
    return InputError(
        "max_error",
        goal.text,
        f"no grid meets it: {why}.",
        "Allow a larger error, or see `phy124 accuracy` for what each grid achieves here.",
    )


def in_time(
    goal: Goal,
    gaussians: Gaussians,
    scene: Scene,
    *,
    elapsed: float = 0.0,
    device: str = "cpu",
    forecaster: Forecaster | None = None,
    **options: Any,
) -> tuple[Scene, Forecast]:
    """The scene on the finest grid whose forecast fits a time, and the forecast; runs nothing.

    Args:
        goal: The time.
        gaussians: The object.
        scene: The scene.
        elapsed: Seconds of it that have been used already.
        device: Warp device.
        forecaster: Predicts times; None: a new one.
        **options: Options of `Simulation`.

    Raises:
        InputError: Even the coarsest grid would take longer; it says how long.
    """
    runs = _Runs(gaussians, scene, device, silent, Stopwatch(), options)
    found = _finest(goal, runs, forecaster or Forecaster(device, options.get("threads")), elapsed)
    return found.simulation.scene, found.forecast


class _Fit(NamedTuple):
    """A grid that fits a time."""

    cells: int
    simulation: Simulation
    forecast: Forecast
    tried: list[int]


def _in_time(goal: Goal, runs: _Runs, forecaster: Forecaster, elapsed: float) -> Reached:
    start = runs.watch.total
    cells, simulation, forecast, tried = _finest(goal, runs, forecaster, elapsed)
    ready = runs.watch.total - start
    clip = runs.run(simulation)
    about = {
        "target": goal.text, "unit": "seconds", "cells": cells, "levels": tried,
        "predicted": elapsed + forecast.seconds + ready, "caveat": forecast.caveat,
    }  # fmt: skip
    return Reached(simulation, clip, about)


def _finest(goal: Goal, runs: _Runs, forecaster: Forecaster, elapsed: float) -> _Fit:
    """The finest grid whose forecast fits; raises InputError with the time of the coarsest."""
    left, start = MARGIN * goal.value - elapsed, runs.watch.total
    found: dict[int, tuple[Simulation, Forecast]] = {}
    best, cells = 0, CHEAP[0]
    while cells and cells not in found:
        simulation = runs.simulation(cells)
        forecast = forecaster.of(simulation)
        found[cells] = simulation, forecast
        room = left - (runs.watch.total - start)
        fits = forecast.seconds <= room
        best = max(best, cells) if fits else best
        cells = _next(cells, forecast, room, fits, set(found)) or 0
    if not best:
        coarsest = min(found)
        ready = elapsed + runs.watch.total - start
        raise too_long(goal, runs.scene, coarsest, found[coarsest][1], ready)
    return _Fit(best, *found[best], sorted(found))


def _next(cells: int, forecast: Forecast, left: float, fits: bool, tried: set[int]) -> int | None:
    """The grid to try next: close to where the growing forecast meets the remaining time."""
    moving = forecast.stages["simulate"]
    still = forecast.seconds - moving
    room = max(left - still, 0.05 * moving)
    # The particles inside grow as the cube of the cells, the substeps as the cells.
    wanted = cells * (room / moving) ** (1 / GROWTH)
    if fits:
        finer = [n for n in CELLS if cells < n <= max(wanted, cells)]
        return next((n for n in reversed(finer) if n not in tried), None)
    coarser = [n for n in CELLS if n < cells and n not in tried]
    near = [n for n in coarser if n <= wanted]
    return (near or coarser[:1] or [None])[-1]


GROWTH = 2.5
"""Exponent of the growth of the simulation's time with the cells, between surface and solid."""
