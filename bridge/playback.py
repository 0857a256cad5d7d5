"""Playback: the state of playback, as sinks and reports see it."""

from __future__ import annotations

from typing import Protocol


class Playback(Protocol):
    """The state of playback: a `Player`, or a running simulation."""

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        ...

    @property
    def finished(self) -> bool:
        """Whether it is over."""
        ...

    speed: float
    rate: float | None
    """At most so many frames per second; None: every frame."""
    loop: bool
    shown: int
    dropped: int
    """Number of frames shown, and of those dropped because they were late."""
    position: float
    """Time in the clip of the frame shown last [s]."""

    def stamp_at(self, now: float) -> float:
        """Seconds of the clip played when the clock reads `now` [s]; never decreases."""
        ...
