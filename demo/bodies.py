"""Limit the size of request bodies, and the number and depth of their JSON values."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from starlette.responses import PlainTextResponse

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

DRAIN = 1 << 28
"""Number of bytes of a refused request that are read before its connection is closed."""
VALUES, DEEPEST = 50_000, 40
"""Largest number of values in the JSON of a request, and its largest nesting depth."""
HELD, SMALL = 128_000_000, 64_000
"""Largest memory of all incomplete request bodies, and largest size of a body not counted [bytes].
"""
ODD = (
    "This request cannot be read: its JSON has too many values, or they are nested too deeply, or "
    "one of them is NaN or infinite."
)
NUMBER = re.compile(rb"\d[-+.\deE]*")


class BodyLimit:
    """Refuses request bodies that are too large, and JSON with too many values.

    Gradio parses JSON in its main thread. A body with three million numbers would block all
    visitors for a second.
    """

    def __init__(
        self, app: ASGIApp, uploads: str, most: tuple[int, str], other: tuple[int, str]
    ) -> None:
        """Wrap an application, so that it receives only requests with permitted bodies.

        Args:
            app: The application to wrap.
            uploads: URL of uploads. The bodies of uploads are files, not JSON.
            most: Size of the largest upload [bytes], and the message for a larger upload.
            other: Size of the largest body of other requests [bytes], and the message for a larger
                body.
        """
        self.app, self.uploads, self.most, self.other = app, uploads, most, other
        self._held = 0
        """Size of all incomplete request bodies together [bytes]."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer with status 413 or 400, or pass the request on to the application."""
        if scope["type"] != "http":
            return await self.app(scope, receive, send)
        upload = scope["path"] == self.uploads
        most, message = self.most if upload else self.other
        length = dict(scope["headers"]).get(b"content-length", b"0")
        if not length.isdigit() or int(length) > most:
            await _drain(receive)
            return await _too_large(message)(scope, receive, send)
        if upload or scope["method"] in ("GET", "HEAD"):
            return await self.app(scope, _limit(receive, most), send)
        body = await self._whole(_limit(receive, most))
        if body is None:
            return await _too_large(message)(scope, receive, send)
        if not is_plain(body):
            return await PlainTextResponse(ODD, 400)(scope, receive, send)
        await self.app(scope, _replay(body, receive), send)

    async def _whole(self, receive: Receive) -> bytes | None:
        body, more = bytearray(), True
        try:
            while more:
                message = await receive()
                part = message.get("body", b"")
                body += part
                self._held += len(part)
                full = self._held > HELD and len(body) > SMALL
                if message["type"] == "http.disconnect" or full:
                    return None
                more = message.get("more_body", False)
            return bytes(body)
        finally:
            self._held -= len(body)


def is_plain(body: bytes) -> bool:
    """Return whether a JSON text has at most `VALUES` values, all finite, in `DEEPEST` levels.

    NaN and Infinity are not valid JSON, but Python's parser accepts them, and reads 1e999 as
    infinity. Gradio fails if its answer contains such a value. The check is fast because it counts
    commas and brackets, even those inside strings.
    """
    marks = sum(body.count(mark) for mark in (b",", b"[", b"{"))
    # A zero byte indicates UTF-16 or UTF-32, in which the search would miss quotes.
    if marks > VALUES or body.count(b'"') > 4 * VALUES or b"\0" in body:
        return False
    unescaped = body.replace(b"\\\\", b"").replace(b'\\"', b"")
    outside = b"".join(unescaped.split(b'"')[::2])
    if b"NaN" in outside or b"Infinity" in outside:
        return False
    for count, number in enumerate(NUMBER.finditer(outside)):
        if count > VALUES or _is_infinite(number[0]):
            return False
    depth = 0
    for bracket in re.findall(rb"[\[\]{}]", outside):
        depth += 1 if bracket in b"[{" else -1
        if depth > DEEPEST:
            return False
    return True


def _is_infinite(number: bytes) -> bool:
    try:
        return math.isinf(float(number))
    except ValueError:
        return False  # the text is not JSON, which its reader reports


def _limit(receive: Receive, most: int) -> Receive:
    """If the client sends more than `most` bytes, report a closed connection to the application."""
    read = 0

    async def counted() -> Message:
        nonlocal read
        message = await receive()
        read += len(message.get("body", b""))
        return message if read <= most else {"type": "http.disconnect"}

    return counted


def _replay(body: bytes, receive: Receive) -> Receive:
    unread = True

    async def again() -> Message:
        nonlocal unread
        if unread:
            unread = False
            return {"type": "http.request", "body": body, "more_body": False}
        return await receive()

    return again


def _too_large(said: str) -> PlainTextResponse:
    return PlainTextResponse(said, 413, {"connection": "close"})


async def _drain(receive: Receive) -> None:
    """Receive up to `DRAIN` bytes of a body, because clients read the answer only afterwards."""
    read, more = 0, True
    while more and read < DRAIN:
        message = await receive()
        read, more = read + len(message.get("body", b"")), message.get("more_body", False)
