"""Runs native third-party code on a user's data in a separate process that can be killed.

An endless C++ loop cannot be interrupted from Python, neither by Ctrl-C nor by a thread. The
process is started from a file of this package instead of by `multiprocessing`. A user's script
therefore needs no `if __name__ == "__main__"`, and `run` works from any thread and on every
platform.
"""

import os
import pickle
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, TypeVar

from phy124.runtime.signals import without_signals

T = TypeVar("T")
CHILD = Path(__file__).with_name("child.py")
BEAT = 0.1
"""Interval between two checks of the clock and of cancellation, s."""
NO_WINDOW: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)


class Deadline(NamedTuple):
    """Time limit of isolated code, and a function that may cancel the code."""

    seconds: float = 120.0
    beat: Callable[[], object] = lambda: None
    """Function that is called ten times a second; if the function raises an exception, the process
    is killed.
    """


PATIENT = Deadline()
"""Default deadline; a segmentation takes half a second on an idle machine."""


class Unfinished(Exception):
    """Raised if the process took too long or crashed; the message is the end of a sentence."""


class RemoteTraceback(Exception):
    """Traceback of an exception that was raised in the other process."""

    def __str__(self) -> str:
        return "\n" + self.args[0]


def run(
    function: Callable[..., T],
    *arguments: Any,
    deadline: Deadline = PATIENT,
    memory: int | None = None,
) -> T:
    """Call a module's function in another process, and return its result.

    The function's exception is raised in this process. Arguments and result must be picklable.

    Args:
        function: The function.
        deadline: Time limit and cancellation.
        memory: Memory limit of the process [bytes], on systems that support limits; above the
            limit, the function gets a MemoryError.
        arguments: The function's arguments.

    Raises:
        Unfinished: The time limit was exceeded, or the process crashed.
    """
    if getattr(sys, "frozen", False) or not sys.executable:
        # Without a separate Python interpreter, the program would start itself.
        return function(*arguments)
    order = pickle.dumps((memory, sys.path)) + pickle.dumps((function, arguments))
    with _log() as log:
        with without_signals():
            child = subprocess.Popen(
                [sys.executable, CHILD],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                creationflags=NO_WINDOW,
            )
        try:
            answer = _answer(child, order, deadline)
            if child.wait():
                # The output of a crashed process may be truncated.
                log.seek(0)
                raise Unfinished(_breakdown(child.returncode, log))
        finally:
            child.kill()
            child.wait()
    value, error, where = pickle.loads(answer)
    if error is not None:
        raise error from RemoteTraceback(where)
    return value


def _answer(child: subprocess.Popen[bytes], order: bytes, deadline: Deadline) -> bytes:
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_talk, args=(child, order, answers), daemon=True).start()
    end = time.monotonic() + deadline.seconds
    while True:
        try:
            return answers.get(timeout=BEAT)
        except queue.Empty:
            deadline.beat()
        if time.monotonic() > end:
            raise Unfinished(f"did not finish within {deadline.seconds:g} s")


def _talk(child: subprocess.Popen[bytes], order: bytes, answers: queue.SimpleQueue[bytes]) -> None:
    """Send the request and read the answer in separate threads, because both may block."""
    assert child.stdin is not None and child.stdout is not None
    answer = b""
    with suppress(OSError), child.stdin as orders, child.stdout as output:
        orders.write(order)
        orders.flush()
        # The pipe stays open until the child has ended: closing it would end the child.
        answer = output.read()
        child.wait()
    answers.put(answer)


def _log() -> IO[bytes]:
    """Open a file for the process's error output; os.devnull if none can be created."""
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return open(os.devnull, "r+b")


def _breakdown(status: int, log: IO[bytes]) -> str:
    lines = log.read().decode(errors="replace").strip().splitlines()
    last = f": {lines[-1][:200]}" if lines else ""
    return f"broke down (exit status {status}{last})"
