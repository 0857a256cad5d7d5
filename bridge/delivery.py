"""Send frames no faster than subscribers acknowledge them; wait until the last frames have arrived.

A writer keeps only the last few frames. A subscriber loses an unacknowledged frame if a newer frame
replaces it or the publisher ends.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable

LONGEST_WAIT = 1.0
"""Longest time that a frame waits before it replaces an unacknowledged frame [s]."""
FAREWELL = 2.0
"""Longest time that a publisher waits at the end for acknowledgements of the last frames [s]."""
STEP = 0.02
"""Longest wait between two updates of the clock and checks for Ctrl-C [s]."""
IN_BUFFERS = 1 << 20
"""Amount of unacknowledged data that is assumed to have arrived [bytes]. A subscriber's default
buffers can store this amount. An acknowledgement may take 100 ms (Cyclone's heartbeat).
"""
log = logging.getLogger(__name__)


def wait_for_topics(acknowledged: Callable[[str, float], bool], topics: Iterable[str]) -> None:
    """Wait for up to `FAREWELL` in total until the last messages of all topics have arrived.

    `acknowledged` waits for the messages of a topic, up to a number of seconds.
    """
    until = time.monotonic() + FAREWELL
    for topic in topics:
        acknowledged(topic, max(until - time.monotonic(), 0.0))


class Delivery:
    """Counts the frames that reliable subscribers have not acknowledged."""

    def __init__(
        self,
        acknowledged: Callable[[float], bool],
        depth: float,
        meanwhile: Callable[[], None],
        *,
        patient: bool = True,
    ) -> None:
        """Prepare to count unacknowledged frames, before the first frame is sent.

        Args:
            acknowledged: Function that waits until all frames are acknowledged or a number of
                seconds has passed. It returns whether all frames are acknowledged, which is true if
                there are no reliable subscribers.
            depth: Number of frames that the writer keeps.
            meanwhile: Function that is called repeatedly while waiting.
            patient: Whether a frame waits before it replaces an unacknowledged frame.
        """
        self.lost = 0
        """Number of frames that at least one subscriber may not have received."""
        self._acknowledged, self._depth, self._meanwhile = acknowledged, depth, meanwhile
        # Numbers of frames, bytes and lost frames since the last time when all frames were
        # acknowledged.
        self._open = self._bytes = self._missed = 0
        self._patient, self._stuck = patient, not patient

    def before_frame(self, size: int) -> None:
        """Wait if the new frame would replace an unacknowledged frame in the writer's history.

        A subscriber that no longer answers delays only one frame. `size` is the frame's size
        [bytes].
        """
        full = self._open >= self._depth and self._bytes + size > IN_BUFFERS
        if self._within(LONGEST_WAIT if full and not self._stuck else 0.0):
            self._open = self._bytes = self._missed = 0
            self._stuck = not self._patient
        elif full:
            self._stuck = True
            self._missed += 1
            self.lost += 1
        self._open += 1
        self._bytes += size

    def farewell(self) -> None:
        """Wait up to `FAREWELL` until the last frames have arrived; log how many are missing."""
        if not self._open or self._within(FAREWELL):
            return
        missing = self._open - self._missed
        self.lost += missing
        log.warning(
            "A subscriber has not acknowledged the last frames for %g "
            "s: it may have missed %d of them.",
            FAREWELL,
            missing,
        )

    def _within(self, seconds: float) -> bool:
        until = time.monotonic() + seconds
        while not self._acknowledged(min(seconds, STEP)):
            if time.monotonic() >= until:
                return False
            self._meanwhile()
        return True
