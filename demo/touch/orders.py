"""What a browser may say to its live run: known words, small, and not too many of them."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

WORDS = ("grab", "to", "release", "gravity", "soften", "speed", "pause", "reset", "save", "seen")
"""Values of the field `do`."""
PER_SECOND, AT_ONCE = 150.0, 300.0
"""Messages per second, and how many may come at once. A pointer sends as many as the screen shows
pictures."""
LARGEST = 1024
"""Length of a message [bytes]."""
NOT_UNDERSTOOD = "The page sent something that is not understood here. Load it again."
TOO_MANY = "The page sent more messages than are taken here; some were left out."


class Refused(Exception):
    """A message is not taken."""

    def __init__(self, said: str = "") -> None:
        super().__init__(said)
        self.said = said
        """A sentence, unless it was said already."""


class Budget:
    """How many messages may still come: a bucket that is filled as time goes on."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left, self._at, self._warned = AT_ONCE, clock(), False

    def spend(self) -> None:
        """Take one message.

        Raises:
            Refused: There were too many.
        """
        now = self._clock()
        self._left = min(AT_ONCE, self._left + PER_SECOND * (now - self._at))
        self._at = now
        if self._left < 1:
            said, self._warned = "" if self._warned else TOO_MANY, True
            raise Refused(said)
        self._left -= 1


def understood(text: str, budget: Budget) -> dict[str, Any]:
    """A message as plain data.

    Args:
        text: As it was sent.
        budget: How many more may come.

    Raises:
        Refused: It is too long, no message, or one too many.
    """
    budget.spend()
    if len(text) > LARGEST:
        raise Refused(NOT_UNDERSTOOD)
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise Refused(NOT_UNDERSTOOD) from None
    if not isinstance(message, dict) or message.get("do") not in WORDS:
        raise Refused(NOT_UNDERSTOOD)
    return message
