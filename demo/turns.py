"""Turns: requests that compute are answered a few at a time, and fewer of one address.

What a request may ask for is bounded, but it may still cost tenths of a second; thirty at once
would leave nothing for anybody else.
"""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import anyio
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse

from .identity import address_of

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

COMPUTES = re.compile(r"/gradio_api/(?:run|api|call|queue)\b")
"""Addresses of requests that may cost more than 0.2 s of a core, if they are posted to."""
TOGETHER, EACH = 4, 2
"""Such requests that are answered at the same time, and those of one address among them."""
UPLOADS = re.compile(r"/gradio_api/upload\b")
"""Addresses of requests that lie on the disk until they are complete, however slowly they come."""
RECEIVED, RECEIVED_EACH = 64, 8
"""The same numbers of uploads."""
PRESENT = 64
"""Requests of one address that are answered or wait; more are refused."""
LONGEST = 60.0
"""Longest time for which one waits [s]."""
TOO_MANY = "Too many requests of your address are waiting here. Try again in a minute."


@dataclass
class _Address:
    """The requests of one address."""

    turns: anyio.Semaphore
    present: int = 0


class Turns:
    """Has requests wait for their turn; those of one address wait for each other as well."""

    def __init__(
        self, app: ASGIApp, at: re.Pattern[str] = COMPUTES, together: int = TOGETHER,
        each: int = EACH,
    ) -> None:  # fmt: skip
        """Stand in front of an application.

        Args:
            app: The application.
            at: Addresses of the requests; others are passed on at once.
            together: Number of requests that are passed on at the same time.
            each: Number of those of one address.
        """
        self.app, self.at, self.each = app, at, each
        self._turns = anyio.Semaphore(together)
        self._addresses: dict[str, _Address] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when its turn has come, or answer 429."""
        posted = scope["type"] == "http" and scope["method"] == "POST"
        if not posted or not self.at.match(scope["path"]):
            return await self.app(scope, receive, send)
        async with self._turn(address_of(HTTPConnection(scope))) as has_come:
            answer = (
                self.app if has_come else PlainTextResponse(TOO_MANY, 429, {"connection": "close"})
            )
            await answer(scope, receive, send)

    @asynccontextmanager
    async def _turn(self, name: str) -> AsyncIterator[bool]:
        """Wait for a turn of an address; yields whether it has come."""
        address = self._addresses.setdefault(name, _Address(anyio.Semaphore(self.each)))
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
