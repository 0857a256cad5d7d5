"""Predicts the time of a substep on lattices, stage by stage.

Some stages, such as contact, take longer in motion than at rest. The calls of each stage are
therefore counted in a pilot run of the whole motion. The duration of a call is measured on the
final grid.
"""

from collections.abc import Mapping
from typing import NamedTuple

from phy124.mpm.workers import Timings

WAIT = "wait"


class Stage(NamedTuple):
    """Number of calls of a stage per substep, and the mean duration of a call."""

    calls: float
    """Calls of the stage per substep."""
    seconds: float
    """Mean duration of a call [s]."""


Stages = Mapping[str, Stage]


def average_stages(timings: Timings, substeps: int) -> dict[str, Stage]:
    """Return the calls per substep and the time of a call of each stage."""
    taken = max(substeps, 1)
    return {name: Stage(n / taken, seconds / n) for name, (seconds, n) in timings.items() if n}


def predict_substep(pilot: Stages, probe: Stages, finer: float, total: float) -> float:
    """Predict the mean time of a substep in a run [s].

    The time of a call in the pilot run is multiplied by `finer`, because the number of surface
    points along a line is proportional to the number of cells.

    Args:
        pilot: The stages of the whole motion on a coarse grid.
        probe: The stages of a few substeps at rest on the run's grid.
        finer: Cells on the run's grid, relative to the pilot's grid.
        total: Time of a substep of the probe, including the time between stages [s].
    """
    seconds = total - sum(calls * each for calls, each in probe.values())
    for name, (calls, each) in pilot.items():
        at_rest = probe.get(name)
        if name == WAIT:
            seconds += 0.0 if at_rest is None else calls * at_rest.seconds
        else:
            seconds += calls * max(finer * each, 0.0 if at_rest is None else at_rest.seconds)
    return seconds
