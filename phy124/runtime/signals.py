"""Signals that ask a process to end: Ctrl-C, a supervisor's SIGTERM, a closed terminal."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
Handler = Callable[[int, FrameType | None], object]


@contextmanager
def handling(handler: Handler) -> Iterator[None]:
    """Within this context these signals call `handler`; outside the main thread nothing changes.

    Signals that the parent process has set to be ignored (nohup) stay ignored.
    """
    usual = {}
    if threading.current_thread() is threading.main_thread():
        numbers = [getattr(signal, name) for name in NAMES if hasattr(signal, name)]
        for number in (n for n in numbers if signal.getsignal(n) is not signal.SIG_IGN):
            usual[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, before in usual.items():
            signal.signal(number, before)


interrupt: Handler = signal.default_int_handler
"""Raises KeyboardInterrupt."""


def ending(status: int, text: str = "") -> Handler:
    """Return a handler that prints a text and ends the process at once, without flushing files."""

    def end(number: int, frame: FrameType | None) -> None:
        del number, frame
        os.write(2, text.encode())
        os._exit(status)

    return end
