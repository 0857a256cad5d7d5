"""The context of a run: the device of a computation, its threads, progress function and
stopwatch.
"""

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

    Other values of these fields change results only by rounding, since the number of threads and
    the device determine the order of sums.
    """

    device: str = "cpu"
    """Warp device, "cpu" or "cuda:0"."""
    threads: int | None = None
    """CPU threads that simulate and render; None: one per free core, but no more than there is work
    for."""
    progress: Progress = silent
    """Function that is called with (stage, steps done, total steps); it may raise Cancelled."""
    watch: Stopwatch = field(default_factory=Stopwatch)
    """Records the durations of stages."""

    @classmethod
    def of(cls, context: RunContext | None, **options: Unpack[ContextOptions]) -> RunContext:
        """Return a copy of the context with other values of the named fields; without a context, a
        new one.
        """
        return replace(context or cls(), **options)

    @classmethod
    def pop(cls, context: RunContext | None, options: dict[str, Any]) -> RunContext:
        """Return the context that `of` would return, and remove its fields from `options`."""
        fields = ContextOptions.__annotations__.keys() & options.keys()
        return replace(context or cls(), **{name: options.pop(name) for name in fields})

    def aside(self) -> RunContext:
        """Return a context for a probe, with the same device and threads, but without progress and
        timing.
        """
        return replace(self, progress=silent, watch=Stopwatch())
