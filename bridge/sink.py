"""Protocols: a sink receives frames; a playback holds the state that the sinks display.

A sink is a context manager with the method `write(frame)`. A live sink also receives the commands
of `live.command`. A plug-in may inherit from `Sink` or `LiveSink`, whose methods do nothing, and is
registered by an entry point in the group `phy124.sinks`.
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
"""Function that executes a command and returns the reason of a refusal, or None."""
LONGEST_WAIT = 0.2
"""Longest wait in `listen` [s]. Ctrl-C and the end of playback are noticed only after a wait."""


class Sink(Protocol):
    """Receives the frames of a clip or of a running simulation, and sends or records them."""

    def __enter__(self) -> Self:
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
        """Receive a frame; `time` [s] is the frame's time since the start of the clip."""


class Recorder(Sink, Protocol):
    """A sink that also receives messages that do not belong to a frame."""

    def send(self, message: Message) -> None:
        """Receive a message that does not belong to a frame."""


class LiveSink(Sink, Protocol):
    """A sink whose viewers can send commands."""

    monotonic: bool = True
    """Whether time stamps must not decrease; if false, they jump at each loop and seek."""

    def listen(self, seconds: float, obey: Obey) -> bool | None:
        """Wait up to `seconds` for a command, and pass the command to `obey`.

        Only this method may run in another thread than `write`. Return True if a command was read
        and more commands may be waiting.
        """
        del obey
        time.sleep(seconds)

    @property
    def start(self) -> float:
        """Time stamp of the first frame [s since 1970]."""
        return 0.0

    def show(self, playback: Playback) -> None:
        """Publish the state of playback; called at the start and after each change of the state."""

    def send(self, message: Message) -> None:
        """Publish a message on one of the topics in the sink's `Controls`."""

    def audience(self) -> str:
        """Describe in a line who receives the frames, and which settings the receivers need."""
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
    """Largest number of frames per second; None if every frame is shown."""
    loop: bool
    shown: int
    dropped: int
    """Numbers of frames shown, and of frames dropped because they were late."""
    position: float
    """Time in the clip [s] of the last frame shown, or of a frame that was sought."""

    def stamp_at(self, now: float) -> float:
        """Return the seconds of the clip played until `now` [s].

        The value decreases only if a run is reset.
        """
        ...
