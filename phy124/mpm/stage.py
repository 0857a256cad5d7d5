"""Stage: one launch of a substep, recorded anew whenever the grid's window has changed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import warp as wp

from phy124.mpm.grid import Grid
from phy124.mpm.model import Model
from phy124.mpm.state import State
from phy124.tracks import Tracks


class Stage(NamedTuple):
    """What a force, a boundary or an accumulator adds to a substep."""

    name: str
    """Reports list its time under this name."""
    record: Callable[[Grid], wp.Launch | None]
    """Records its launch for the window of the moment; None if nothing is in reach."""
    sudden: bool = False
    """Whether it may change a velocity at once, whatever its strength."""
    in_newtons: bool = False
    """Whether its track is a force on each particle [N] and not an acceleration [m/s^2]."""


class Attachable(Protocol):
    """A force or a boundary."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """The stages it needs in each substep."""
        ...


class Accumulator(Attachable, Protocol):
    """Sums that grow in every substep and are taken back with a rejected one.

    Its stages come last in a substep, once the boundaries have acted.
    """

    def snapshot(self) -> dict[str, Any]:
        """What the sums are now."""
        ...

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to what they were."""
        ...


Named = tuple[str, Callable[[], Any]]
"""A launch to repeat, under its name."""
Recorded = tuple[str, wp.Launch | None]
"""A recorded launch under its name; None if there is nothing to do."""


def launches(records: list[Recorded]) -> list[Named]:
    """What to call for each record; what has nothing to do is left out."""
    return [(name, launch.launch) for name, launch in records if launch is not None]
