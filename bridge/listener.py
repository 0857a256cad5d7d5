"""Listener: listens to a sink in a thread of its own while the main thread computes.

The simulation stays on the main thread, where Ctrl-C reaches it. Warp releases Python's global lock
while its kernels run, so the listener can run then.
"""

from __future__ import annotations

import threading
from types import TracebackType

from .sink import LONGEST_WAIT, LiveSink, Obey


class Listener:
    """Within its context `sink` is listened to; `obey` gets commands, on the listener's thread."""

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
        """Stop listening; raises the error that ended it before, if nothing else failed."""
        self._over.set()
        self._thread.join()
        if error is None:
            self.check()

    def wait(self, seconds: float) -> None:
        """Wait until a command has come, at most so many seconds.

        Raises the error that has ended the listening, such as the KeyboardInterrupt of a sink whose
        other end has gone.
        """
        self._heard.wait(min(seconds, LONGEST_WAIT))
        self._heard.clear()
        self.check()

    def check(self) -> None:
        """Raise the error that has ended the listening, if any."""
        if self._error is not None:
            raise self._error

    def _listen(self) -> None:
        try:
            while not self._over.is_set():
                self._sink.listen(LONGEST_WAIT, self._asked)
        except BaseException as error:
            # It is raised on the main thread, which may be waiting for a command.
            self._error = error
            self._heard.set()

    def _asked(self, text: str) -> str | None:
        answer = self._obey(text)
        self._heard.set()
        return answer
