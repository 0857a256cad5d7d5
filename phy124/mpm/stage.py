"""Stage: a launch of a substep, recorded again whenever the grid's window has changed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import warp as wp

from phy124.mpm.grid import Grid
from phy124.mpm.model import Model, State
from phy124.mpm.tracks import Tracks


class Stage(NamedTuple):
    """A launch that a force, a boundary or an accumulator adds to a substep."""

    name: str
    """The name under which reports list its time."""
    record: Callable[[Grid], wp.Launch | None]
    """Records its launch for the grid's current window; None if nothing is within reach."""
    sudden: bool = False
    """Whether it may change a velocity abruptly, whatever its strength."""
    in_newtons: bool = False
    """Whether its track is a force on each particle [N] and not an acceleration [m/s^2]."""
    keeps_C: bool = False
    """Whether a force never changes C, so that summing its work need not read it."""
    by_run: bool = False
    """Whether a force is recorded for each worker, and pushes the particles of `Grid.run` only."""
    alone: bool = False
    """Whether one worker launches it for all layers of the grid while the others wait."""
    limit: Callable[[float, float], float] | None = None
    """Largest acceleration of a particle [m/s^2] between two times [s]; None: its track's."""
    top_speed: Callable[[float, float], float] | None = None
    """Speed [m/s] above which it accelerates no particle between two times [s]; None: no limit."""


class Attachable(Protocol):
    """A force or a boundary."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that it needs in each substep.

        Args:
            model: The constants of the run.
            state: The arrays that its launches read and change.
            tracks: Registers quantities that change over time.
        """
        ...


class Sums(Protocol):
    """Sums that grow in every substep and are restored after a rejected one."""

    def snapshot(self) -> dict[str, Any]:
        """Return the present sums."""
        ...

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Set the sums back to a snapshot."""
        ...


class Accumulator(Attachable, Sums, Protocol):
    """Sums whose stages come last in a substep, after the boundaries have acted."""


Named = tuple[str, Callable[[], Any]]
"""A name, and a launch to repeat."""
Recorded = tuple[str, wp.Launch | None]
"""A name, and a recorded launch; None if there is nothing to do."""


def launches(records: list[Recorded]) -> list[Named]:
    """Return a function to call for each recorded launch; empty launches are left out."""
    return [(name, launch.launch) for name, launch in records if launch is not None]
