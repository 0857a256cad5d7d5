"""Sends frames no faster than subscribers acknowledge them, and waits for the last ones.

Writers keep the last few frames. A subscriber loses a frame that is displaced by a newer one before
it has acknowledged it, or that it has not acknowledged when the publisher ends.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

LONGEST_WAIT = 1.0
"""Longest time that a frame waits before it displaces an unacknowledged one [s]."""
FAREWELL = 2.0
"""Longest time that an ending publisher waits for acknowledgements of the last frames [s]."""
STEP = 0.02
"""Longest uninterrupted wait [s], so that the clock is published and Ctrl-C noticed."""
log = logging.getLogger(__name__)


class Delivery:
    """Counts the frames that reliable subscribers have not acknowledged."""

    def __init__(
        self, acknowledged: Callable[[float], bool], depth: int, meanwhile: Callable[[], None]
    ) -> None:
        """Start with nothing sent.

        Args:
            acknowledged: Waits for at most the seconds in its argument; returns whether all frames
                are acknowledged, which they are without reliable subscribers.
            depth: Number of frames that the writer keeps.
            meanwhile: Called repeatedly while waiting.
        """
        self.lost = 0
        """Number of frames that some subscriber may not have received."""
        self._acknowledged, self._depth, self._meanwhile = acknowledged, depth, meanwhile
        self._open = 0  # frames sent since all were acknowledged
        self._stuck = False

    def before_frame(self) -> None:
        """Wait while a frame would be displaced; a hanging subscriber delays only one frame."""
        full = self._open >= self._depth
        if self._within(LONGEST_WAIT if full and not self._stuck else 0.0):
            self._open, self._stuck = 0, False
        elif full:
            self._stuck = True
            self.lost += 1
        self._open += 1

    def farewell(self) -> None:
        """Wait for at most `FAREWELL` until the last frames have arrived; log missing ones."""
        if not self._open or self._within(FAREWELL):
            return
        missing = min(self._open, self._depth)
        self.lost += missing
        log.warning(
            "A subscriber has not acknowledged the last frames in %g s: it may lack %d of them.",
            FAREWELL,
            missing,
        )

    def _within(self, seconds: float) -> bool:
        """Wait for at most `seconds`; returns whether all frames are acknowledged."""
        until = time.monotonic() + seconds
        while not self._acknowledged(min(seconds, STEP)):
            if time.monotonic() >= until:
                return False
            self._meanwhile()
        return True
