"""Waits for other threads and processes."""

import time
from collections.abc import Callable

LIMIT = 60.0
"""Longest wait [s], chosen for a machine that runs ten other programs."""


def until(condition: Callable[[], bool]) -> None:
    """Wait until a condition is true."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
