"""Delivery: frames leave no faster than subscribers acknowledge them, and the last are waited for.

Writers keep the last few frames. A frame that pushes an older one out before every subscriber has
acknowledged it is lost for somebody; so is what is still open when the publisher ends.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

LONGEST_WAIT = 1.0
"""Seconds a frame waits that would push out one somebody has not acknowledged."""
FAREWELL = 2.0
"""Seconds a leaving publisher waits for subscribers to get the last frames."""
STEP = 0.02
"""Seconds it waits at a stretch; in between the clock ticks on, and Ctrl-C is heard."""
log = logging.getLogger(__name__)


class Delivery:
    """Counts what reliable subscribers have not acknowledged."""

    def __init__(
        self, acknowledged: Callable[[float], bool], depth: int, meanwhile: Callable[[], None]
    ) -> None:
        """Nothing sent yet.

        Args:
            acknowledged: Waits at most so many seconds; whether all is acknowledged. At once true
                without subscribers or where they are best effort.
            depth: How many of the last frames the writer keeps.
            meanwhile: Called again and again while it waits.
        """
        self.lost = 0
        """Frames that somebody may not have got."""
        self._acknowledged, self._depth, self._meanwhile = acknowledged, depth, meanwhile
        self._open = 0  # frames sent since all were acknowledged
        self._stuck = False

    def before_frame(self) -> None:
        """Wait while a frame would be pushed out; a subscriber that hangs holds up one only."""
        full = self._open >= self._depth
        if self._within(LONGEST_WAIT if full and not self._stuck else 0.0):
            self._open, self._stuck = 0, False
        elif full:
            self._stuck = True
            self.lost += 1
        self._open += 1

    def farewell(self) -> None:
        """Wait until the last frames have arrived, but not for ever, and say what has not."""
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
        """Whether all is acknowledged after so many seconds at most."""
        until = time.monotonic() + seconds
        while not self._acknowledged(min(seconds, STEP)):
            if time.monotonic() >= until:
                return False
            self._meanwhile()
        return True
