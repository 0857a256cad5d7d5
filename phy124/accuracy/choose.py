"""Chooses the accuracy that meets a goal: a maximum error or a maximum time.

A level is a run of the scene on one grid. For a maximum error, three cheap levels are run first,
and the order of convergence and their errors are estimated. Then the coarsest grid that is
predicted to meet the goal is run, and the errors are estimated again from all levels. If the levels
do not converge yet, another level is run. If the error still exceeds the goal, the grid is refined
once more, and only once. If a level tears the material (phy124/monitor/tearing.py), that level is
repeated with one more particle per cell and axis, and all later levels use this number, too.

For a maximum time, the finest grid whose forecast fits is run.
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
    guess_errors,
    richardson,
)
from phy124.accuracy.difference import pixel_distance
from phy124.accuracy.forecast import Forecast, Forecaster
from phy124.accuracy.goal import MARGIN, UNIT, Goal, explain_time, format_error
from phy124.budget.limits import duration
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip
from phy124.monitor.tearing import Tearing
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

CHEAP = (16, 24)
"""Cells across the object of the cheap levels; the chosen grid may be one of them."""
CHECK = 12
"""Cells across the object of the third cheap level; observing an order requires three levels."""
CELLS = (8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128)
"""Cells across the object of the grids that may be chosen.

The finest grids take minutes, and less than 2 GB of memory, on two cores.
"""
GUESSED_ORDER = 1.0
"""Order assumed if the cheap levels do not converge; free surfaces converge with first order."""
FAR = 2.5
"""Largest ratio of a new level's cells to the cells of the finest level so far.

Errors on still finer grids cannot be predicted.
"""
FINER = 1.3
"""Smallest ratio of cells at which a level counts as clearly finer."""
DENSEST = 4.0
"""Maximum number of particles per cell and axis."""
LAST_CHANCE = 0.85
"""Fraction of the goal's error that the refinement aims at, since there is no second refinement."""


@dataclass
class Reached:
    """A finished run, and the error or time that it reached."""

    simulation: Simulation
    clip: Clip
    about: dict[str, Any]
    """The goal, the choice and the result, for the report."""


def reach(
    goal: Goal,
    gaussians: Gaussians,
    scene: Scene,
    context: RunContext | None = None,
    *,
    elapsed: float = 0.0,
    crop: Crop = WHOLE,
    forecaster: Forecaster | None = None,
    see: Callable[[Simulation], object] = lambda run: None,
) -> Reached:
    """Run a scene on the grid that meets a goal, ignoring the scene's number of cells.

    Args:
        goal: A maximum error or a maximum time.
        gaussians: The object.
        scene: The scene.
        context: Device, threads, progress and stopwatch.
        elapsed: Part of the maximum time that has already been used [s].
        crop: Rectangle of the object in the picture on which the masks of parts were painted.
        forecaster: Predicts times; None: a new forecaster.
        see: Callback that receives the simulation after each frame of each run.

    Raises:
        InputError: No grid meets the goal. The message gives the error or time of the best grid.
    """
    context = context or RunContext()
    forecaster = forecaster or Forecaster(context)
    runs = _Runs(gaussians, scene, context, crop, see)
    if goal.kind == "seconds":
        return _meet_time(goal, runs, forecaster, elapsed)
    return _meet_error(goal, runs)


