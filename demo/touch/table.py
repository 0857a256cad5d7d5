"""Permissions for live runs (tickets), and the limits of saved sessions.

The tickets limit the number of live runs per visitor and in total. A ticket counts as a live run
when a page has presented the ticket.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from phy124.errors import InputError
from phy124.scene import Scene

from ..settings import Settings
from ..work import Order
from ..work.order import BYTES_MOVED, BYTES_SHOWN

WAITS = 60.0
"""Time within which a page must present its ticket [s]."""
FULL = "This server cannot run more live runs at the same time."
FPS = 24.0
ROOM, TIME = 0.5, 0.1
"""Limits of a saved live run. The clip and the viewer's file may take at most `ROOM` times a
visitor's disk space. The motion may last at most `TIME` times the time limit of a run.
"""
FORCES = 64
"""Number of forces (such as grabs) and boundaries that any saved session may have."""


@dataclass
class Ticket:
    """The permission of a visitor to start a live run."""

    visitor: str
    order: Order
    name: str = field(default_factory=lambda: secrets.token_urlsafe(18))
    """Name of the ticket, which cannot be guessed."""
    created: float = field(default_factory=time.monotonic)
    taken: bool = False
    """Whether a page has presented this ticket."""
    end: Callable[[], None] = lambda: None
    """Function that ends the run. Any thread may call it."""
    session: dict[str, Any] | None = None
    """The session as a scene; None until it is saved."""

    @property
    def lost(self) -> bool:
        """Whether the permission has expired because no page presented the ticket in time."""
        return not self.taken and time.monotonic() - self.created > WAITS


class Table:
    """All tickets of the server; thread-safe."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._lock = threading.Lock()
        self._tickets: dict[str, Ticket] = {}

    def __len__(self) -> int:
        return len(self._tickets)

    def give(self, visitor: str, order: Order) -> Ticket:
        """Create a ticket for a visitor, and end the visitor's earlier run.

        Raises:
            InputError: There are too many live runs.
        """
        self.leave(visitor)
        with self._lock:
            for name in [n for n, ticket in self._tickets.items() if ticket.lost]:
                del self._tickets[name]
            self._refuse_more()
            ticket = self._tickets[visitor] = Ticket(visitor, order)
        return ticket

    def take(self, visitor: str | None, name: str) -> Ticket | None:
        """Return the ticket that a visitor's page presents, and count it as a live run from now on.

        None if the ticket is unknown or was presented before.

        Raises:
            InputError: The limit of live runs was reached after the ticket was created.
        """
        with self._lock:
            ticket = self._tickets.get(visitor or "")
            if ticket is None or ticket.taken or not secrets.compare_digest(ticket.name, name):
                return None
            self._refuse_more()
            ticket.taken = True
            return ticket

    def _refuse_more(self) -> None:
        taken = sum(ticket.taken for ticket in self._tickets.values())
        if taken >= self.most:
            raise InputError("touch", taken, FULL, "Try again in a few minutes.")

    def ticket_of(self, visitor: str) -> Ticket | None:
        """Return a visitor's ticket."""
        return self._tickets.get(visitor)

    def leave(self, visitor: str) -> None:
        """End the live run of a visitor."""
        with self._lock:
            ticket = self._tickets.pop(visitor, None)
        if ticket is not None:
            ticket.end()

    def over(self, ticket: Ticket) -> None:
        """Stop counting a live run that has ended."""
        with self._lock:
            if self._tickets.get(ticket.visitor) is ticket:
                del self._tickets[ticket.visitor]

    def close(self) -> None:
        """End all live runs."""
        for visitor in list(self._tickets):
            self.leave(visitor)


def limits_of(settings: Settings, gaussians: int) -> Settings:
    """Return the limits for saving a live run of an object with `gaussians` Gaussians."""
    frame = (BYTES_MOVED + BYTES_SHOWN) * max(gaussians, 1)
    room = ROOM * 1e6 * settings.max_visitor_mb / frame
    frames = int(min(room, TIME * FPS * settings.max_seconds))
    most = {"max_frames": max(settings.max_frames, frames)}
    most["max_forces"] = max(settings.max_forces, FORCES)
    return settings.model_copy(update=most)


def shorten_session(scene: Scene, most: Settings) -> Scene:
    """Shorten a session to the limits; remove forces that would begin after the new end."""
    begun = sorted(_start(force) for force in scene.forces)
    spare = most.max_forces - len(scene.boundaries)
    frames = min(scene.time.frames, most.max_frames)
    if len(begun) > spare:
        # The session then ends before the first force that exceeds the limit.
        frames = min(frames, max(round(begun[spare] * scene.time.fps) + 1, 2))
    if frames == scene.time.frames:
        return scene
    end = (frames - 1) / scene.time.fps
    forces = tuple(force for force in scene.forces if _start(force) < end)
    timing = scene.time.model_copy(update={"frames": frames})
    return scene.model_copy(update={"forces": forces, "time": timing})


def _start(force: object) -> float:
    return getattr(force, "start", 0.0)
