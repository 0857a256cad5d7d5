"""Listener: answers the other end from a thread of its own, while the main thread computes.

The simulation stays on the main thread, where Ctrl-C reaches it. Warp lets go of the interpreter
while its kernels run, so that is when the listener gets its turns.
"""

from __future__ import annotations

import threading
from types import TracebackType

from .sink import LONGEST_WAIT, LiveSink, Obey


class Listener:
    """Within it `sink` is listened to; what is asked goes to `obey`, on the listener's thread."""

    def __init__(self, sink: LiveSink, obey: Obey) -> None:
        self._sink, self._obey = sink, obey
        self._heard, self._over = threading.Event(), threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._listen, name="listener", daemon=True)

    def __enter__(self) -> Listener:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop listening; raises what ended it before, if nothing else failed."""
        self._over.set()
        self._thread.join()
        if error is None:
            self.check()

    def wait(self, seconds: float) -> None:
        """Wait until somebody has asked for something, at most so many seconds.

        Raises what has ended the listening, such as the KeyboardInterrupt of a sink whose other
        end is gone.
        """
        self._heard.wait(min(seconds, LONGEST_WAIT))
        self._heard.clear()
        self.check()

    def check(self) -> None:
        """Raise what has ended the listening."""
        if self._error is not None:
            raise self._error

    def _listen(self) -> None:
        try:
            while not self._over.is_set():
                self._sink.listen(LONGEST_WAIT, self._asked)
        except BaseException as error:
            # It is raised on the main thread, which may be waiting for somebody to ask.
            self._error = error
            self._heard.set()

    def _asked(self, text: str) -> str | None:
        answer = self._obey(text)
        self._heard.set()
        return answer