@dataclass
class _Runs:
    """Runs a scene on several grids, and stores the result of each grid."""

    gaussians: Gaussians
    scene: Scene
    context: RunContext
    crop: Crop
    see: Callable[[Simulation], object] = lambda run: None
    """Callback that receives the simulation after each frame of each run."""
    done: dict[int, tuple[Simulation, Clip]] = field(default_factory=dict)
    spent: dict[int, float] = field(default_factory=dict)
    """Cells across the object -> duration of the run on this grid [s]."""
    denser: bool = False
    """Whether runs use one more particle per cell and axis, because a level tore the material."""

    def simulation(self, cells: int) -> Simulation:
        """Create a simulation on this grid without starting it."""
        base = self.scene.resolution
        per_axis = self.scene.particles_per_axis + self.denser
        accuracy = base.model_copy(update={"cells": cells, "particles_per_axis": per_axis})
        changed = self.scene.model_copy(update={"accuracy": accuracy})
        return Simulation(prepare(self.gaussians, changed, self.context, crop=self.crop))

    def clip(self, cells: int) -> Clip:
        """Return the clip on this grid; run the simulation if the clip does not exist yet."""
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
        """Run a simulation and return its clip."""
        return simulation.run(record=self.see)

    def _make_denser(self, cells: int) -> None:
        """Repeat a torn level with more particles, unless they would exceed a limit."""
        self.denser = self.scene.particles_per_axis + 1 <= DENSEST
        if self.denser:
            with suppress(InputError):
                self._make(cells)

    @property
    def complete(self) -> bool:
        """Whether all runs reached their last frame."""
        return all(clip.report["complete"] for _, clip in self.done.values())

    @property
    def torn(self) -> list[int]:
        """Levels on which the grid may have torn the material; error estimates ignore them."""
        tearing = {level: run.find(Tearing) for level, (run, _) in self.done.items()}
        return sorted(level for level, search in tearing.items() if search and search.likely)

    @property
    def whole(self) -> list[int]:
        """Levels without tears."""
        return sorted(set(self.done) - set(self.torn))


def _meet_error(goal: Goal, runs: _Runs) -> Reached:
    for level in (CHECK, *CHEAP):
        runs.clip(level)
    if not runs.complete:
        raise _unreachable(goal, "the motion stops early on a coarse grid")
    if runs.torn:
        raise _unreachable(goal, _why_torn(runs))
    result = _estimate(goal, runs)
    error, order = _guess(goal, runs, result)
    meets = min(CHEAP) if result.errors and result.errors[1] <= goal.value else None
    cells = meets or _find_coarsest(goal, max(CHEAP), error, order, above=min(CHEAP))
    if cells is None:
        raise _unreachable(goal, _describe_best(goal, runs, error, order))
    # Without a reliable order, errors on much finer grids cannot be predicted.
    reliable = result.errors and not result.note
    _run(goal, runs, min(cells, _finest_up_to(FAR * max(CHEAP)) if reliable else _next(max(CHEAP))))
    result = _estimate(goal, runs)
    if not result.errors and not runs.torn:
        _run(goal, runs, _next(max(runs.done)))
        result = _estimate(goal, runs)
    cells, best = _choose_run(result, runs, goal)
    refined = best is not None and best > goal.value and not runs.torn
    if refined:
        finest, (error, order) = max(runs.done), _guess(goal, runs, result)
        error /= LAST_CHANCE
        target = _find_coarsest(goal, finest, error, order, above=finest) or _next(finest)
        _run(goal, runs, min(target, _finest_up_to(FAR * finest)))
        result = _estimate(goal, runs)
        cells, best = _choose_run(result, runs, goal)
    simulation, clip = runs.done[cells]
    return Reached(simulation, clip, _report(goal, cells, best, result, runs, refined))


def _guess(goal: Goal, runs: _Runs, result: Convergence) -> tuple[float, float]:
    """Return the error of the finest level without tears, and the order for extrapolation."""
    if result.error is not None:
        order = result.order or GUESSED_ORDER
        return result.error, min(max(order, TRUSTED[0]), TRUSTED[1])
    coarse, fine = runs.whole[-2:]
    gap = _distance(goal, runs.clip(coarse), runs.clip(fine), runs.scene)
    return guess_errors((1 / coarse, 1 / fine), gap, GUESSED_ORDER)[1], GUESSED_ORDER


def _run(goal: Goal, runs: _Runs, cells: int) -> None:
    """Run a level; raise InputError if it would need too much time or memory."""
    try:
        runs.clip(cells)
    except InputError as error:
        why = f"this needs D/{cells}, for which {error.limit.rstrip('.')}"
        raise _unreachable(goal, why) from None


