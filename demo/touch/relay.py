"""Relay messages between a browser and the process of the browser's live run, within limits.

A browser acknowledges each frame that it has rendered. Up to two frames may be unacknowledged; of
further frames, only the newest is kept, so that a slow browser skips frames.
"""

from __future__ import annotations

import asyncio
import json
import logging
import pickle
import struct
import sys
import time
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from anyio import CancelScope
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from phy124.errors import InputError
from phy124.runtime.signals import without_signals

from ..guard import cookie_of
from ..line import user_message
from ..settings import Settings
from .player import BINDING, FRAME, SESSION, TEXT, Play, play
from .table import Table, Ticket, limits_of

LOG = logging.getLogger("phy124.web")
CHILD = Path(__file__).with_name("child.py")
ON_THE_WAY = 2
"""Largest number of frames that are sent but not yet acknowledged."""
PENDING = 1 << 16
"""Largest total size of unread messages [bytes]; further messages are discarded."""
LARGEST = 1 << 26
"""Largest size of a message from the process [bytes]."""
SAYINGS = 32
"""Largest number of unsent messages for the visitor; further messages are discarded."""
PARTING = 10.0
"""Time limit for sending the last message of a live run to the browser [s]."""
BROKEN = "The live run failed. Start it again."
IDLE = "The live run ended, because it was not touched for {:g} minutes."
OVER = "A live run lasts {:g} minutes here. Start another one."
REPLACED = "The live run ended, because you started another one."
GONE = 4404
"""Code for closing a socket that has no live run."""
WORDS = ("grab", "to", "release", "gravity", "soften", "speed", "pause", "reset", "save", "seen")
PER_SECOND, AT_ONCE = 150.0, 300.0
"""Largest number of messages per second, and in a burst; a pointer sends one per screen refresh."""
LARGEST_MESSAGE = 1024
"""Largest length of a message from the browser [bytes]."""
NOT_UNDERSTOOD = "The page sent an invalid message. Reload it."
TOO_MANY = "The page sent too many messages; some were ignored."


def socket_route(table: Table, settings: Settings) -> WebSocketRoute:
    """Return the route of the WebSocket for live runs."""

    async def touched(socket: WebSocket) -> None:
        await socket.accept()
        try:
            ticket = table.take(cookie_of(socket), socket.path_params["name"])
        except InputError as error:
            return await _part(socket, user_message(error))
        if ticket is None:
            return await socket.close(GONE)
        try:
            await Relay(socket, ticket, settings).run()
        finally:
            table.over(ticket)

    return WebSocketRoute("/phy124/touch/{name}", touched)


async def _part(socket: WebSocket, text: str) -> None:
    await socket.send_text(json.dumps({"kind": "ended", "text": text}))
    await socket.close()


