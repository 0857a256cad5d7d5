"""Sink: the contract of everything that frames go to, one file each in `bridge/sinks/`.

A sink is a context manager with `write(frame)`. A live sink also listens: its users send the
commands of `live.command`.
"""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from phy124.gaussians import Frame

from .playback import Playback

if TYPE_CHECKING:
    from typing_extensions import Self


Obey = Callable[[str], "str | None"]
"""Does what a user asked for; returns why not, or None."""
LONGEST_WAIT = 0.2
"""Seconds after which a waiting sink is asked again, so that Ctrl-C and the end are heard."""


class Sink(Protocol):
    """Takes frames one by one."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None: ...

    def write(self, frame: Frame) -> None:
        """Take one frame; its `time` is what subscribers see as time since the start."""
        ...


class LiveSink(Sink, Protocol):
    """A sink with somebody at the other end."""

    monotonic: bool
    """Whether time must only grow; otherwise loops and seeks jump back in it."""

    def listen(self, seconds: float, obey: Obey) -> None:
        """Wait until somebody asks for something, at most so many seconds, and let it be done.

        May run on another thread than `write`; nothing else does.
        """
        ...

    def show(self, playback: Playback) -> None:
        """Tell the other end how playback stands; called at the start and at each change."""
        ...

    def audience(self) -> str:
        """Who hears it, and what they need, in one line."""
        ...
