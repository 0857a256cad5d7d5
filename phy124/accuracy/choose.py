"""Chooses an accuracy that meets a goal: a maximum error or a maximum time.

For a maximum error, grids are run from coarse to fine; each grid has at most 1.5 times as many
cells across the object as the grid before. After three grids, the order of convergence and the
errors are estimated. Coarse grids on which the run stops early are left out. The next grid is the
coarsest that is predicted to meet the goal. If the material tears on a grid, the run is repeated
with one more particle per cell and axis.

For a maximum time, the scene is run on the finest grid whose predicted time is within the maximum.
"""

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
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
from phy124.accuracy.probe import min_cells
from phy124.accuracy.runs import Runs
from phy124.budget.limits import duration
from phy124.errors import InputError, TooFine
from phy124.gaussians import Frame, Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip
from phy124.monitor.tearing import Tearing
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation

FIRST = (12, 16, 24)
"""Cells across the object on the first grids; an order of convergence needs three grids."""
STEP = 1.5
"""Largest ratio of the cells on a new grid to the cells on the finest grid so far."""
CELLS = (8, 10, 12, 14, 16, 20, 24, 28, 32, 40, 48, 56, 64, 80, 96, 112, 128)
"""Possible numbers of cells across the object after the first grids. A run on the finest grids
takes minutes on two cores, and less than 2 GB of memory.
"""
GUESSED_ORDER = 1.0
"""Order of convergence that is assumed if the results do not converge; with free surfaces, the
error is of first order.
"""
START = 16
"""Cells across the object at the start of the search for a maximum time."""
ATTEMPTS = 2
"""Largest number of further grids if the results on the first grids do not converge."""


@dataclass
class Reached:
    """The chosen run, with its clip and its measured error or time."""

    simulation: Simulation
    clip: Clip
    about: dict[str, Any]
    """Goal, chosen grid and result, for the report."""
    forecast: Forecast | None = None
    """The forecast that led to the grid; None if the goal is an error."""


def run_for_goal(
    goal: Goal,
    gaussians: Gaussians,
    scene: Scene,
    context: RunContext | None = None,
    *,
    elapsed: float = 0.0,
    crop: Crop = WHOLE,
    forecaster: Forecaster | None = None,
    begin: Callable[[Simulation], object] = lambda run: None,
    see: Callable[[Simulation], object] = lambda run: None,
    each: Callable[[Simulation, Frame], object] | None = None,
) -> Reached:
    """Run a scene on the grid that meets a goal; the number of cells in the scene is ignored.

    Args:
        goal: A maximum error or a maximum time.
        gaussians: The object.
        scene: The scene.
        context: Device, threads, progress and stopwatch.
        elapsed: Part of the maximum time that is already used [s].
        crop: Position of the object in the picture with the masks of parts.
        forecaster: Predicts times; None: a new forecaster.
        begin: Function called with the simulation before each run.
        see: Function called with the simulation after each frame of each run.
        each: Function called with the chosen simulation and each frame; if the goal is an error,
            after the last run, because the chosen run is then unknown before.

    Raises:
        InputError: No grid meets the goal. The message states the error or time of the best grid.
    """
    context = context or RunContext()
    forecaster = forecaster or Forecaster(context)
    runs = Runs(gaussians, scene, context, crop, begin, see)
    if goal.kind == "seconds":
        return _meet_time(goal, runs, forecaster, elapsed, each)
    reached = _meet_error(goal, runs)
    if each is not None:
        for frame in reached.clip.frames():
            each(reached.simulation, frame)
    return reached


def _meet_error(goal: Goal, runs: Runs) -> Reached:
    _run_first_grids(runs)
    _replace_stopped(goal, runs)
    if runs.torn:
        raise _unreachable(goal, _why_torn(runs))
    result, obstacle, first = _estimate(goal, runs), "", len(runs.done)
    while not (obstacle or runs.torn or _choose_run(result, runs, goal)[2]):
        obstacle = _refine(goal, runs, result)
        if obstacle and len(runs.done) == first:
            raise _unreachable(goal, obstacle)
        result = _estimate(goal, runs)
    cells, best, met = _choose_run(result, runs, goal)
    simulation, clip = runs.done[cells]
    return Reached(simulation, clip, _report(goal, cells, best, met, result, runs, obstacle))


def _run_first_grids(runs: Runs) -> None:
    """Run the scene on the grids `FIRST`, or on finer grids if the scene needs them."""
    coarsest = max(FIRST[0], min_cells(runs.scene))
    try:
        runs.clip(coarsest)
    except TooFine:
        raise
    except InputError:
        if runs.scene.resolution.cells <= coarsest:
            raise
        coarsest = runs.scene.resolution.cells
    for cells in FIRST:
        runs.clip(math.ceil(cells * coarsest / FIRST[0]))


