"""Playback: how a show stands, as sinks and reports see it."""

from __future__ import annotations

from typing import Protocol


class Playback(Protocol):
    """How a show stands: a `Player`, or a simulation that is running."""

    paused: bool
    finished: bool
    speed: float
    rate: float | None
    """At most so many frames per second; None: every frame."""
    loop: bool
    shown: int
    dropped: int
    """Frames shown, and dropped because they were late."""
    position: float
    """Clip time of the frame shown last, s."""

    def stamp_at(self, now: float) -> float:
        """Clip seconds played at a reading of the clock; only grows."""
        ...
