"""Delivery: sends frames no faster than subscribers acknowledge them, and waits for the last ones.

Writers keep the last few frames. If a frame displaces an older one before every subscriber has
acknowledged it, some subscriber loses that one; the same holds for frames that are not acknowledged
when the publisher ends.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

LONGEST_WAIT = 1.0
"""Longest time a frame waits that would displace an unacknowledged one [s]."""
FAREWELL = 2.0
"""Longest time a publisher that ends waits for subscribers to get the last frames [s]."""
STEP = 0.02
"""Time it waits without interruption [s]; in between, the clock is published and Ctrl-C noticed."""
log = logging.getLogger(__name__)


class Delivery:
    """Counts the frames that reliable subscribers have not acknowledged."""

    def __init__(
        self, acknowledged: Callable[[float], bool], depth: int, meanwhile: Callable[[], None]
    ) -> None:
        """Nothing sent yet.

        Args:
            acknowledged: Waits at most so many seconds and returns whether all is acknowledged;
                true at once if there are no subscribers or they are best effort.
            depth: Number of frames that the writer keeps.
            meanwhile: Called repeatedly during waiting.
        """
        self.lost = 0
        """Number of frames that some subscriber may not have received."""
        self._acknowledged, self._depth, self._meanwhile = acknowledged, depth, meanwhile
        self._open = 0  # frames sent since all were acknowledged
        self._stuck = False

    def before_frame(self) -> None:
        """Wait while a frame would be displaced; a subscriber that hangs delays only one frame."""
        full = self._open >= self._depth
        if self._within(LONGEST_WAIT if full and not self._stuck else 0.0):
            self._open, self._stuck = 0, False
        elif full:
            self._stuck = True
            self.lost += 1
        self._open += 1

    def farewell(self) -> None:
        """Wait until the last frames have arrived, at most `FAREWELL`, and log what has not."""
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
        """Wait at most so many seconds; returns whether all is acknowledged."""
        until = time.monotonic() + seconds
        while not self._acknowledged(min(seconds, STEP)):
            if time.monotonic() >= until:
                return False
            self._meanwhile()
        return True