def _next(cells: int) -> int:
    """Return the coarsest grid that is clearly finer than this one, or else the finest grid."""
    return next((n for n in CELLS if n >= FINER * cells), CELLS[-1])


def _finest_up_to(cells: float) -> int:
    return max(n for n in CELLS if n <= cells)


def _describe_best(goal: Goal, runs: _Runs, error: float, order: float) -> str:
    """Describe the error and time of the finest grid, extrapolated from the finest run."""
    known, finest = max(runs.done), CELLS[-1]
    best = format_error(goal.kind, error * (known / finest) ** order)
    seconds = duration(runs.spent[known] * (finest / known) ** GROWTH)
    return f"even D/{finest}, in about {seconds}, would have an error of about {best}"


def _report(
    goal: Goal, cells: int, error: float | None, result: Convergence, runs: _Runs, refined: bool
) -> dict[str, Any]:
    """Return the goal and the result, in the goal's unit, for the report."""
    levels, met = runs.whole, error is not None and error <= goal.value
    return {
        "target": goal.text,
        "unit": goal.kind,
        "cells": cells,
        "levels": levels,
        "errors": list(result.errors),
        "seconds": [runs.spent[n] for n in levels],
        "order": result.order,
        "error": error,
        "fraction": None if error is None else error / UNIT[goal.kind](runs.scene),
        "refined": refined,
        "met": met,
        "torn": runs.torn,
        "particles_per_axis": runs.done[cells][0].scene.particles_per_axis,
        "why_not": _why_torn(runs) if runs.torn and not met else result.why_not,
    }


def _why_torn(runs: _Runs) -> str:
    tearing = runs.done[runs.torn[0]][0].find(Tearing)
    why = "" if tearing is None else tearing.briefly
    return (
        f"on D/{runs.torn[0]} {why}; a larger accuracy.particles_per_axis, more damping, a stiffer "
        "material or a gentler motion helps"
    )


def _choose_run(result: Convergence, runs: _Runs, goal: Goal) -> tuple[int, float | None]:
    """Return a grid and its error.

    It is the coarsest grid that meets the goal, or the finest grid if none does.
    """
    levels = runs.whole
    for cells, error in zip(levels, result.errors, strict=False):
        if cells >= min(CHEAP) and error <= goal.value:
            return cells, error
    return levels[-1], result.error


def _estimate(goal: Goal, runs: _Runs) -> Convergence:
    """Estimate the order and the errors of all levels without tears, in the goal's unit."""
    cells = runs.whole
    apart = np.zeros((len(cells), len(cells)))
    for i, j in combinations(range(len(cells)), 2):
        first, second = (runs.done[cells[k]][1] for k in (i, j))
        apart[i, j] = apart[j, i] = _distance(goal, first, second, runs.scene)
    agree = AGREE * UNIT[goal.kind](runs.scene)
    return richardson([1 / n for n in cells], apart, agree=agree)


def _distance(goal: Goal, first: Clip, second: Clip, scene: Scene) -> float:
    """Return the RMS distance of two clips in the goal's unit."""
    if goal.kind == "pixels":
        return pixel_distance(first, second, scene.view)
    unit = scene.object.size if goal.kind == "fraction" else 1.0
    return float(distances([first.surface.means, second.surface.means])[0, 1]) / unit


def _find_coarsest(
    goal: Goal, known: int, error: float, order: float, *, above: int = 0
) -> int | None:
    """Return the coarsest grid predicted to meet the goal; None if none is.

    The errors are extrapolated, with an order, from the error on the grid with `known` cells.
    """
    for cells in (n for n in CELLS if n >= min(CHEAP) and n > above):
        if error * (known / cells) ** order <= goal.value:
            return cells
    return None


