"""Stage: a kernel launch in a substep; it is recorded again when the grid's window changes."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.mpm.grid import Grid
from phy124.mpm.model import Model, State
from phy124.mpm.tracks import Tracks


class Stage(NamedTuple):
    """A kernel launch that a force, a boundary or an accumulator adds to each substep."""

    name: str
    """Name under which reports list the stage's time."""
    record: Callable[[Grid], wp.Launch | None]
    """Function that records the launch for a grid's window, or returns None if none is needed."""
    sudden: bool = False
    """Whether the stage may change a velocity abruptly even if its track's values are small."""
    in_newtons: bool = False
    """Whether the track contains forces on each particle [N] instead of accelerations [m/s^2]."""
    keeps_C: bool = False
    """Whether the stage never changes C, so that sums of work need not read C."""
    by_run: bool = False
    """Whether each worker records a launch for only its part of the particles (`Grid.run`)."""
    alone: bool = False
    """Whether one worker launches the stage for all layers while the other workers wait."""
    with_update: Callable[[Grid], wp.Launch | None] | None = None
    """Function that records one kernel launch for both the stage and the grid update, or None."""
    limit: Callable[[float, float], float] | None = None
    """Function that returns the largest acceleration of a particle [m/s^2] between two times [s].
    If `limit` is None, the track's values are used.
    """
    top_speed: Callable[[float, float], float] | None = None
    """Function that returns the speed [m/s] up to which the stage accelerates particles between two
    times [s]. If `top_speed` is None, the stage may accelerate particles to any speed.
    """
    points: NDArray[np.int64] | None = None
    """Indices of the particles whose motion the stage reads or changes; None: possibly all."""


class Attachable(Protocol):
    """A force or a boundary."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that the force or boundary adds to each substep.

        Quantities that change over time are added to `tracks`.
        """
        ...


def divide_forces(forces: Sequence[Any], part: Model, whole: Model) -> list[Any]:
    """Return the forces on a part of a divided model; the part gets its share of total forces."""
    parts = (force.in_part(part, whole) for force in forces)
    return [force for force in parts if force is not None]


class Sums(Protocol):
    """Sums that are updated in every substep and restored after a rejected substep."""

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot of the sums."""
        ...

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the sums from a snapshot."""
        ...


class Accumulator(Attachable, Sums, Protocol):
    """Sums that are updated by the last stages of a substep, after the boundaries have acted."""


Named = tuple[str, Callable[[], Any]]
"""The name of a stage, and a function that repeats its kernel launch."""


class Repeatable(Protocol):
    """A kernel launch that was recorded and can be repeated."""

    def launch(self) -> None:
        """Repeat the kernel launch."""
        ...


Recorded = tuple[str, Repeatable | None]
"""The name of a stage, and its recorded kernel launch; None if there is no launch."""


def launches(records: list[Recorded]) -> list[Named]:
    """Return a named function for each recorded kernel launch that repeats it; omit None."""
    return [(name, launch.launch) for name, launch in records if launch is not None]


def push_launches(stages: Sequence[Stage], grid: Grid, worker: int, workers: int) -> list[Named]:
    """Return a worker's kernel launches that apply forces to particles or points.

    The first worker gets all launches if a launch cannot be divided between workers.

    Args:
        stages: The stages of the forces.
        grid: The grid for which launches are recorded.
        worker: Index of the worker.
        workers: Number of workers.
    """
    divided = all(stage.by_run for stage in stages)
    if worker > 0 and not divided:
        return []
    with grid.only(None, worker, workers if divided else 1):
        return launches([(stage.name, stage.record(grid)) for stage in stages])
