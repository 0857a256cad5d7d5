"""The device, which one piece of work at a time has."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from phy124.errors import Cancelled

from .order import Order

DEVICE = threading.Lock()
"""Held by whoever computes: one piece of work at a time in this process."""
BEAT = 0.2
"""Longest silence between two events, s: so often can a generator be closed."""


@contextmanager
def held(order: Order) -> Iterator[None]:
    """Hold the device; gives up if the work is to stop before its turn has come."""
    while not DEVICE.acquire(timeout=BEAT):
        if order.stop.exists():
            raise Cancelled
    try:
        yield
    finally:
        DEVICE.release()
