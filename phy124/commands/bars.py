"""Shows the progress on standard error, and lets Ctrl-C end the work safely."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from types import FrameType

from tqdm import tqdm

from phy124.errors import Cancelled, Incomplete
from phy124.runtime.failures import failure
from phy124.runtime.signals import handling, interrupt

_silent: ContextVar[bool] = ContextVar("_silent", default=False)
BETWEEN_LINES = 10.0
"""Interval between progress lines [s] where there is no terminal."""
LEFT = "{l_bar}{bar}| {n_fmt}/{total_fmt}{postfix}"
TITLES = {"compile": "compile kernels, once"}


@contextmanager
def silence() -> Iterator[None]:
    """Draw no progress bars within this context (`--quiet`)."""
    token = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(token)


class Bars:
    """A `Progress` that shows the current stage; use it as a context manager.

    Ctrl-C ends the work at the next report of progress, because stopping inside a kernel could
    crash the process. A second Ctrl-C interrupts the work immediately. If `keeps` is true, a
    message says that the results so far are saved; the caller must save them. `left` predicts the
    remaining time [s].
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        keeps: bool = False,
        left: Callable[[], float | None] | None = None,
    ) -> None:
        self.quiet, self.keeps, self.left = quiet or _silent.get(), keeps, left
        self.bar: tqdm | None = None
        self.interrupted = False
        self.cancelled = False
        """Whether Ctrl-C has ended all or part of the work."""
        self.ended: Exception | None = None
        """The exception that ended the work early, including Ctrl-C."""
        self._stage, self._next_line = "", 0.0
        self._lines: dict[str, str] = {}
        self._signals = handling(self._remember)

    def __enter__(self) -> Bars:
        self._signals.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._signals.__exit__(None, None, None)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show the progress of a stage; raise Cancelled after Ctrl-C."""
        if self.interrupted:
            self.interrupted, self.cancelled = False, True
            self.close()
            if self.keeps:
                self._say("interrupted: results so far will be kept; Ctrl-C again quits at once")
            self.ended = Cancelled()
            raise self.ended
        if self.quiet:
            return
        stage = TITLES.get(stage, stage)
        if sys.stderr.isatty():
            self._draw(stage, done, total)
        else:
            self._report(stage, done, total)

    def close(self) -> None:
        """Remove the progress bar from the terminal."""
        if self.bar is not None:
            self.bar.close()
            self.bar = None

    @contextmanager
    def keeping(self) -> Iterator[None]:
        """Store an error or Ctrl-C that ends this context; `status` then reports it."""
        try:
            yield
        except Exception as problem:
            self.ended = problem

    def status(self, kept: str) -> int:
        """Print why a command ended early and which results were kept; return the exit status."""
        if self.ended is None:
            return 0
        incomplete = Incomplete(kept)
        incomplete.__cause__ = self.ended
        why = failure(incomplete)
        self._say(f"phy124: {why}")
        return why.status

    def _draw(self, stage: str, done: int, total: int) -> None:
        if self.bar is None or self.bar.desc.removesuffix(": ") != stage:
            self.close()
            self.bar = tqdm(
                desc=stage,
                total=total,
                file=sys.stderr,
                leave=False,
                mininterval=0.2,
                bar_format=None if self.left is None else LEFT,
            )
        self.bar.total = total
        self.bar.set_postfix_str(self._left(), refresh=False)
        self.bar.update(done - self.bar.n)

    def _report(self, stage: str, done: int, total: int) -> None:
        now, line = time.monotonic(), f"{stage}: {done} of {total}{self._left()}"
        due = stage != self._stage or done == total or now >= self._next_line
        if due and line != self._lines.get(stage):
            self._stage, self._next_line = stage, now + BETWEEN_LINES
            self._lines[stage] = line
            self._say(line)

    def _left(self) -> str:
        seconds = self.left() if self.left is not None else None
        if not seconds:
            return ""
        from phy124.budget.limits import duration

        return f", about {duration(round(seconds))} left"

    def _say(self, line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    def _remember(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            interrupt(number, frame)
        self.interrupted = True
