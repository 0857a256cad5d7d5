"""Who may touch: a ticket for each live run, one for each visitor, and a total for the server.

A place is taken when a page comes with its ticket; tickets that nobody uses take none.
"""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from phy124.errors import InputError

from ..work import Order

WAITS = 60.0
"""Time in which a page comes with its ticket [s]."""
FULL = "Others are touching their objects now, as many as this server can hold."


def nothing() -> None:
    """Nothing is to be ended yet."""


@dataclass
class Ticket:
    """The right to one live run."""

    visitor: str
    """The visitor's name."""
    order: Order
    name: str = field(default_factory=lambda: secrets.token_urlsafe(18))
    """It cannot be guessed."""
    given: float = field(default_factory=time.monotonic)
    taken: bool = False
    """Whether a page has come with it."""
    end: Callable[[], None] = nothing
    """Ends the run, from any thread."""
    session: dict[str, Any] | None = None
    """What was done, as a scene; None before it was asked for."""

    @property
    def lost(self) -> bool:
        """Whether nobody came in time."""
        return not self.taken and time.monotonic() - self.given > WAITS


class Table:
    """All tickets of a server; thread-safe."""

    def __init__(self, most: int) -> None:
        self.most = most
        """Live runs at the same time."""
        self._lock = threading.Lock()
        self._tickets: dict[str, Ticket] = {}
        """At most one of each visitor."""

    def __len__(self) -> int:
        return len(self._tickets)

    def give(self, visitor: str, order: Order) -> Ticket:
        """A ticket for a visitor, whose earlier run is ended.

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
        """The visitor's own ticket of that name, the first time that it is shown, with its place.

        Raises:
            InputError: Others have taken all places since the ticket was made.
        """
        with self._lock:
            ticket = self._tickets.get(visitor or "")
            if ticket is None or ticket.taken or not secrets.compare_digest(ticket.name, name):
                return None
            self._refuse_more()
            ticket.taken = True
            return ticket

    def _refuse_more(self) -> None:
        """Raise InputError if all places are taken."""
        taken = sum(ticket.taken for ticket in self._tickets.values())
        if taken >= self.most:
            raise InputError("touch", taken, FULL, "Try again in a few minutes.")

    def own(self, visitor: str) -> Ticket | None:
        """The ticket that a visitor has."""
        return self._tickets.get(visitor)

    def leave(self, visitor: str) -> None:
        """End a visitor's run."""
        with self._lock:
            ticket = self._tickets.pop(visitor, None)
        if ticket is not None:
            ticket.end()

    def over(self, ticket: Ticket) -> None:
        """A run has ended; its place is free."""
        with self._lock:
            if self._tickets.get(ticket.visitor) is ticket:
                del self._tickets[ticket.visitor]

    def close(self) -> None:
        """End all runs."""
        for visitor in list(self._tickets):
            self.leave(visitor)
