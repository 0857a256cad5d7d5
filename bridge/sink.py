"""The protocols of sinks, which frames are written to, and of the playback that they show.

A sink is a context manager with `write(frame)`. A live sink also receives the commands of
`live.command`. A plug-in may inherit from `Sink` or `LiveSink`, whose methods do nothing; the
bridge finds it by an entry point `phy124.sinks`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from phy124.gaussians import Frame

from .topics import Message

if TYPE_CHECKING:
    from typing_extensions import Self

Obey = Callable[[str], "str | None"]
"""Carries out a command; returns why it was refused, or None."""
LONGEST_WAIT = 0.2
"""Longest wait in `listen` [s], so that Ctrl-C and the end are noticed."""


class Sink(Protocol):
    """Takes frames."""

    def __enter__(self) -> Self:
        """Open the sink."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        """Close it."""

    def write(self, frame: Frame) -> None:
        """Take one frame; subscribers see its `time` [s] as the time since the start."""


class Recorder(Sink, Protocol):
    """A sink that also takes messages without a frame."""

    def send(self, message: Message) -> None:
        """Take one message."""


class LiveSink(Sink, Protocol):
    """A sink with viewers, who send commands."""

    monotonic: bool = True
    """Whether time must not decrease; otherwise it jumps at each loop and seek."""

    def listen(self, seconds: float, obey: Obey) -> None:
        """Wait for a command for at most `seconds`, and pass it to `obey`.

        Only this method may run on another thread than `write`.
        """
        del obey
        time.sleep(seconds)

    def show(self, playback: Playback) -> None:
        """Publish the state of playback; called at the start and at each change."""

    def send(self, message: Message) -> None:
        """Publish one message on a topic of the sink's `Controls`."""

    def audience(self) -> str:
        """Describe in one line who receives the frames, and what they need."""
        return ""


class Playback(Protocol):
    """The state of playback: a `Player`, or a running simulation."""

    @property
    def paused(self) -> bool:
        """Whether playback is paused."""
        ...

    @property
    def finished(self) -> bool:
        """Whether playback has ended."""
        ...

    speed: float
    rate: float | None
    """Largest number of frames per second; None: every frame."""
    loop: bool
    shown: int
    dropped: int
    """Number of frames shown, and of late frames that were dropped."""
    position: float
    """Time in the clip of the last frame shown [s]."""

    def stamp_at(self, now: float) -> float:
        """Seconds of the clip played when the clock reads `now` [s]; never decreases."""
        ...
