"""Limit the number and size of Gradio's sessions.

Gradio keeps up to 10,000 sessions until the server ends, and any request with a new name starts
one. Gradio stores a description of the page in each session. This description takes 0.3 MB and 0.1
s, and only deep links use it.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from contextvars import ContextVar
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from gradio.state_holder import SessionState, StateHolder
from starlette.requests import HTTPConnection

from .guard import address_of, cookie_of

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

    from .visitors import Visitors

ADDRESS = 64
"""Largest number of sessions per address. Each open page has a session."""
UNCLAIMED = 60.0
"""Time after which a session is removed if its visitor is unknown [s]."""
ASKER: ContextVar[tuple[str | None, str]] = ContextVar("ASKER", default=(None, ""))
"""Cookie and address of the request that is being processed."""


class Asked:
    """Records the visitor and the address of the request that is being processed."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Record the request's visitor and address, and pass the request on."""
        if scope["type"] == "http":
            request = HTTPConnection(scope)
            ASKER.set((cookie_of(request), address_of(request)))
        await self.app(scope, receive, send)


class Session(SessionState):
    """The state of an open page, without Gradio's description of all its components."""

    def __init__(self, blocks: Any) -> None:
        known: Any = SimpleNamespace(default_config=blocks.default_config, blocks={})
        super().__init__(known)
        # A page that has lost its connection comes back; `Sessions.sweep` ends the session.
        self.STATE_TTL_WHEN_CLOSED = math.inf
        config: Any = self.blocks_config
        config.config_for_block = lambda *_: {}


@dataclass
class _Origin:
    visitor: str
    address: str
    used: float


class Sessions(StateHolder):
    """Gradio's sessions of open pages, by name.

    The number of sessions per address is limited. Sessions of known visitors are kept.
    """

    def __init__(self, blocks: Any, visitors: Visitors) -> None:
        super().__init__()
        self.set_blocks(blocks)
        self._visitors = visitors
        self._origins: dict[str, _Origin] = {}

    def __getitem__(self, session_id: str) -> SessionState:
        """Return the session with a name; create it if necessary, and record its use."""
        with self.lock:
            if session_id not in self.session_data:
                cookie, address = ASKER.get()
                self._make_room(address)
                self.session_data[session_id] = Session(self.blocks)
                visitor = cookie or f"session {session_id}"
                self._origins[session_id] = _Origin(visitor, address, 0.0)
            self._origins[session_id].used = time.monotonic()
            return self.session_data[session_id]

    def sweep(self) -> None:
        """Remove the sessions of unknown visitors, except sessions that are new."""
        with self.lock:
            for name, origin in list(self._origins.items()):
                new = time.monotonic() - origin.used < UNCLAIMED
                if not new and not self._visitors.has(origin.visitor):
                    self._remove(name)

    def _make_room(self, address: str) -> None:
        """Remove a session if the address has too many: a session of an absent visitor or, if all
        are present, of the visitor with most sessions.
        """
        origins = {k: origin for k, origin in self._origins.items() if origin.address == address}
        if len(origins) < ADDRESS:
            return
        count = Counter(origin.visitor for origin in origins.values())

        def worth(name: str) -> tuple[bool, int, float]:
            origin = origins[name]
            here = self._visitors.is_here(origin.visitor)
            return here, -count[origin.visitor], origin.used

        self._remove(min(origins, key=worth))

    def _remove(self, name: str) -> None:
        del self.session_data[name], self._origins[name]
