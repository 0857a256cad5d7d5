"""Protection of the page: whose requests are answered, and headers of responses."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse

from .identity import COOKIE, new_name

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

FETCHES = re.compile(r"/gradio_api/(?:file=|proxy=)(?:https?:|ftp:|//)", re.IGNORECASE)
"""Addresses at which Gradio would fetch something from elsewhere."""
CLOSED = re.compile(
    r"/gradio_api/(?:dev|deep_link|stream|component_server|process_recording|vibe|undo-vibe|runs"
    r"|run-history|profiling|login_check)\b|/monitoring\b"
)
"""Addresses of Gradio that the page does not need, among them streams that never end."""
FORWARDED = ("x-forwarded-host", "x-gradio-server")
"""Headers by which a proxy says how the page is called."""
POLICY = (
    # Gradio makes functions of the panels' scripts; a script injected into the page does not run.
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; media-src 'self' blob:; "
    "font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; object-src 'none'; "
    "base-uri 'self'; form-action 'self'; frame-ancestors {frames}"
)
INERT = "default-src 'none'; style-src 'unsafe-inline'; sandbox"
"""Policy for everything except the page itself, in case it is opened as a page."""


class Doorkeeper:
    """Refuses requests under other host names, those that would fetch from other sites, those for
    what the page does not need, and those by which another site's page would do something here.
    """

    def __init__(
        self, app: ASGIApp, hosts: frozenset[str], origins: frozenset[str] = frozenset()
    ) -> None:
        """Stand in front of an application.

        Args:
            app: The application.
            hosts: Names it answers to.
            origins: Those of them that a proxy may replace by another one.
        """
        self.app, self.hosts, self.origins = app, hosts, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer 421, 404 or 403, or pass the request on."""
        if scope["type"] == "http":
            refusal = self._refusal(scope)
            if refusal is not None:
                return await refusal(scope, receive, send)
        if scope["type"] == "websocket":
            headers = Headers(scope=scope)
            # Before it is accepted, this is answered by 403.
            if "origin" not in headers or not self._from_own_page(headers):
                return await send({"type": "websocket.close", "code": 1008})
        await self.app(scope, receive, send)

    def _from_own_page(self, headers: Headers) -> bool:
        """Whether a page of this server or a program asks: browsers say whose page it is."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return False
        if not is_own_name(host, self.hosts):
            return False
        if origin is None:
            return True
        place = origin.lower().partition("://")[2]
        return _without_port(place) in self.origins or _usual(place) == _usual(host.lower())

    def _is_called_so(self, headers: Headers) -> bool:
        """Whether the page has the names by which a request calls it.

        Gradio writes those of proxies into the page, so that an address is not enough.
        """
        host = headers.get("host", "").lower()
        said = ",".join(headers.get(name, "") for name in FORWARDED).lower()
        names = (name.strip() for name in said.split(",") if name.strip())
        return is_own_name(host, self.hosts) and all(
            name == host or {"*", _without_port(name)} & self.hosts for name in names
        )

    def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        headers = Headers(scope=scope)
        if not self._is_called_so(headers):
            return PlainTextResponse("This page has another host name (PHY124_HOSTS).", 421)
        if FETCHES.search(scope["path"]):
            return PlainTextResponse("This page fetches nothing from elsewhere.", 403)
        if CLOSED.match(scope["path"]):
            return PlainTextResponse("There is no such address here.", 404)
        if scope["method"] not in ("GET", "HEAD") and not self._from_own_page(headers):
            return PlainTextResponse("This page takes nothing from the pages of other sites.", 403)
        return None


def _without_port(place: str) -> str:
    return re.sub(r":\d+$", "", place)


def _usual(place: str) -> str:
    """A host without the port that browsers leave out."""
    return re.sub(r":(80|443)$", "", place)


def listed(more: str, space: str = "") -> frozenset[str]:
    """Names with commas between them."""
    return frozenset(filter(None, (name.strip().lower() for name in f"{more},{space}".split(","))))


def own_names(more: str, space: str = "") -> frozenset[str]:
    """Host names the page answers to, besides IP addresses."""
    here = socket.gethostname().lower()
    return frozenset({"localhost", here, f"{here}.local"}) | listed(more, space)


def is_own_name(host: str, names: frozenset[str]) -> bool:
    """Whether a Host header names this page.

    IP addresses always do: DNS rebinding needs a name.
    """
    name = _without_port(host.lower()).strip("[]")
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
