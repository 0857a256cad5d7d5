"""Predicts the time of a substep on lattices, stage by stage.

Some stages take longer in motion than at rest: contact, the search for touching parts, and
measurements of the vibration frequency. Therefore, the calls of each stage are counted in a pilot
run of the whole motion. The duration of a call is measured in a short trial run on the final grid.
"""

from collections.abc import Mapping
from typing import NamedTuple

from phy124.mpm.workers import Timings

WAIT = "wait"
"""Name of the stage in which a thread waits for other threads."""


class Stage(NamedTuple):
    """Number of calls of a stage per substep, and the mean duration of a call."""

    calls: float
    """Number of calls of the stage per substep."""
    seconds: float
    """Mean duration of a call of the stage [s]."""


Stages = Mapping[str, Stage]
"""Number and duration of the calls of each stage."""


def average_stages(timings: Timings, substeps: int) -> dict[str, Stage]:
    """Return, for each stage, the mean number of calls per substep and the mean time of a call."""
    taken = max(substeps, 1)
    return {name: Stage(n / taken, seconds / n) for name, (seconds, n) in timings.items() if n}


def predict_substep(pilot: Stages, probe: Stages, finer: float, total: float) -> float:
    """Predict the mean time of a substep in a run [s].

    Calls of some stages, such as contact, take longer in motion than at rest. The time of these
    calls in the pilot run is multiplied by `finer`, because the number of surface points along a
    line is proportional to the number of cells.

    Args:
        pilot: The stages of the whole motion on a coarse grid.
        probe: The stages of a few substeps at rest on the run's grid.
        finer: Number of cells on the run's grid, divided by the number on the pilot's grid.
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
