"""Sink: what frames are written to; each kind has its own file in `bridge/sinks/`.

A sink is a context manager with `write(frame)`. A live sink also listens: those who watch it send
the commands of `live.command`. A sink of your own may inherit from `Sink` or `LiveSink`, whose
methods do nothing; the bridge finds it by an entry point `phy124.sinks`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from phy124.gaussians import Frame

from .playback import Playback
from .topics import Message

if TYPE_CHECKING:
    from typing_extensions import Self


Obey = Callable[[str], "str | None"]
"""Carries out a command; returns why it was refused, or None."""
LONGEST_WAIT = 0.2
"""Longest time [s] that `listen` is asked to wait, so that Ctrl-C and the end are noticed."""


class Sink(Protocol):
    """Takes frames one by one."""

    def __enter__(self) -> Self:
        """Open what frames are written to."""
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
    """A sink that also takes messages that belong to no frame."""

    def send(self, message: Message) -> None:
        """Take one message."""


class LiveSink(Sink, Protocol):
    """A sink that somebody watches."""

    monotonic: bool = True
    """Whether time must only grow; otherwise it jumps back at each loop and seek."""

    def listen(self, seconds: float, obey: Obey) -> None:
        """Wait for a command, at most so many seconds, and pass it to `obey`.

        May run on another thread than `write`; nothing else does.
        """
        del obey
        time.sleep(seconds)

    def show(self, playback: Playback) -> None:
        """Publish the state of playback; called at the start and at each change."""

    def send(self, message: Message) -> None:
        """Publish one message on a topic of the sink's `Controls`."""

    def audience(self) -> str:
        """One line: who receives the frames, and what they need."""
        return ""
