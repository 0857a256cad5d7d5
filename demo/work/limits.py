"""Stop a job when the visitor cancels it or its time is over."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from phy124.errors import Cancelled, InputError
from phy124.simulation import Stopped

from ..course import HOPELESS, SIMULATING, easier
from ..progress import Event
from .order import Order

DEVICE = threading.Lock()
BEAT = 0.2
"""Longest interval between two events of a job [s]. The job's generator can be closed after an
event.
"""


class Limits:
    """Passes events on, and stops a job when it is cancelled or its time is over."""

    def __init__(self, order: Order, put: Callable[[Event], None]) -> None:
        self.order, self.put = order, put
        self.start = time.monotonic()

    def tell(self, event: Event) -> None:
        """Pass an event on to the receiver.

        Raises:
            Cancelled: The job was requested to stop.
            InputError: The job has taken far longer than its time limit.
        """
        if self.order.stop.exists():
            raise Cancelled
        if self.spent > HOPELESS:
            limit = (
                f"The run took far longer than {self.order.seconds:.0f} s, the limit of this page."
            )
            raise InputError("time", "over", limit, easier(self.order.scene))
        self.put(event)

    def tell_simulating(self, event: Event) -> None:
        """Pass on an event of a simulation.

        After the time limit, raise Stopped, so that the frames computed so far are kept.
        """
        self.tell(event)
        if self.spent > SIMULATING:
            raise Stopped(
                f"the time limit of {self.order.seconds:.0f} s was nearly reached, so only the "
                f"frames computed until then were kept. {easier(self.order.scene)}"
            )

    @property
    def spent(self) -> float:
        """Fraction of the time limit that has been used."""
        return (time.monotonic() - self.start) / max(self.order.seconds, 1e-9)


@contextmanager
def hold_device(order: Order) -> Iterator[None]:
    """Hold the lock of the device; raise Cancelled if the job must stop while it waits."""
    while not DEVICE.acquire(timeout=BEAT):
        if order.stop.exists():
            raise Cancelled
    try:
        yield
    finally:
        DEVICE.release()
