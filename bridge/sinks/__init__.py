"""Where frames go: one file per outlet, each with the same contract.

A sink is a context manager with `write(frame)`. A live sink also listens: `commands(seconds)`
waits at most so long and returns what its users asked for (`play`, `pause`, `restart`,
`seek SECONDS`, `speed FACTOR`).
"""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from phy124.gaussians import Frame

if TYPE_CHECKING:
    from typing_extensions import Self

    from ..player import Player


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

    def commands(self, seconds: float) -> list[str]:
        """Wait until somebody commands something, at most so many seconds."""
        ...

    def show(self, player: Player) -> None:
        """Tell the other end how playback stands."""
        ...