def _call(loop: asyncio.AbstractEventLoop, act: Callable[[], None]) -> None:
    """Call a function in an event loop from any thread, unless the loop has ended."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(act)


async def _closed(process: asyncio.subprocess.Process, tasks: list[asyncio.Task[None]]) -> None:
    await asyncio.gather(*tasks, return_exceptions=True)
    assert process.stdin is not None
    process.stdin.close()
    await process.communicate()


class Relay:
    """The connection between a live run's browser and its process."""

    def __init__(self, socket: WebSocket, ticket: Ticket, settings: Settings) -> None:
        self._socket, self._ticket, self._settings = socket, ticket, settings
        self._frame: bytes | None = None
        """The newest frame that has not been sent yet."""
        self._texts: asyncio.Queue[str] = asyncio.Queue(SAYINGS)
        self._binding: bytes | None = None
        self._news = asyncio.Event()
        self._sent = self._seen = 0
        """Number of frames sent, and number of frames acknowledged by the browser."""
        self._budget = Budget()
        self._touched = self._begun = time.monotonic()
        self._ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def run(self) -> None:
        """Relay messages until the browser or the process disconnects, or the time is up."""
        loop = asyncio.get_running_loop()
        self._ticket.end = partial(_call, loop, partial(self._end, REPLACED))
        pipe = asyncio.subprocess.PIPE
        with without_signals():
            process = await asyncio.create_subprocess_exec(
                sys.executable, str(CHILD), stdin=pipe, stdout=pipe, limit=LARGEST
            )
        parts = self._hear(process), self._tell(), self._listen(process), self._watch()
        tasks = [asyncio.create_task(self._guarded(part)) for part in parts]
        try:
            last = await self._ended
        finally:
            for task in tasks:
                task.cancel()
            with suppress(ProcessLookupError):
                process.kill()
            # The call is shielded, because this task may be cancelled repeatedly.
            with CancelScope(shield=True):
                await _closed(process, tasks)
        await self._goodbye(last)

    def _end(self, text: str) -> None:
        """Later calls of this method have no effect."""
        if not self._ended.done():
            self._ended.set_result(text)

    async def _guarded(self, part: Coroutine[Any, Any, str]) -> None:
        try:
            self._end(await part)
        except (WebSocketDisconnect, RuntimeError):
            # The browser has disconnected, perhaps while data was sent.
            self._end("")
        except (asyncio.IncompleteReadError, OSError):
            self._end(BROKEN)
        except Exception:
            LOG.exception("a live run failed")
            self._end(BROKEN)

    async def _goodbye(self, text: str) -> None:
        if self._socket.application_state is not WebSocketState.CONNECTED:
            return
        with suppress(RuntimeError, WebSocketDisconnect, asyncio.TimeoutError, OSError):
            await asyncio.wait_for(_part(self._socket, text), PARTING)

    async def _hear(self, process: asyncio.subprocess.Process) -> str:
        assert process.stdin is not None and process.stdout is not None
        order = self._ticket.order
        gaussians = order.gaussians * len(order.scene.names)
        what = Play(order, limits_of(self._settings, gaussians))
        process.stdin.write(pickle.dumps(sys.path) + pickle.dumps((play, (what,))))
        await process.stdin.drain()
        while True:
            head = await process.stdout.readexactly(5)
            letter, (length,) = head[:1], struct.unpack("<I", head[1:])
            content = await process.stdout.readexactly(length)
            if letter == FRAME:
                self._frame = content
            elif letter == BINDING:
                self._binding = content
            elif letter == SESSION:
                self._ticket.session = json.loads(content)
            elif letter == TEXT:
                self._say(content.decode())
            self._news.set()

    def _say(self, text: str) -> None:
        with suppress(asyncio.QueueFull):
            self._texts.put_nowait(text)
        self._news.set()

    async def _tell(self) -> str:
        while True:
            await self._news.wait()
            self._news.clear()
            if self._binding is not None:
                binding, self._binding = self._binding, None
                await self._socket.send_bytes(BINDING + binding)
            while not self._texts.empty():
                await self._socket.send_text(self._texts.get_nowait())
            if self._frame is not None and self._sent - self._seen < ON_THE_WAY:
                frame, self._frame = self._frame, None
                self._sent += 1
                await self._socket.send_bytes(FRAME + frame)

    async def _listen(self, process: asyncio.subprocess.Process) -> str:
        assert process.stdin is not None
        while True:
            received = await self._socket.receive()
            if received["type"] == "websocket.disconnect":
                raise WebSocketDisconnect
            try:
                message = parse_message(received.get("text") or "", self._budget)
            except Refused as refusal:
                if refusal.text:
                    self._say(json.dumps({"kind": "said", "text": refusal.text}))
                continue
            if message["do"] == "seen":
                self._acknowledge(message.get("value"))
                continue
            self._touched = time.monotonic()
            if process.stdin.transport.get_write_buffer_size() < PENDING:
                process.stdin.write(json.dumps(message).encode() + b"\n")

    def _acknowledge(self, count: Any) -> None:
        """Earlier frames may have been skipped."""
        if isinstance(count, int):
            self._seen = min(max(count, self._seen), self._sent)
        self._news.set()

    async def _watch(self) -> str:
        idle, longest = self._settings.touch_idle_minutes, self._settings.touch_minutes
        while True:
            now = time.monotonic()
            if now - self._touched > 60 * idle:
                return IDLE.format(idle)
            if now - self._begun > 60 * longest:
                return OVER.format(longest)
            ends = min(self._touched + 60 * idle, self._begun + 60 * longest)
            await asyncio.sleep(max(ends - now, 0.01))


class Refused(Exception):
    """Raised if a message from the browser is refused."""

    def __init__(self, text: str = "") -> None:
        super().__init__(text)
        self.text = text
        """Reason of the refusal, as a sentence for the visitor; empty if the reason was already
        sent.
        """


class Budget:
    """Limits the rate of messages by a token bucket."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left, self._at, self._warned = AT_ONCE, clock(), False

    def spend(self) -> None:
        """Count a message, and check that the rate is within the limit.

        Raises:
            Refused: There were too many messages.
        """
        now = self._clock()
        self._left = min(AT_ONCE, self._left + PER_SECOND * (now - self._at))
        self._at = now
        if self._left < 1:
            text, self._warned = "" if self._warned else TOO_MANY, True
            raise Refused(text)
        self._left -= 1


def parse_message(text: str, budget: Budget) -> dict[str, Any]:
    """Parse a message from the browser.

    Raises:
        Refused: The message is too long or invalid, or there are too many messages.
    """
    budget.spend()
    if len(text) > LARGEST_MESSAGE:
        raise Refused(NOT_UNDERSTOOD)
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        raise Refused(NOT_UNDERSTOOD) from None
    if not isinstance(message, dict) or message.get("do") not in WORDS:
        raise Refused(NOT_UNDERSTOOD)
    return message
