"""Defines the context of a run: its device, threads, progress function and stopwatch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypedDict

from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch

if TYPE_CHECKING:
    from typing_extensions import Unpack


class ContextOptions(TypedDict, total=False):
    """Fields of `RunContext` as keyword arguments, for callers that set only some of them."""

    device: str
    threads: int | None
    progress: Progress
    watch: Stopwatch


@dataclass(frozen=True)
class RunContext:
    """Device, threads, progress function and stopwatch of a computation.

    These fields change results only by rounding errors, because the device and the number of
    threads determine the order in which numbers are added.
    """

    device: str = "cpu"
    """Warp device, "cpu" or "cuda:0"."""
    threads: int | None = None
    """Number of CPU threads that simulate and render. None means one per free core, but no more
    threads than the work can use.
    """
    progress: Progress = silent
    """Function that is called with (stage, steps done, total steps); it may raise Cancelled."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """Stopwatch that records the durations of the stages."""

    @classmethod
    def of(cls, context: RunContext | None, **options: Unpack[ContextOptions]) -> RunContext:
        """Return a copy of the context in which the named fields are replaced; if there is no
        context, create a new one.
        """
        return replace(context or cls(), **options)

    @classmethod
    def pop(cls, context: RunContext | None, options: dict[str, Any]) -> RunContext:
        """Take the fields of a context out of `options`, and return the context that `of` makes
        from them.
        """
        fields = ContextOptions.__annotations__.keys() & options.keys()
        return replace(context or cls(), **{name: options.pop(name) for name in fields})

    def aside(self) -> RunContext:
        """Return a context for a probe: device and threads are unchanged, but progress and
        durations are not recorded.
        """
        return replace(self, progress=silent, watch=Stopwatch())