def _replace_stopped(goal: Goal, runs: Runs) -> None:
    """Run finer grids until as many grids as in `FIRST` are complete.

    Raises:
        InputError: More than the coarsest grids stop early, or a finer grid is refused.
    """
    while runs.stopped and not runs.torn and len(runs.whole) < len(FIRST):
        last = runs.stopped[-1]
        finer, coarsest = _list_finer(max(runs.done)), min(runs.whole, default=last)
        if len(runs.stopped) > len(FIRST) or last > coarsest or not finer:
            stopped, why = runs.done[last][1], f"on D/{last} the simulation stops early"
            raise _unreachable(goal, f"{why}: {stopped.report['stopped'].rstrip('.')}")
        try:
            runs.clip(finer[-1])
        except InputError as refusal:
            why = f"coarse grids stop early, and for D/{finer[-1]} {refusal.limit.rstrip('.')}"
            raise _unreachable(goal, why) from refusal


def _refine(goal: Goal, runs: Runs, result: Convergence) -> str:
    """Run the scene on a finer grid and return ""; if no finer grid is possible, return the
    reason.
    """
    if not result.errors and len(runs.whole) >= len(FIRST) + ATTEMPTS:
        return result.why_not
    finest, (error, order) = max(runs.done), _guess(goal, runs, result)
    if error * (finest / CELLS[-1]) ** order > goal.value:
        return _describe_best(goal, runs, error, order)
    needed = finest * (error / goal.value) ** (1 / order)
    finer = _list_finer(finest)
    cells = next((n for n in finer if n >= needed), finer[-1])
    try:
        runs.clip(cells)
    except InputError as refusal:
        return f"this needs the grid D/{cells}, for which {refusal.limit.rstrip('.')}"
    why = runs.clip(cells).report["stopped"]
    return f"on D/{cells} the simulation stops early: {why.rstrip('.')}" if why else ""


def _list_finer(finest: int) -> list[int]:
    """Return the grids that may follow the finest grid so far."""
    return [n for n in CELLS if finest < n <= STEP * finest]


def _guess(goal: Goal, runs: Runs, result: Convergence) -> tuple[float, float]:
    """Estimate the error on the finest grid and the order of convergence, ignoring grids on which
    the material may have torn.
    """
    if result.error is not None:
        order = result.order or GUESSED_ORDER
        return result.error, min(max(order, TRUSTED[0]), TRUSTED[1])
    coarse, fine = runs.whole[-2:]
    gap = _distance(goal, runs.clip(coarse), runs.clip(fine), runs.scene)
    return guess_errors((1 / coarse, 1 / fine), gap, GUESSED_ORDER)[1], GUESSED_ORDER


def _describe_best(goal: Goal, runs: Runs, error: float, order: float) -> str:
    """Describe error and time on the finest possible grid, extrapolated from the last grid."""
    known, finest = max(runs.done), CELLS[-1]
    best = format_error(goal.kind, error * (known / finest) ** order)
    seconds = duration(runs.spent[known] * (finest / known) ** GROWTH)
    time = f"which takes about {seconds}"
    return f"even the grid D/{finest}, {time}, would have an error of about {best}"


def _report(
    goal: Goal,
    cells: int,
    error: float | None,
    met: bool,
    result: Convergence,
    runs: Runs,
    obstacle: str,
) -> dict[str, Any]:
    levels = runs.whole
    why_not = _why_torn(runs) if runs.torn else result.why_not or obstacle
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
        "refined": len(runs.whole) > len(FIRST),
        "met": met,
        "torn": runs.torn,
        "stopped": [n for n in runs.stopped if n < levels[0]],
        "particles_per_axis": runs.done[cells][0].scene.particles_per_axis,
        "why_not": "" if met else why_not,
    }


def _why_torn(runs: Runs) -> str:
    tearing = runs.done[runs.torn[0]][0].find(Tearing)
    why = "" if tearing is None else tearing.briefly
    return (
        f"on D/{runs.torn[0]} {why}; a larger accuracy.particles_per_axis, more damping, a stiffer "
        "material or a gentler motion helps"
    )


def _choose_run(result: Convergence, runs: Runs, goal: Goal) -> tuple[int, float | None, bool]:
    """Return the best grid, its error, and whether the error meets the goal.

    The best grid is the coarsest that meets the goal, or else the finest.
    """
    levels = runs.whole
    for cells, error in zip(levels, result.errors, strict=False):
        if error <= goal.value:
            return cells, error, True
    return levels[-1], result.error, False


def _estimate(goal: Goal, runs: Runs) -> Convergence:
    cells = runs.whole
    apart = np.zeros((len(cells), len(cells)))
    for i, j in combinations(range(len(cells)), 2):
        first, second = (runs.done[cells[k]][1] for k in (i, j))
        apart[i, j] = apart[j, i] = _distance(goal, first, second, runs.scene)
    agree = AGREE * UNIT[goal.kind](runs.scene)
    return richardson([1 / n for n in cells], apart, agree=agree)


