"""Remarks: what was refused or made smaller, logged now and then, counted, kept for diagnostics."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable

EVERY = 1.0
"""Shortest time between two lines of the log [s]: peers may send thousands of messages."""
log = logging.getLogger(__name__)


class Remarks:
    """Takes sentences."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.count = 0
        """Number of sentences so far."""
        self.last = ""
        """The last of them."""
        self._clock, self._logged = clock, -math.inf

    def add(self, sentence: str) -> None:
        """Keep a sentence."""
        self.count, self.last = self.count + 1, sentence
        now = self._clock()
        if now - self._logged >= EVERY:
            self._logged = now
            log.warning(sentence)
