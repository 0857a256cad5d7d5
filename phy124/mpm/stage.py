"""Stage: one launch of a substep, recorded anew whenever the grid's window has changed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import warp as wp

from phy124.mpm.grid import Grid
from phy124.mpm.model import Model
from phy124.mpm.state import State
from phy124.mpm.tracks import Tracks


class Stage(NamedTuple):
    """What a force, a boundary or an accumulator adds to a substep."""

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
    """How much it accelerates a particle at most [m/s^2] from one time to another [s]; None: as
    much as its track has."""
    top_speed: Callable[[float, float], float] | None = None
    """The speed [m/s] above which it accelerates no particle from one time to another [s]; None: it
    has no such speed."""


class Attachable(Protocol):
    """A force or a boundary."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """The stages it needs in each substep.

        Args:
            model: What stays the same during the run.
            state: What its launches read and change.
            tracks: Where it registers what changes over time.
        """
        ...


class Sums(Protocol):
    """Sums that grow in every substep and are restored after a rejected one."""

    def snapshot(self) -> dict[str, Any]:
        """The sums as they are now."""
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
    """A function to call for each recorded launch; those with nothing to do are left out."""
    return [(name, launch.launch) for name, launch in records if launch is not None]
