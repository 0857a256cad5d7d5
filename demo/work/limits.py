"""Ends a job when it is asked to stop or its time is up."""

from __future__ import annotations

import time
from collections.abc import Callable

from phy124.errors import Cancelled, InputError
from phy124.scene import Scene
from phy124.simulation import Stopped

from ..events import Event
from .order import Order

SIMULATING, FILMING, HOPELESS = 0.7, 0.85, 3.0
"""Fractions of a run's time: no frame is simulated after the first, no video started after the
second; after the third the run is given up."""
SOFT, FEW = 1e4, 8
"""Stiffness [Pa] and number of frames below which no smaller value is advised."""


class Limits:
    """Ends a job when it is asked to stop or its time is up."""

    def __init__(self, order: Order, put: Callable[[Event], None]) -> None:
        self.order, self.put = order, put
        self.start = time.monotonic()

    def tell(self, event: Event) -> None:
        """Pass an event on.

        Raises:
            Cancelled: The job was asked to stop.
            InputError: It has taken far too long.
        """
        if self.order.stop.exists():
            raise Cancelled
        if self.spent > HOPELESS:
            limit = f"The work took far longer than the {self.order.seconds:.0f} s of one run."
            raise InputError("time", "over", limit, easier(self.order.scene))
        self.put(event)

    def simulated(self, event: Event) -> None:
        """Pass an event on while simulating; raises Stopped when time is up, so frames are kept."""
        self.tell(event)
        if self.spent > SIMULATING:
            raise Stopped(
                f"the {self.order.seconds:.0f} s that one run may take here were nearly over, "
                f"so the frames up to here were kept. {easier(self.order.scene)}"
            )

    @property
    def spent(self) -> float:
        """Fraction of the time that has been used."""
        return (time.monotonic() - self.start) / max(self.order.seconds, 1e-9)


def easier(scene: Scene) -> str:
    """A sentence about what would make a scene faster to compute."""
    ways = [] if scene.accuracy == "draft" else ["draft accuracy"]
    ways += ["a softer material"] if getattr(scene.material, "E", 0) > SOFT else []
    ways += ["fewer frames"] if scene.time.frames > FEW else []
    return f"Choose {' or '.join(ways or ['a gentler motion'])}."
