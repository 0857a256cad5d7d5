"""Predicts the time of a substep, stage by stage.

Many stages, such as contact, take longer in motion than at rest. Their calls and durations are
therefore measured in a pilot run of the whole motion, and compared with those of the pilot's first
substeps, at rest. The duration of a call at rest is measured on the final grid, too.
"""

from collections.abc import Mapping
from typing import NamedTuple

from phy124.mpm.workers import Timings

WAIT, OTHER = "wait", "other"
"""Names of two stages: waiting for other threads, and all time outside the other stages."""


class Stage(NamedTuple):
    """Number of calls of a stage per substep, and the mean duration of a call."""

    calls: float
    """Calls of the stage per substep."""
    seconds: float
    """Mean duration of a call [s]."""


Stages = Mapping[str, Stage]


def average_stages(timings: Timings, substeps: int, total: float) -> dict[str, Stage]:
    """Return the calls per substep and the time of a call of each stage.

    `total` is the time of all the substeps [s], including the time outside the stages.
    """
    taken = max(substeps, 1)
    stages = {name: Stage(n / taken, seconds / n) for name, (seconds, n) in timings.items() if n}
    inside = sum(calls * seconds for calls, seconds in stages.values())
    return {**stages, OTHER: Stage(1.0, max(total / taken - inside, 0.0))}


def predict_substep(moving: Stages, resting: Stages, probe: Stages, finer: float) -> float:
    """Predict the mean time of a substep in a run [s].

    A call takes as many times longer in motion as in the pilot run, but at least `finer` times as
    long as in the pilot run, because the number of surface points along a line is proportional to
    the number of cells: at rest, the objects may not touch.

    Args:
        moving: The stages of the whole motion on a coarse grid.
        resting: The stages of a few substeps at rest on the coarse grid.
        probe: The stages of a few substeps at rest on the run's grid.
        finer: Cells on the run's grid, relative to the coarse grid.
    """
    waiting = probe.get(WAIT, Stage(0.0, 0.0))
    seconds = waiting.calls * waiting.seconds
    for name, (calls, each) in moving.items():
        if name == WAIT:
            continue
        at_rest = probe.get(name, Stage(0.0, 0.0)).seconds
        before = resting.get(name, Stage(0.0, 0.0)).seconds
        slower = each / before if before > 0 and name != OTHER else 1.0
        seconds += calls * max(finer * each, slower * at_rest)
    return seconds
