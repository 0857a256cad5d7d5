"""Turns: requests that compute are answered a few at a time, and fewer of one address.

What a request may ask for is bounded, but it may still cost tenths of a second; thirty at once
would leave nothing for anybody else.
"""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import anyio
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse

from .identity import address_of

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

COMPUTES = re.compile(r"/gradio_api/(?:run|api|call|queue|upload)\b")
"""Addresses of requests that may cost more than 0.2 s of a core, if they are posted to."""
TOGETHER, EACH = 4, 2
"""Requests that are answered at the same time, and those of one address among them."""
PRESENT = 64
"""Requests of one address that are answered or wait; more are refused."""
LONGEST = 60.0
"""Longest time for which one waits [s]."""
TOO_MANY = "Too many requests of your address are waiting here. Try again in a minute."


@dataclass
class _Address:
    """The requests of one address."""

    present: int = 0
    turns: anyio.Semaphore = field(default_factory=lambda: anyio.Semaphore(EACH))


class Turns:
    """Has requests that compute wait for their turn; those of one address wait for each other."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._turns = anyio.Semaphore(TOGETHER)
        self._addresses: dict[str, _Address] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when its turn has come, or answer 429."""
        posted = scope["type"] == "http" and scope["method"] == "POST"
        if not posted or not COMPUTES.match(scope["path"]):
            return await self.app(scope, receive, send)
        async with self._turn(address_of(HTTPConnection(scope))) as has_come:
            answer = (
                self.app if has_come else PlainTextResponse(TOO_MANY, 429, {"connection": "close"})
            )
            await answer(scope, receive, send)

    @asynccontextmanager
    async def _turn(self, name: str) -> AsyncIterator[bool]:
        """Wait for a turn of an address; yields whether it has come."""
        address = self._addresses.setdefault(name, _Address())
        if address.present >= PRESENT:
            yield False
            return
        address.present += 1
        try:
            async with AsyncExitStack() as taken:
                with anyio.move_on_after(LONGEST) as waiting:
                    await taken.enter_async_context(address.turns)
                    await taken.enter_async_context(self._turns)
                yield not waiting.cancelled_caught
        finally:
            address.present -= 1
            if not address.present:
                del self._addresses[name]
