"""Streams: answers that stay open, by which a page is told what happens; their number and life."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse

from .identity import address_of, cookie_of

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

STREAMED = re.compile(r"/gradio_api/(?:heartbeat|queue/data|call|upload_progress)\b")
"""Addresses that are answered by streams."""
EACH, ADDRESS = 16, 64
"""Streams of one cookie and of one address; a page has one or two."""
LIFE = 7200.0
"""Time after which a stream ends unless its page gives signs of life [s]; it may come again."""
TOO_MANY = "Too many streams are open here. Close some pages."


class Streams:
    """Bounds the streams of each cookie, of each address and of all, and their life."""

    def __init__(self, app: ASGIApp, most: int, here: Callable[[str | None], bool]) -> None:
        """Stand in front of an application.

        Args:
            app: The application.
            most: Number of streams of all.
            here: Whether the page of a visitor is open.
        """
        self.app, self.most, self.here = app, most, here
        self._open: list[_Stream] = []
        """The oldest first."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; of too many streams of a cookie the oldest ends, others get 429."""
        asked = scope["type"] == "http" and scope["method"] == "GET"
        if not asked or not STREAMED.match(scope["path"]):
            return await self.app(scope, receive, send)
        stream = _Stream(HTTPConnection(scope), send)
        of_address = [one for one in self._open if one.address == stream.address]
        if len(of_address) >= ADDRESS or len(self._open) >= self.most:
            return await PlainTextResponse(TOO_MANY, 429, {"connection": "close"})(
                scope, receive, send
            )
        of_cookie = [one for one in of_address if stream.cookie and one.cookie == stream.cookie]
        for one in of_cookie[: max(len(of_cookie) + 1 - EACH, 0)]:
            one.end()
        self._open.append(stream)
        life = asyncio.ensure_future(self._watch(stream))
        try:
            await stream.run(self.app, scope, receive)
        finally:
            life.cancel()
            self._open.remove(stream)

    async def _watch(self, stream: _Stream) -> None:
        """End a stream when it is old and its page is not here."""
        await asyncio.sleep(LIFE)
        while self.here(stream.cookie):
            await asyncio.sleep(LIFE)
        stream.end()


class _Stream:
    """One stream, which can be ended from here."""

    def __init__(self, request: HTTPConnection, send: Send) -> None:
        self.cookie, self.address = cookie_of(request), address_of(request)
        self._send = send
        self._answer: asyncio.Future[None] | None = None
        self._ended = self._begun = False

    def end(self) -> None:
        """End it, as if its reader had gone."""
        self._ended = True
        if self._answer is not None:
            self._answer.cancel()

    async def run(self, app: ASGIApp, scope: Scope, receive: Receive) -> None:
        """Have the application answer until it is done or `end` is called."""
        self._answer = asyncio.ensure_future(app(scope, receive, self._pass_on))
        try:
            await self._answer
        except asyncio.CancelledError:
            if not self._ended:
                raise
            if not self._begun:
                return await PlainTextResponse(TOO_MANY, 429, {"connection": "close"})(
                    scope, receive, self._send
                )
            await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _pass_on(self, message: Message) -> None:
        self._begun = True
        await self._send(message)
