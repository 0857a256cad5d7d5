"""Protect the page: identify visitors, refuse forbidden requests, and add response headers."""

from __future__ import annotations

import ipaddress
import re
import secrets
import socket
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send
from typing import Any

FETCHES = re.compile(r"/gradio_api/(?:file=|proxy=)(?:https?:|ftp:|//)", re.IGNORECASE)
"""URLs at which Gradio would download data from another site."""
CLOSED = re.compile(
    r"/gradio_api/(?:dev|deep_link|stream|component_server|process_recording|vibe|undo-vibe|runs"
    r"|run-history|profiling|login_check)\b|/monitoring\b"
)
"""URLs of Gradio that the page does not use, including infinite streams."""
FORWARDED = ("x-forwarded-host", "x-gradio-server")
"""Request headers in which a proxy states the page's host name."""
POLICY = (
    # Gradio compiles the panels' scripts with eval; scripts injected into the page do not run.
    "default-src 'self'; script-src 'self' 'nonce-{nonce}' 'unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; media-src 'self' blob:; "
    "font-src 'self' data:; connect-src 'self'; worker-src 'self' blob:; object-src 'none'; "
    "base-uri 'self'; form-action 'self'; frame-ancestors {frames}"
)
INERT = "default-src 'none'; style-src 'unsafe-inline'; sandbox"
"""Content security policy of all responses except the page. Browsers run no scripts in these
responses.
"""
SOCIAL = re.compile(rb'<meta\s+(?:property|name)="(?:og|twitter):[^>]*>\s*')
"""Tags that describe the page to other sites, in which Gradio advertises Gradio."""
ABOUT = b"""<meta name="description" content="One picture in, a moving 3D object out.">
<meta property="og:title" content="phy124"><meta property="og:type" content="website">
<meta property="og:description" content="One picture in, a moving 3D object out.">
"""
COOKIE = "phy124"
NAME = re.compile(r"[A-Za-z0-9_-]{32}")
NETWORK = 64
"""Length of the IPv6 prefix that a provider assigns to a subscriber [bits]."""


