"""Protection of the page: limits on requests, headers of responses, time limits of connections."""

from __future__ import annotations

import ipaddress
import re
import resource
import secrets
import socket
from asyncio import TimerHandle
from typing import TYPE_CHECKING, Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from uvicorn.protocols.http.h11_impl import H11Protocol

from .identity import COOKIE, new_name

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

DRAIN = 1 << 28
"""Largest part of a refused request that is read before the connection is closed [bytes]."""
HEAD, BODY = 20.0, 120.0
"""Longest time for the head of a request and for its body [s]."""
FILES = 16_384
"""Number of files and connections that the page may have open, if the system allows it."""
FETCHES = re.compile(r"/gradio_api/(?:file=|proxy=)(?:https?:|ftp:|//)", re.IGNORECASE)
"""Addresses at which Gradio would fetch something from elsewhere."""
POLICY = (
    # Gradio makes functions of the panels' scripts; a script injected into the page does not run.
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; media-src 'self' blob:; "
    "font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; object-src 'none'; "
    "base-uri 'self'; form-action 'self'; frame-ancestors {frames}"
)
INERT = "default-src 'none'; style-src 'unsafe-inline'; sandbox"
"""Policy for everything except the page itself, in case it is opened as a page."""


class BodyLimit:
    """Refuses requests that are too large, whatever size they declare.

    `most` is for those to the address `uploads`, `other` for all others: each the number of bytes
    and what is said to larger ones.
    """

    def __init__(
        self, app: ASGIApp, uploads: str, most: tuple[int, str], other: tuple[int, str]
    ) -> None:
        self.app, self.uploads, self.limits = app, uploads, (other, most)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 413, or pass the request on."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        most, message = self.limits[scope["path"] == self.uploads]
        length = dict(scope["headers"]).get(b"content-length", b"0")
        if not length.isdigit() or int(length) > most:
            return await self._refuse(message, scope, receive, send)
        read = 0

        async def counted() -> Message:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            if read > most:
                # To the application it looks as if the client had disconnected.
                return {"type": "http.disconnect"}
            return message

        await self.app(scope, counted, send)

    async def _refuse(self, said: str, scope: Scope, receive: Receive, send: Send) -> None:
        # Read and discard the rest: a client that is still sending would not read an answer.
        read, more = 0, True
        while more and read < DRAIN:
            message = await receive()
            read, more = read + len(message.get("body", b"")), message.get("more_body", False)
        answer = PlainTextResponse(said, 413, {"connection": "close"})
        await answer(scope, receive, send)


class Doorkeeper:
    """Refuses requests under other host names, those that would fetch from other sites, and sockets
    that the page of another site opens.
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str]) -> None:
        self.app, self.hosts = app, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 421 or 403, or pass the request on."""
        if scope["type"] == "http":
            refusal = self._refusal(scope)
            if refusal is not None:
                return await refusal(scope, receive, send)
        if scope["type"] == "websocket" and not self._from_own_page(Headers(scope=scope)):
            # Before it is accepted, this is answered by 403.
            return await send({"type": "websocket.close", "code": 1008})
        await self.app(scope, receive, send)

    def _from_own_page(self, headers: Headers) -> bool:
        """Whether a page of this server opens a socket: browsers let those of others do so, too."""
        host = headers.get("host", "")
        origin = headers.get("origin", "").partition("://")[2]
        return is_own_name(host, self.hosts) and origin.lower() == host.lower()

    def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        if not is_own_name(Headers(scope=scope).get("host", ""), self.hosts):
            return PlainTextResponse("This page has another host name (PHY124_HOSTS).", 421)
        if FETCHES.search(scope["path"]):
            return PlainTextResponse("This page fetches nothing from elsewhere.", 403)
        return None


def own_names(more: str, space: str = "") -> frozenset[str]:
    """Host names the page answers to, besides IP addresses."""
    here = socket.gethostname().lower()
    given = [name.strip().lower() for name in f"{more},{space}".split(",")]
    return frozenset({"localhost", here, f"{here}.local", *filter(None, given)})


