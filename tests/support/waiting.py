"""Waiting for what other threads and processes do."""

import time
from collections.abc import Callable

LIMIT = 60.0
"""Longest wait, s: for a machine that does ten other things, too."""


def until(condition: Callable[[], bool]) -> None:
    """Wait for something to become true."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
