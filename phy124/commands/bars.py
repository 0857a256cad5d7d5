"""Progress bars on standard error, one per stage, and a safe Ctrl-C."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType

from tqdm import tqdm

from phy124.errors import Cancelled


class Bars:
    """A `Progress` that draws a bar for the stage in hand; use as a context manager.

    Inside, Ctrl-C is remembered and ends the work at the next report of progress, never in the
    middle of a kernel, where it could take the process down. A second Ctrl-C acts at once.
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.quiet = quiet
        self.bar: tqdm | None = None
        self.interrupted = False

    def __enter__(self) -> Bars:
        if threading.current_thread() is threading.main_thread():
            self._usual = signal.signal(signal.SIGINT, self._remember)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, self._usual)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show how far a stage is; raises Cancelled after Ctrl-C."""
        if self.interrupted:
            raise Cancelled
        if self.quiet:
            return
        if self.bar is None or self.bar.desc.removesuffix(": ") != stage:
            self.close()
            self.bar = tqdm(desc=stage, total=total, file=sys.stderr, leave=False, mininterval=0.2)
        self.bar.total = total
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        """Remove the bar."""
        if self.bar is not None:
            self.bar.close()
            self.bar = None

    def _remember(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.interrupted = True
        signal.signal(signal.SIGINT, self._usual)