def is_own_name(host: str, names: frozenset[str]) -> bool:
    """Whether a Host header names this page.

    IP addresses always do: DNS rebinding needs a name.
    """
    name = re.sub(r":\d+$", "", host.lower()).strip("[]")
    if name in names or "*" in names:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class Headed:
    """Adds the headers that a public page should have, and gives each visitor a name."""

    def __init__(self, app: ASGIApp, embedded: bool = False) -> None:
        self.app = app
        # A Space shows the page in a frame of another site.
        self.frames = "'self' https://huggingface.co" if embedded else "'self'"
        self.manner = "SameSite=None; Secure; Partitioned" if embedded else "SameSite=Lax"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on and complete the response."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        await self.app(scope, receive, _Answer(self, scope, send))


class _Answer:
    """A response that is being sent; a page is held back until it is complete."""

    def __init__(self, rules: Headed, scope: Scope, send: Send) -> None:
        self.rules, self.scope, self.send = rules, scope, send
        self.page: Message | None = None
        self.body = b""

    async def __call__(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            self._mark(headers)
            if headers.get("content-type", "").startswith("text/html"):
                self.page = message
                return
        elif self.page is not None and message["type"] == "http.response.body":
            self.body += message.get("body", b"")
            if not message.get("more_body", False):
                await self._send_page()
            return
        await self.send(message)

    def _mark(self, headers: MutableHeaders) -> None:
        headers["x-content-type-options"] = "nosniff"
        headers["referrer-policy"] = "same-origin"
        headers.setdefault("content-security-policy", INERT)
        if headers.get("content-type", "").startswith("text/event-stream"):
            headers["x-accel-buffering"] = "no"

    async def _send_page(self) -> None:
        assert self.page is not None
        nonce = secrets.token_urlsafe(16)
        body = self.body.replace(b"<script", f'<script nonce="{nonce}"'.encode())
        headers = MutableHeaders(scope=self.page)
        headers["content-length"] = str(len(body))
        headers["cache-control"] = "no-store"
        headers["content-security-policy"] = POLICY.format(nonce=nonce, frames=self.rules.frames)
        if COOKIE.encode() + b"=" not in dict(self.scope["headers"]).get(b"cookie", b""):
            name = f"{COOKIE}={new_name()}; Path=/; HttpOnly; {self.rules.manner}"
            headers.append("set-cookie", name)
        await self.send(self.page)
        await self.send({"type": "http.response.body", "body": body})


def allow_connections() -> int:
    """Raise the limit of open files as far as allowed; returns half of it, for connections."""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    minimum = FILES if most == resource.RLIM_INFINITY else min(FILES, most)
    if now < minimum:
        resource.setrlimit(resource.RLIMIT_NOFILE, (minimum, most))
    return max(now, minimum) // 2


class Patient(H11Protocol):
    """A connection that is closed if a request does not arrive in time, however slowly it trickles.

    If there are too many connections, the one that has been waited for longest is closed.
    """

    clock: TimerHandle | None = None
    waiting_for = ""

    def __init__(self, *arguments: Any, most: int, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.most = most

    def connection_made(self, transport: Any) -> None:
        """Start the clock at once, since silence counts as well."""
        super().connection_made(transport)
        self._watch()
        if len(self.connections) > self.most:
            self._make_room()

    def data_received(self, data: bytes) -> None:
        """Process what has arrived, and set the time for what is missing."""
        super().data_received(data)
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop waiting."""
        self._stop()
        super().connection_lost(exc)

    def _watch(self) -> None:
        missing = str(self.conn.their_state)
        # A connection that has become a socket is another protocol's.
        if missing not in ("IDLE", "SEND_BODY") or self.transport.get_protocol() is not self:
            return self._stop()
        if missing != self.waiting_for:
            self._stop()
            self.waiting_for = missing
            seconds = HEAD if missing == "IDLE" else BODY
            self.clock = self.loop.call_later(seconds, self.transport.close)

    def _make_room(self) -> None:
        waiting = [each for each in self.connections if isinstance(each, Patient) and each.clock]
        slowest = min(waiting, key=lambda each: each.clock.when() if each.clock else 0.0)
        slowest._stop()
        slowest.transport.abort()

    def _stop(self) -> None:
        self.waiting_for = ""
        if self.clock is not None:
            self.clock.cancel()
            self.clock = None
