"""The process of a live run; it executes this file, and ends when its pipe is closed.

Standard input first carries two pickles, `sys.path` and (function, arguments). Lines of text
follow. The function reads the lines from a `Line` and answers by messages. A message consists of a
letter, the length (uint32, little-endian) and the content.
"""

from __future__ import annotations

import os
import pickle
import signal
import struct
import sys
import threading
from collections import deque

WAITING = 256
"""Largest number of unread lines (messages of the browser); the oldest lines are discarded."""


class Line:
    """Pipe that connects this process to the server."""

    def __init__(self, answers: int) -> None:
        self._answers = answers
        self._heard: deque[str] = deque(maxlen=WAITING)
        self._any = threading.Event()

    def tell(self, letter: bytes, content: bytes) -> None:
        """Send a message to the server."""
        data = letter + struct.pack("<I", len(content)) + content
        while data:
            data = data[os.write(self._answers, data) :]

    def take_messages(self) -> list[str]:
        """Return the lines (messages of the browser) received since the last call."""
        self._any.clear()
        return [self._heard.popleft() for _ in range(len(self._heard))]

    def wait(self, seconds: float) -> None:
        """Wait up to `seconds` until a line arrives from the server."""
        self._any.wait(seconds)

    def listen(self) -> None:
        """Read lines until the server closes the pipe, then exit."""
        for line in sys.stdin.buffer:
            self._heard.append(line.decode("utf-8", "replace"))
            self._any.set()
        os._exit(0)


def main() -> None:
    """Call the function that the server sends."""
    # Ctrl-C is sent to the whole process group, but only the server should end this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.dup(1)
    os.dup2(2, 1)  # libraries print to standard error instead
    sys.path[:] = pickle.load(sys.stdin.buffer)
    function, arguments = pickle.load(sys.stdin.buffer)
    line = Line(answers)
    threading.Thread(target=line.listen, daemon=True).start()
    function(*arguments, line)


if __name__ == "__main__":
    main()
