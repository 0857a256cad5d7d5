"""The context of a run: device, number of threads, progress function and timer."""

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
    """Device, number of threads, progress function and timer of a computation.

    These fields affect results only by rounding errors: device and number of threads determine the
    order in which numbers are added.
    """

    device: str = "cpu"
    """Warp device, "cpu" or "cuda:0"."""
    threads: int | None = None
    """Number of CPU threads that simulate and render; None: one per free core, if useful."""
    progress: Progress = silent
    """Function that is called with (stage, steps done, total steps); it may raise Cancelled."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """Timer that records the durations of the stages."""

    @classmethod
    def of(cls, context: RunContext | None, **options: Unpack[ContextOptions]) -> RunContext:
        """Return a copy of a context (or of the default) with some fields replaced."""
        return replace(context or cls(), **options)

    @classmethod
    def pop(cls, context: RunContext | None, options: dict[str, Any]) -> RunContext:
        """Remove the fields of a context from `options`; return a context with these fields."""
        fields = ContextOptions.__annotations__.keys() & options.keys()
        return replace(context or cls(), **{name: options.pop(name) for name in fields})

    def aside(self) -> RunContext:
        """Return a context for a test run with the same device and threads, without progress."""
        return replace(self, progress=silent, watch=Stopwatch())