def _unreachable(goal: Goal, why: str) -> InputError:
    return InputError(
        "max_error",
        goal.text,
        f"no grid meets this target: {why}.",
        "Allow a larger error, or compare the grids with `phy124 accuracy`.",
    )


def in_time(
    goal: Goal,
    gaussians: Gaussians,
    scene: Scene,
    context: RunContext | None = None,
    *,
    elapsed: float = 0.0,
    crop: Crop = WHOLE,
    forecaster: Forecaster | None = None,
) -> tuple[Scene, Forecast]:
    """Return the scene on the finest grid whose forecast fits a maximum time, and the forecast.

    Only the probes of the forecasts are run.

    Args:
        goal: The maximum time.
        gaussians: The object.
        scene: The scene.
        context: Device and threads.
        elapsed: Part of the maximum time that has already been used [s].
        crop: Rectangle of the object in the picture on which the masks of parts were painted.
        forecaster: Predicts times; None: a new forecaster.

    Raises:
        InputError: Even the coarsest grid would take longer. The message gives its time.
    """
    context = (context or RunContext()).aside()
    runs = _Runs(gaussians, scene, context, crop)
    forecaster = forecaster or Forecaster(context)
    fit = _find_finest(goal, runs, forecaster, elapsed)
    return fit.simulation.scene, fit.forecast


class _Fit(NamedTuple):
    """A grid whose forecast fits the maximum time."""

    cells: int
    simulation: Simulation
    forecast: Forecast
    tried: list[int]


def _meet_time(goal: Goal, runs: _Runs, forecaster: Forecaster, elapsed: float) -> Reached:
    start = runs.context.watch.total
    cells, simulation, forecast, tried = _find_finest(goal, runs, forecaster, elapsed)
    ready = runs.context.watch.total - start
    clip = runs.run(simulation)
    about = {
        "target": goal.text,
        "unit": "seconds",
        "cells": cells,
        "levels": tried,
        "predicted": elapsed + forecast.seconds + ready,
        "caveat": forecast.caveat,
    }
    return Reached(simulation, clip, about)


def _find_finest(goal: Goal, runs: _Runs, forecaster: Forecaster, elapsed: float) -> _Fit:
    """Return the finest grid whose forecast fits the maximum time.

    Raises:
        InputError: No forecast fits.
    """
    available, start = MARGIN * goal.value - elapsed, runs.context.watch.total
    tried: dict[int, tuple[Simulation, Forecast]] = {}
    best, cells = 0, CHEAP[0]
    while cells and cells not in tried:
        simulation = runs.simulation(cells)
        forecast = forecaster.of(simulation)
        tried[cells] = simulation, forecast
        left = available - (runs.context.watch.total - start)
        fits = forecast.seconds <= left
        best = max(best, cells) if fits else best
        cells = _choose_next(cells, forecast, left, fits, set(tried)) or 0
    if not best:
        coarsest = min(tried)
        ready = elapsed + runs.context.watch.total - start
        raise explain_time(goal, runs.scene, coarsest, tried[coarsest][1], ready)
    return _Fit(best, *tried[best], sorted(tried))


def _choose_next(
    cells: int, forecast: Forecast, left: float, fits: bool, tried: set[int]
) -> int | None:
    """Return the next grid to forecast; None if no other grid is worth a forecast.

    The next grid is expected to take about as much time as is left.
    """
    simulation = forecast.stages["simulate"]
    available = max(left - (forecast.seconds - simulation), 0.05 * simulation)
    target = cells * (available / simulation) ** (1 / GROWTH)
    if fits:
        finer = [n for n in CELLS if cells < n <= max(target, cells)]
        return next((n for n in reversed(finer) if n not in tried), None)
    coarser = [n for n in CELLS if n < cells and n not in tried]
    near = [n for n in coarser if n <= target]
    return (near or coarser[:1] or [None])[-1]


GROWTH = 2.5
"""Exponent of the time: a simulation's time is assumed to grow as cells^GROWTH.

The exponent lies between those of a thin surface (2) and of a solid (3).
"""