def _distance(goal: Goal, first: Clip, second: Clip, scene: Scene) -> float:
    """Return the RMS distance between two clips, in the unit of the goal."""
    if goal.kind == "pixels":
        return pixel_distance(first, second, scene.view)
    unit = scene.object.size if goal.kind == "fraction" else 1.0
    return float(distances([first.object_means, second.object_means])[0, 1]) / unit


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
    """Return the scene on the finest grid whose predicted time is short enough, and the forecast.
    The forecast includes the time to make the particles of all grids that were tried.

    Args:
        goal: The maximum time.
        gaussians: The object.
        scene: The scene.
        context: Device and threads.
        elapsed: Part of the maximum time that is already used [s].
        crop: Position of the object in the picture with the masks of parts.
        forecaster: Predicts times; None: a new forecaster.

    Raises:
        InputError: Even the coarsest grid would take longer. The message states the necessary time.
    """
    context = (context or RunContext()).aside()
    runs = Runs(gaussians, scene, context, crop)
    forecaster = forecaster or Forecaster(context)
    fit = _find_finest(goal, runs, forecaster, elapsed)
    preparing = context.watch.seconds.get("particles", 0.0)
    return fit.simulation.scene, fit.forecast.with_measured("particles", preparing)


class _Fit(NamedTuple):
    cells: int
    simulation: Simulation
    forecast: Forecast
    tried: list[int]


def _meet_time(
    goal: Goal,
    runs: Runs,
    forecaster: Forecaster,
    elapsed: float,
    each: Callable[[Simulation, Frame], object] | None,
) -> Reached:
    start = runs.context.watch.total
    cells, simulation, forecast, tried = _find_finest(goal, runs, forecaster, elapsed)
    ready = runs.context.watch.total - start
    clip = runs.run(simulation, each and partial(each, simulation))
    about = {
        "target": goal.text,
        "unit": "seconds",
        "cells": cells,
        "levels": tried,
        "predicted": elapsed + forecast.seconds + ready,
        "caveat": forecast.caveat,
    }
    return Reached(simulation, clip, about, forecast)


def _find_finest(goal: Goal, runs: Runs, forecaster: Forecaster, elapsed: float) -> _Fit:
    watch = runs.context.watch
    available, start, compiled = MARGIN * goal.value - elapsed, watch.total, _sum_compilation(runs)
    tried: dict[int, tuple[Simulation, Forecast]] = {}
    least = min_cells(runs.scene)
    grids = [n for n in CELLS if n >= least] or [least]
    best, cells, preparing = 0, max(START, grids[0]), 0.0
    while cells:
        prepared = _sum_preparation(runs)
        try:
            simulation = runs.simulation(cells)
        except InputError as refusal:
            grids = _drop_refused(cells, refusal, grids, tried, runs.scene)
            if not grids:
                raise
            if not tried:
                cells = max((n for n in grids if n < cells), default=grids[0])
                continue
        else:
            preparing = _sum_preparation(runs) - prepared
            tried[cells] = simulation, forecaster.of(simulation)
        last = next(reversed(tried))
        forecast, left = tried[last][1], available - (watch.total - start)
        if forecast.seconds <= left:
            best = max(best, last)
        kept = tried[best][1].seconds if best else 0.0
        finer = [n for n in grids if n > best and n not in tried]
        wanted = [n for n in finer if n > last] if last == best else [n for n in finer if n < last]
        cells = _choose_next(last, wanted, preparing, forecast, left, kept)
    if not best:
        coarsest = min(tried)
        # If the user repeats the command, the kernels are already compiled.
        ready = elapsed + watch.total - start - (_sum_compilation(runs) - compiled)
        raise explain_time(goal, runs.scene, coarsest, tried[coarsest][1], ready)
    return _Fit(best, *tried[best], sorted(tried))


def _drop_refused(
    cells: int, refusal: InputError, grids: list[int], tried: Collection[int], scene: Scene
) -> list[int]:
    """Return the grids that may be possible although the grid with this number of cells is refused.

    If the refused grid is too fine, the result is the coarser grids, otherwise the finer grids. If
    no grid was possible so far, the result begins with the scene's own grid.
    """
    if isinstance(refusal, TooFine) or any(n < cells for n in tried):
        return [n for n in grids if n < cells]
    least = cells + 1 if tried else scene.resolution.cells
    return [n for n in grids if n >= least > cells]


def _sum_compilation(runs: Runs) -> float:
    return runs.context.watch.seconds.get("compile", 0.0)


def _sum_preparation(runs: Runs) -> float:
    seconds = runs.context.watch.seconds
    return sum(seconds.get(stage, 0.0) for stage in ("particles", "compile"))


def _choose_next(
    cells: int, wanted: list[int], preparing: float, forecast: Forecast, left: float, kept: float
) -> int:
    """Return the cells of the next grid for which to make a forecast; 0 if there is none.

    The preparation and the run of this grid should stay within the time `left` [s]. After the
    preparation, enough time must remain to run the best grid so far (`kept` [s]).
    """
    simulation = forecast.stages["simulate"]
    others = forecast.seconds - simulation
    fitting = []
    for n in wanted:
        ready, run = (seconds * (n / cells) ** GROWTH for seconds in (preparing, simulation))
        if ready + max(run + others, kept) <= left:
            fitting.append(n)
    return fitting[-1] if fitting else 0 if kept else next(iter(wanted), 0)


GROWTH = 2.5
"""The times of preparation and simulation are assumed to be proportional to cells^GROWTH; thin
surfaces would have the exponent 2, solids 3.
"""