class Doorkeeper:
    """Refuses requests for other hosts, from other sites, for remote files and for unused URLs."""

    def __init__(
        self, app: ASGIApp, hosts: frozenset[str], origins: frozenset[str] = frozenset()
    ) -> None:
        """Wrap the application that answers the permitted requests.

        `origins` are the public host names of the page; a proxy may replace them in the Host
        header.
        """
        self.app, self.hosts, self.origins = app, hosts, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with status 421, 404 or 403, or pass the request on to the application."""
        if scope["type"] == "http":
            refusal = self._refusal(scope)
            if refusal is not None:
                return await refusal(scope, receive, send)
        if scope["type"] == "websocket":
            headers = Headers(scope=scope)
            # If a websocket is closed before it is accepted, the client receives status 403.
            if "origin" not in headers or not self._from_own_page(headers):
                return await send({"type": "websocket.close", "code": 1008})
        await self.app(scope, receive, send)

    def _from_own_page(self, headers: Headers) -> bool:
        host, origin = headers.get("host", ""), headers.get("origin")
        if headers.get("sec-fetch-site", "none") not in ("same-origin", "none"):
            return False
        if not is_own_name(host, self.hosts):
            return False
        if origin is None:
            return True
        place = origin.lower().partition("://")[2]
        return _without_port(place) in self.origins or _usual(place) == _usual(host.lower())

    def _has_own_host(self, headers: Headers) -> bool:
        """Host names from proxies are also checked, because Gradio writes them into the page."""
        host = headers.get("host", "").lower()
        said = ",".join(headers.get(name, "") for name in FORWARDED).lower()
        names = (name.strip() for name in said.split(",") if name.strip())
        return is_own_name(host, self.hosts) and all(
            name == host or {"*", _without_port(name)} & self.hosts for name in names
        )

    def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        headers = Headers(scope=scope)
        if not self._has_own_host(headers):
            return PlainTextResponse("The host name of this request is not in PHY124_HOSTS.", 421)
        if FETCHES.search(scope["path"]):
            return PlainTextResponse("This page downloads nothing from other sites.", 403)
        if CLOSED.match(scope["path"]):
            return PlainTextResponse("This page has no such address.", 404)
        if scope["method"] not in ("GET", "HEAD") and not self._from_own_page(headers):
            return PlainTextResponse("This page refuses requests from pages of other sites.", 403)
        return None


def _without_port(place: str) -> str:
    return re.sub(r":\d+$", "", place)


def _usual(place: str) -> str:
    """Remove the default ports, which browsers omit."""
    return re.sub(r":(80|443)$", "", place)


def split_names(more: str, space: str = "") -> frozenset[str]:
    """Split a comma-separated list of names."""
    return frozenset(filter(None, (name.strip().lower() for name in f"{more},{space}".split(","))))


def own_names(more: str, space: str = "") -> frozenset[str]:
    """Return the host names under which the page is served; IP addresses are always allowed."""
    here = socket.gethostname().lower()
    return frozenset({"localhost", here, f"{here}.local"}) | split_names(more, space)


def is_own_name(host: str, names: frozenset[str]) -> bool:
    """Return whether the name in a Host header belongs to this page.

    IP addresses are always accepted, because DNS rebinding attacks need a name.
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
    """Adds the security headers of a public page, and identifies each visitor by a cookie."""

    def __init__(self, app: ASGIApp, embedded: bool = False) -> None:
        self.app = app
        # Hugging Face Spaces show the page in a frame on another site.
        self.frames = "'self' https://huggingface.co" if embedded else "'self'"
        self.manner = "SameSite=None; Secure; Partitioned" if embedded else "SameSite=Lax"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on, and add the security headers and the cookie to the response."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        await self.app(scope, receive, _Answer(self, scope, send))


class _Answer:
    """A response that is being sent; HTML is buffered until it is complete."""

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
        first, *rest = SOCIAL.split(self.body)
        body = first + (ABOUT if rest else b"") + b"".join(rest)
        body = body.replace(b"<script", f'<script nonce="{nonce}"'.encode())
        headers = MutableHeaders(scope=self.page)
        headers["content-length"] = str(len(body))
        headers["cache-control"] = "no-store"
        headers["content-security-policy"] = POLICY.format(nonce=nonce, frames=self.rules.frames)
        if COOKIE.encode() + b"=" not in dict(self.scope["headers"]).get(b"cookie", b""):
            name = f"{COOKIE}={make_name()}; Path=/; HttpOnly; {self.rules.manner}"
            headers.append("set-cookie", name)
        await self.send(self.page)
        await self.send({"type": "http.response.body", "body": body})


def make_name() -> str:
    """Return a random name that cannot be guessed."""
    return secrets.token_urlsafe(24)


def cookie_of(request: Any) -> str | None:
    """Return the visitor's name from a request's cookie; None if it is missing or malformed."""
    cookies = getattr(request, "cookies", None) or {}
    name = cookies.get(COOKIE) if hasattr(cookies, "get") else getattr(cookies, COOKIE, None)
    return f"cookie {name}" if isinstance(name, str) and NAME.fullmatch(name) else None


def visitor_of(request: Any) -> str:
    """Return the visitor's name: from the cookie, else from the session, else a new name."""
    session = getattr(request, "session_hash", None)
    return cookie_of(request) or f"session {session or make_name()}"


def address_of(request: Any) -> str:
    """Return the IP address of a request; for IPv6, the subscriber's network."""
    host = getattr(getattr(request, "client", None), "host", None) or ""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.version == 4:
        return host
    if address.ipv4_mapped is not None:
        return str(address.ipv4_mapped)
    return str(ipaddress.ip_network((int(address) >> (128 - NETWORK) << (128 - NETWORK), NETWORK)))
