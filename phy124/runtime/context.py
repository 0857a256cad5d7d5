"""Run context: where work is computed, who hears of its progress, and what times it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypedDict

from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch

if TYPE_CHECKING:
    from typing_extensions import Unpack


class ContextOptions(TypedDict, total=False):
    """Fields of `RunContext` as keywords, for callers that need only one or two of them."""

    device: str
    threads: int | None
    progress: Progress
    watch: Stopwatch


@dataclass(frozen=True)
class RunContext:
    """Device, threads, progress function and stopwatch of one piece of work.

    Everything here may change without changing the result, except for rounding: the number of
    threads and the device determine the order of sums.
    """

    device: str = "cpu"
    """Warp device, "cpu" or "cuda:0"."""
    threads: int | None = None
    """CPU threads that simulate and draw; None: as many as have a free core and enough work."""
    progress: Progress = silent
    """Called with (stage, steps done, steps in all); may raise Cancelled."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """Records the durations of stages."""

    @classmethod
    def of(cls, context: RunContext | None, **options: Unpack[ContextOptions]) -> RunContext:
        """Return a context, by default a new one, with some fields replaced."""
        return replace(context or cls(), **options)

    @classmethod
    def pop(cls, context: RunContext | None, options: dict[str, Any]) -> RunContext:
        """Like `of`, with fields that are removed from a function's other options."""
        fields = ContextOptions.__annotations__.keys() & options.keys()
        return replace(context or cls(), **{name: options.pop(name) for name in fields})

    def aside(self) -> RunContext:
        """Return the same device and threads for a probe, which neither reports nor is timed."""
        return replace(self, progress=silent, watch=Stopwatch())
