"""The device, which one job at a time may use."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from phy124.errors import Cancelled

from .order import Order

DEVICE = threading.Lock()
"""Held by the job that computes; one at a time in this process."""
BEAT = 0.2
"""Longest time between two events [s], at which a generator can be closed."""


@contextmanager
def held(order: Order) -> Iterator[None]:
    """Hold the device; gives up if the job is to stop before its turn comes."""
    while not DEVICE.acquire(timeout=BEAT):
        if order.stop.exists():
            raise Cancelled
    try:
        yield
    finally:
        DEVICE.release()
