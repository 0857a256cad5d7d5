"""Predicts the time of a substep, stage by stage.

Many stages, such as contact, take longer in motion than at rest. The number and the duration of
their calls are therefore measured in a pilot run: over the whole motion, and in the first substeps,
at rest. The duration of a call at rest is measured on the final grid, too.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from phy124.mpm.workers import WINDOW, Timings

WAIT, OTHER = "wait", "other"
"""Names of two stages: waiting for other threads, and all time outside the other stages."""
LIQUID = "liquid, "
"""Prefix of the names of stages that belong to the steps of a projected liquid."""


class Stage(NamedTuple):
    """Number of calls of a stage per substep, and the mean duration of a call."""

    calls: float
    """Calls of the stage per substep."""
    seconds: float
    """Mean duration of a call [s]."""


Stages = Mapping[str, Stage]


class Growth(NamedTuple):
    """Ratios of the run to the pilot run."""

    cells: float
    """Ratio of the cells across the object."""
    substeps: float = 1.0
    """Ratio of the numbers of substeps."""
    steps: float = 1.0
    """Ratio of the numbers of steps of a projected liquid."""


def timings_of(solver: Any) -> Timings:
    """Return the times of all stages of a solver, also of the solver of its liquid."""
    liquid = getattr(solver, "liquid", solver if solver.projects else None)
    of_liquid = {} if liquid is None else liquid.timings
    named = {LIQUID + name: times for name, times in of_liquid.items()}
    return named if liquid is solver else {**solver.timings, **named}


def average_stages(timings: Timings, substeps: int, total: float) -> dict[str, Stage]:
    """Return the calls per substep and the time of a call of each stage.

    `total` is the time of all the substeps [s], including the time outside the stages.
    """
    taken = max(substeps, 1)
    stages = {name: Stage(n / taken, seconds / n) for name, (seconds, n) in timings.items() if n}
    inside = sum(calls * seconds for calls, seconds in stages.values())
    return {**stages, OTHER: Stage(1.0, max(total / taken - inside, 0.0))}


def predict_substep(moving: Stages, resting: Stages, probe: Stages, growth: Growth) -> float:
    """Predict the mean time of a substep in a run [s].

    The time of a call at rest is multiplied by the pilot run's ratio of the times in motion and at
    rest. The result is at least `growth.cells` times the pilot run's time of the call: at rest, the
    objects may not touch, and the number of surface points along a line is proportional to the
    number of cells.

    Args:
        moving: The stages of the whole motion on a coarse grid.
        resting: The stages of a few substeps at rest on the coarse grid.
        probe: The stages of a few substeps at rest on the run's grid.
        growth: Ratios of the run to the pilot run.
    """
    waiting = probe.get(WAIT, Stage(0.0, 0.0))
    seconds = waiting.calls * waiting.seconds
    for name, (calls, each) in moving.items():
        if name == WAIT:
            continue
        at_rest = probe.get(name, Stage(0.0, 0.0)).seconds
        before = resting.get(name, Stage(0.0, 0.0)).seconds
        if name.startswith(LIQUID):
            seconds += _calls_in_liquid(name, calls, growth) * _time_in_liquid(
                each, before, at_rest, growth.cells
            )
            continue
        slower = each / before if before > 0 and name != OTHER else 1.0
        seconds += calls * max(growth.cells * each, slower * at_rest)
    return seconds


def _calls_in_liquid(name: str, calls: float, growth: Growth) -> float:
    """Return the calls per substep. The window of a liquid that spreads is enlarged each time that
    the liquid has moved a certain number of cells.
    """
    grown = growth.cells if name == LIQUID + WINDOW else growth.steps
    return calls * grown / growth.substeps


def _time_in_liquid(moving: float, resting: float, at_rest: float, finer: float) -> float:
    """Return the time of a call [s]: a constant, plus a time proportional to the cells of the
    liquid's window. The times at rest on both grids determine the constant. If they are unknown,
    the time is assumed to be proportional to the area of the window.
    """
    if resting == 0 or at_rest == 0:
        return moving * finer**2
    more = max(finer**3, at_rest / resting)
    fixed = (more * resting - at_rest) / (more - 1) if more > 1 else 0.0
    fixed = min(fixed, moving)
    return fixed + (moving - fixed) * more
