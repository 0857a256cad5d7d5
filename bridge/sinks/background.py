"""Background: runs another sink in a separate thread, so that recording never delays playback.

Frames wait in a short queue. While the queue is full, playback continues, and new frames are
counted and reported instead of recorded.
"""

from __future__ import annotations

import logging
import queue
import threading
from contextlib import suppress
from types import TracebackType

from phy124.gaussians import Frame
from phy124.runtime.failures import failure

from ..sink import Recorder
from ..topics import Message

log = logging.getLogger(__name__)


class Background:
    """Writes to `sink` in a thread; `write` returns immediately."""

    def __init__(self, sink: Recorder, *, depth: int = 16) -> None:
        """Prepare the thread; up to `depth` frames and messages may wait in the queue."""
        self.sink = sink
        self.dropped = 0
        """Number of frames that were not recorded because the sink was too slow or had failed."""
        self._queue: queue.Queue[Frame | Message | None] = queue.Queue(depth)
        self._thread = threading.Thread(target=self._work, name="recording", daemon=True)
        self._error: Exception | None = None

    def __enter__(self) -> Background:
        self.sink.__enter__()
        self._thread.start()
        return self

    def write(self, frame: Frame) -> None:
        """Append a frame to the queue without waiting."""
        try:
            self._queue.put_nowait(frame)
        except queue.Full:
            self._drop()

    def send(self, message: Message) -> None:
        """Append a message to the queue without waiting; discard it if the queue is full."""
        with suppress(queue.Full):
            self._queue.put_nowait(message)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait until everything is written; raise the sink's error if nothing else failed."""
        self._queue.put(None)
        self._thread.join()
        failed = error or self._error
        self.sink.__exit__(kind or (type(failed) if failed else None), failed, trace)
        if self.dropped:
            log.warning("The recording lacks %d frames: the disk was too slow.", self.dropped)
        if self._error is not None and error is None:
            raise self._error

    def _work(self) -> None:
        while (what := self._queue.get()) is not None:
            if self._error is not None:
                self.dropped += isinstance(what, Frame)
                continue
            try:
                if isinstance(what, Message):
                    self.sink.send(what)
                else:
                    self.sink.write(what)
            except Exception as error:
                # The error is raised later, when the sink is closed, because playback must not
                # stop.
                log.error("Recording failed, playback goes on. %s", failure(error).sentence)
                self._error = error

    def _drop(self) -> None:
        if not self.dropped:
            log.warning("The disk is too slow: frames are missing from the recording.")
        self.dropped += 1
