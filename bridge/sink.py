"""Protocols: a sink receives frames, and a playback has a state that sinks show.

A sink is a context manager with `write(frame)`. A live sink also receives the commands of
`live.command`. A plug-in may inherit from `Sink` or `LiveSink`, whose methods do nothing; it is
registered by an entry point `phy124.sinks`.
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
"""Carries out a command; returns the reason of a refusal, or None."""
LONGEST_WAIT = 0.2
"""Longest wait in `listen` [s]; Ctrl-C and the end of playback are noticed after it."""


class Sink(Protocol):
    """Receives frames."""

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
        """Close the sink."""

    def write(self, frame: Frame) -> None:
        """Receive a frame; its `time` [s] is sent as the time since the start."""


class Recorder(Sink, Protocol):
    """A sink that also receives messages without a frame."""

    def send(self, message: Message) -> None:
        """Receive a message."""


class LiveSink(Sink, Protocol):
    """A sink with viewers who send commands."""

    monotonic: bool = True
    """True if time must not decrease; otherwise time jumps at each loop and seek."""

    def listen(self, seconds: float, obey: Obey) -> bool | None:
        """Wait for a command for up to `seconds`, and pass it to `obey`.

        This method may run in another thread than `write`; the other methods may not. Returns True
        if a command was read and more may be waiting.
        """
        del obey
        time.sleep(seconds)

    @property
    def start(self) -> float:
        """Time stamp of the first frame [s since 1970]."""
        return 0.0

    def show(self, playback: Playback) -> None:
        """Publish the state of playback; called at the start and at each change."""

    def send(self, message: Message) -> None:
        """Publish a message on a topic of the sink's `Controls`."""

    def audience(self) -> str:
        """Describe in a line who receives the frames, and the settings that receivers need."""
        return ""


class Playback(Protocol):
    """State of playback of a `Player` or a running simulation."""

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
        """Return the seconds of the clip played when the clock reads `now` [s]; never decreases."""
        ...
