"""Handles signals that ask a process to end: Ctrl-C, SIGTERM, or a closed terminal."""

import os
import signal
import threading
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from functools import partial
from types import FrameType

NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
Handler = Callable[[int, FrameType | None], object]


@contextmanager
def handling(handler: Handler, *, always: Collection[str] = ()) -> Iterator[None]:
    """Within this context, signals that end a process call `handler`.

    Outside of the main thread, the context has no effect. Signals that the parent process has set
    to be ignored (nohup) stay ignored, unless they are in `always`. For example, a shell without
    job control makes background processes ignore SIGINT, and `always` can undo this.
    """
    usual = {}
    if threading.current_thread() is threading.main_thread():
        for name in filter(partial(hasattr, signal), NAMES):
            number = getattr(signal, name)
            if name in always or signal.getsignal(number) is not signal.SIG_IGN:
                usual[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, before in usual.items():
            signal.signal(number, before)


@contextmanager
def without_signals(names: Collection[str] = NAMES) -> Iterator[None]:
    """Block signals within this context.

    This thread receives the signals at the end of the context. Processes that are started within
    the context never receive the signals. Terminals and supervisors send such a signal to all
    processes of a command, but only the first process should decide how the command ends. On
    Windows, this context has no effect.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    blocked = {getattr(signal, name) for name in filter(partial(hasattr, signal), names)}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


interrupt: Handler = signal.default_int_handler
"""Handle a signal by raising KeyboardInterrupt."""


def ending(status: int, text: str = "") -> Handler:
    """Return a handler that prints a text and ends the process without flushing files."""

    def end(number: int, frame: FrameType | None) -> None:
        os.write(2, text.encode())
        os._exit(status)

    return end
