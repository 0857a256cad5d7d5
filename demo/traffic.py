"""Limit the traffic of each address: requests that compute, uploads, and open streams.

Only a few requests are processed in parallel, because a single request may take tenths of a second.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

import anyio
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse

from .guard import address_of, cookie_of

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

COMPUTES = re.compile(r"/gradio_api/(?:run|api|call|queue)\b")
"""URLs at which a POST request may take more than 0.2 s of processor time."""
TOGETHER, EACH = 4, 2
"""Largest number of requests that compute at the same time, in total and per address."""
UPLOADS = re.compile(r"/gradio_api/upload\b")
"""URLs of uploads, which occupy disk space until they are complete."""
RECEIVED, RECEIVED_EACH = 64, 8
"""Largest number of parallel uploads: in total, and per address."""
TOOLS = "/gradio_api/mcp"
"""URL of the tools for agents; Gradio's own MCP server uses the same URL."""
TOOLS_EACH = 4
"""Largest number of tools that an address may use in parallel."""
PRESENT = 64
"""Largest number of unfinished requests per address; further requests are refused."""
LONGEST = 60.0
"""Longest time that a request may wait [s]."""
TOO_MANY = "Too many requests from your address are waiting here. Try again in a minute."
STREAMED = re.compile(r"/gradio_api/(?:heartbeat|queue/data|call|upload_progress)\b")
"""URLs whose answer is a stream."""
STREAMS_EACH, STREAMS_ADDRESS = 16, 64
"""Largest number of streams: per cookie, and per address. A page needs one or two streams."""
LIFE = 7200.0
"""Time after which a stream ends unless its page is open [s]; a page may connect again."""
TOO_MANY_STREAMS = "Too many streams are open here. Close some pages."


class Present:
    """Counts a visitor as present from the arrival of a request until its answer is complete.

    A request may wait for its turn for longer than the visitor's grace period. Streams do not
    count, because a stream stays open when its page is closed without notice.
    """

    def __init__(self, app: ASGIApp, asking: Callable[[str], AbstractContextManager[None]]) -> None:
        """Wrap the application; within the context `asking(name)`, a visitor counts as present."""
        self.app, self.asking = app, asking

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on; meanwhile, count its visitor as present."""
        name = None
        if scope["type"] == "http" and not _is_stream(scope):
            name = cookie_of(HTTPConnection(scope))
        with self.asking(name) if name else nullcontext():
            await self.app(scope, receive, send)


def _is_stream(scope: Scope) -> bool:
    return scope["method"] == "GET" and STREAMED.match(scope["path"]) is not None


@dataclass
class _Address:
    turns: anyio.Semaphore
    present: int = 0


class Turns:
    """A queue of requests; limits the number of parallel requests in total and per address."""

    def __init__(
        self,
        app: ASGIApp,
        at: re.Pattern[str] = COMPUTES,
        together: int = TOGETHER,
        each: int = EACH,
    ) -> None:
        """Wrap an application, so that requests wait in the queue before they reach it.

        Args:
            app: The application to wrap.
            at: URLs of the requests that wait in the queue; other requests are passed on
                immediately.
            together: Largest number of requests that are processed in parallel.
            each: Largest number of requests per address that are processed in parallel.
        """
        self.app, self.at, self.each = app, at, each
        self._turns = anyio.Semaphore(together)
        self._addresses: dict[str, _Address] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when it is first in the queue, or answer with status 429."""
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


class Streams:
    """Limits the number of streams per cookie, per address and in total, and their duration."""

    def __init__(self, app: ASGIApp, most: int, here: Callable[[str | None], bool]) -> None:
        """Wrap the application; `here` returns whether the page of a visitor is open."""
        self.app, self.most, self.here = app, most, here
        self._open: list[_Stream] = []
        """Open streams, with the oldest stream first."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; if a cookie has too many streams, end its oldest stream.

        If another limit is exceeded, answer with status 429.
        """
        if scope["type"] != "http" or not _is_stream(scope):
            return await self.app(scope, receive, send)
        stream = _Stream(HTTPConnection(scope), send)
        of_address = [s for s in self._open if s.address == stream.address]
        if len(of_address) >= STREAMS_ADDRESS or len(self._open) >= self.most:
            return await PlainTextResponse(TOO_MANY_STREAMS, 429, {"connection": "close"})(
                scope, receive, send
            )
        of_cookie = [s for s in of_address if stream.cookie and s.cookie == stream.cookie]
        for oldest in of_cookie[: max(len(of_cookie) + 1 - STREAMS_EACH, 0)]:
            oldest.end()
        self._open.append(stream)
        life = asyncio.ensure_future(self._watch(stream))
        try:
            await stream.run(self.app, scope, receive)
        finally:
            life.cancel()
            self._open.remove(stream)

    async def _watch(self, stream: _Stream) -> None:
        await asyncio.sleep(LIFE)
        while self.here(stream.cookie):
            await asyncio.sleep(LIFE)
        stream.end()


class _Stream:
    def __init__(self, request: HTTPConnection, send: Send) -> None:
        self.cookie, self.address = cookie_of(request), address_of(request)
        self._send = send
        self._answer: asyncio.Future[None] | None = None
        self._ended = self._begun = self._complete = False

    def end(self) -> None:
        self._ended = True
        if self._answer is not None:
            self._answer.cancel()

    async def run(self, app: ASGIApp, scope: Scope, receive: Receive) -> None:
        self._answer = asyncio.ensure_future(app(scope, receive, self._pass_on))
        try:
            await self._answer
        except asyncio.CancelledError:
            if not self._ended:
                raise
            if self._complete:
                return None
            if not self._begun:
                return await PlainTextResponse(TOO_MANY_STREAMS, 429, {"connection": "close"})(
                    scope, receive, self._send
                )
            await self._send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _pass_on(self, message: Message) -> None:
        self._begun = True
        await self._send(message)
        self._complete = message["type"].endswith("body") and not message.get("more_body")
