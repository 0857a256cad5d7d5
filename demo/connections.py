"""Limit the number of connections, and the time for which slow clients may keep them open."""

from __future__ import annotations

import math
from asyncio import TimerHandle
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import uvicorn
from uvicorn.protocols.http import auto
from uvicorn.protocols.http.h11_impl import H11Protocol

try:
    import resource
except ImportError:  # Windows
    resource = None

HEAD, BODY, STALLED = 20.0, 120.0, 60.0
"""Time limits for receiving the head and the body of a request, and for sending an answer [s]."""
FILES, UNLIMITED = 16_384, 512
"""Limit on open files that the page requests, and assumed limit if the system does not state any.
"""
AT_ONCE = 2048
"""Largest number of connections that are accepted in one batch (uvicorn's default)."""


def allow_connections() -> int:
    """Raise the limit on open files. Return the largest number of connections, which is half of
    this limit.
    """
    if resource is None:
        return UNLIMITED // 2
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    minimum = FILES if most == resource.RLIM_INFINITY else min(FILES, most)
    if now < minimum:
        resource.setrlimit(resource.RLIMIT_NOFILE, (minimum, most))
    return max(now, minimum) // 2


@contextmanager
def limit_connections(most: int) -> Iterator[None]:
    """Limit the number of connections of all servers that are started within this context.

    The protocol class is replaced before Gradio starts uvicorn, so that all connections have a
    deadline. The server accepts new connections in batches. Up to three batches arrive before
    excess connections are closed, so a batch is at most a quarter of the limit.
    """
    usual, batch = (auto.AutoHTTPProtocol, uvicorn.Config), min(AT_ONCE, most // 4)
    auto.AutoHTTPProtocol = partial(Patient, most=most)  # pyright: ignore[reportAttributeAccessIssue]
    uvicorn.Config = partial(uvicorn.Config, backlog=batch)  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        auto.AutoHTTPProtocol, uvicorn.Config = usual


class Patient(H11Protocol):
    """A connection that is closed if its client sends a request or reads an answer too slowly.

    If there are too many connections, the connection with the earliest deadline is closed.
    """

    clock: TimerHandle | None = None
    waiting_for = ""
    stalled: TimerHandle | None = None

    def __init__(self, *arguments: Any, most: int, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.most = most

    def connection_made(self, transport: Any) -> None:
        """Start the timer immediately, so that the connection of a silent client is also closed."""
        super().connection_made(transport)
        self._watch()
        if len(self.connections) > self.most:
            self._make_room()

    def data_received(self, data: bytes) -> None:
        """Process received data, and restart the timer for the next part of the request."""
        super().data_received(data)
        self._watch()

    def pause_writing(self) -> None:
        """Start the timer for a client that does not read the answer."""
        super().pause_writing()
        self.stalled = self.loop.call_later(STALLED, self.transport.abort)

    def resume_writing(self) -> None:
        """Stop the timer, because the client is reading the answer again."""
        self._read()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop all timers of this connection."""
        self._stop()
        self._read()
        super().connection_lost(exc)

    def _read(self) -> None:
        if self.stalled is not None:
            self.stalled.cancel()
            self.stalled = None

    def _watch(self) -> None:
        missing = str(self.conn.their_state)
        # A connection that has become a websocket is handled by another protocol.
        if missing not in ("IDLE", "SEND_BODY") or self.transport.get_protocol() is not self:
            return self._stop()
        if missing != self.waiting_for:
            self._stop()
            self.waiting_for = missing
            seconds = HEAD if missing == "IDLE" else BODY
            self.clock = self.loop.call_later(seconds, self.transport.close)

    def _make_room(self) -> None:
        waiting = [each for each in self.connections if isinstance(each, Patient)]
        slowest = min(waiting, key=lambda each: (_due(each), each is not self), default=self)
        slowest._stop()
        slowest.transport.abort()

    def _stop(self) -> None:
        self.waiting_for = ""
        if self.clock is not None:
            self.clock.cancel()
            self.clock = None


def _due(connection: Patient) -> float:
    """Return the time at which a connection is closed; infinite while a request is processed."""
    clocks = (connection.clock, connection.stalled, connection.timeout_keep_alive_task)
    return min((clock.when() for clock in clocks if clock), default=math.inf)
