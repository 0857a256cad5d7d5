"""Stage: a kernel launch in a substep; it is recorded again when the grid's window changes."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import warp as wp

from phy124.mpm.grid import Grid
from phy124.mpm.model import Model, State
from phy124.mpm.tracks import Tracks


class Stage(NamedTuple):
    """A launch that a force, a boundary or an accumulator adds to a substep."""

    name: str
    """Name of the stage in a report's list of times."""
    record: Callable[[Grid], wp.Launch | None]
    """Function that records the launch for the grid's window; None if no launch is needed."""
    sudden: bool = False
    """Whether the stage may change a velocity abruptly even if its strength is small."""
    in_newtons: bool = False
    """Whether the track is a force on each particle [N] instead of an acceleration [m/s^2]."""
    keeps_C: bool = False
    """Whether the stage never changes C; sums of its work then need not read C."""
    by_run: bool = False
    """Whether each worker records the stage for only the worker's particles (`Grid.run`)."""
    alone: bool = False
    """Whether one worker launches the stage for all layers while the other workers wait."""
    with_update: Callable[[Grid], wp.Launch | None] | None = None
    """Function that records one launch for stage and grid update; None if impossible."""
    limit: Callable[[float, float], float] | None = None
    """Function that returns the largest acceleration of a particle [m/s^2] between two times [s];
    None: use the track's values.
    """
    top_speed: Callable[[float, float], float] | None = None
    """Function that returns the speed [m/s] up to which the stage accelerates particles between two
    times [s]; None: no limit.
    """


class Attachable(Protocol):
    """A force or a boundary."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that the force or boundary adds to each substep.

        Args:
            model: The constants of the run.
            state: The arrays that the stages read and change.
            tracks: The tracks of the run, to which quantities that change over time are added.
        """
        ...


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
"""The name of a launch, and a function that repeats the launch."""


class Repeatable(Protocol):
    """A kernel launch that was recorded and can be repeated."""

    def launch(self) -> None:
        """Repeat the launch."""
        ...


Recorded = tuple[str, Repeatable | None]
"""The name of a launch, and the recorded launch; None if there is none."""


def launches(records: list[Recorded]) -> list[Named]:
    """Return named functions that repeat the recorded kernel launches; omit missing launches."""
    return [(name, launch.launch) for name, launch in records if launch is not None]
