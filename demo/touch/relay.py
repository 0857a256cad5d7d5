"""The server's part in a live run: it carries messages between a browser and the run's process.

A browser acknowledges each frame that it has drawn. At most two are on their way to it; of those
that come in the meantime only the newest is kept, so a slow browser skips frames.
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

from ..identity import cookie_of
from ..sentences import sentence
from ..settings import Settings
from .orders import Budget, Refused, understood
from .player import BINDING, FRAME, SESSION, TEXT, Play, play
from .sessions import limits_of
from .table import Table, Ticket

LOG = logging.getLogger("phy124.web")
CHILD = Path(__file__).with_name("child.py")
ON_THE_WAY = 2
"""Frames that are sent before one of them is acknowledged."""
PENDING = 1 << 16
"""Size of messages to the process that wait to be read; of more, the newest are dropped [bytes]."""
LARGEST = 1 << 26
"""Size of a message from the process [bytes]."""
SAYINGS = 32
"""Sentences that wait to be sent; of more, the newest are dropped."""
PARTING = 10.0
"""Time for the last sentence to reach a browser [s]."""
BROKEN = "The live run broke down. Start it again."
IDLE = "It was not touched for {:g} minutes, so it was ended."
OVER = "A live run lasts {:g} minutes here. Start another one."
REPLACED = "It was ended, because you started another one."
GONE = 4404
"""Code of a socket that is closed because it has no live run."""


def socket_route(table: Table, settings: Settings) -> WebSocketRoute:
    """The socket of live runs.

    Args:
        table: Who may touch.
        settings: The page's limits.
    """

    async def touched(socket: WebSocket) -> None:
        await socket.accept()
        try:
            ticket = table.take(cookie_of(socket), socket.path_params["name"])
        except InputError as error:
            return await _part(socket, sentence(error))
        if ticket is None:
            return await socket.close(GONE)
        try:
            await Relay(socket, ticket, settings).run()
        finally:
            table.over(ticket)

    return WebSocketRoute("/phy124/touch/{name}", touched)


async def _part(socket: WebSocket, said: str) -> None:
    """Say the last sentence, and close."""
    await socket.send_text(json.dumps({"kind": "ended", "text": said}))
    await socket.close()


def _call(loop: asyncio.AbstractEventLoop, act: Callable[[], None]) -> None:
    """Do something in a loop that may have ended, from any thread."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(act)


async def _closed(process: asyncio.subprocess.Process, tasks: list[asyncio.Task[None]]) -> None:
    """Wait for the end of a process, and read what is left, so that its pipes are closed."""
    await asyncio.gather(*tasks, return_exceptions=True)
    assert process.stdin is not None
    process.stdin.close()
    await process.communicate()


class Relay:
    """One live run between a browser and its process."""

    def __init__(self, socket: WebSocket, ticket: Ticket, settings: Settings) -> None:
        self._socket, self._ticket, self._settings = socket, ticket, settings
        self._frame: bytes | None = None
        """The newest frame that was not sent yet."""
        self._texts: asyncio.Queue[str] = asyncio.Queue(SAYINGS)
        self._binding: bytes | None = None
        self._news = asyncio.Event()
        self._sent = self._seen = 0
        """Frames that were sent, and those of them that are no longer on their way."""
        self._budget = Budget()
        self._touched = self._begun = time.monotonic()
        self._ended: asyncio.Future[str] = asyncio.get_running_loop().create_future()

    async def run(self) -> None:
        """Carry messages until one side has gone or the time is up."""
        loop = asyncio.get_running_loop()
        self._ticket.end = partial(_call, loop, partial(self._end, REPLACED))
        process = await asyncio.create_subprocess_exec(
            sys.executable, str(CHILD),
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, limit=LARGEST,
        )  # fmt: skip
        parts = self._hear(process), self._tell(), self._listen(process), self._watch()
        tasks = [asyncio.create_task(self._guarded(part)) for part in parts]
        try:
            last = await self._ended
        finally:
            for task in tasks:
                task.cancel()
            with suppress(ProcessLookupError):
                process.kill()
            # Also if this task is cancelled, however often.
            with CancelScope(shield=True):
                await _closed(process, tasks)
        await self._goodbye(last)

    def _end(self, said: str) -> None:
        """End the run; the first sentence counts."""
        if not self._ended.done():
            self._ended.set_result(said)

    async def _guarded(self, part: Coroutine[Any, Any, str]) -> None:
        """A part of the work, whose end is the end of all."""
        try:
            self._end(await part)
        except (WebSocketDisconnect, RuntimeError):
            # The browser has gone, perhaps while something was being sent to it.
            self._end("")
        except (asyncio.IncompleteReadError, OSError):
            self._end(BROKEN)
        except Exception:
            LOG.exception("a live run broke")
            self._end(BROKEN)

    async def _goodbye(self, said: str) -> None:
        """Tell the browser why it ended, if it is still there."""
        if self._socket.application_state is not WebSocketState.CONNECTED:
            return
        with suppress(RuntimeError, WebSocketDisconnect, asyncio.TimeoutError, OSError):
            await asyncio.wait_for(_part(self._socket, said), PARTING)

    async def _hear(self, process: asyncio.subprocess.Process) -> str:
        """Take what the process sends; of frames, only the newest is kept."""
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
        """Have plain data sent to the browser."""
        with suppress(asyncio.QueueFull):
            self._texts.put_nowait(text)
        self._news.set()

    async def _tell(self) -> str:
        """Send to the browser what there is, one message after the other."""
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
        """Take what the browser sends; what it may not send is answered by a sentence."""
        assert process.stdin is not None
        while True:
            received = await self._socket.receive()
            if received["type"] == "websocket.disconnect":
                raise WebSocketDisconnect
            try:
                message = understood(received.get("text") or "", self._budget)
            except Refused as refusal:
                if refusal.said:
                    self._say(json.dumps({"kind": "said", "text": refusal.said}))
                continue
            if message["do"] == "seen":
                self._acknowledge(message.get("value"))
                continue
            self._touched = time.monotonic()
            if process.stdin.transport.get_write_buffer_size() < PENDING:
                process.stdin.write(json.dumps(message).encode() + b"\n")

    def _acknowledge(self, count: Any) -> None:
        """The browser has drawn the newest of so many frames; it may have left out others."""
        if isinstance(count, int):
            self._seen = min(max(count, self._seen), self._sent)
        self._news.set()

    async def _watch(self) -> str:
        """End the run when it is not touched any more, or its time is up."""
        idle, longest = self._settings.touch_idle_minutes, self._settings.touch_minutes
        while True:
            now = time.monotonic()
            if now - self._touched > 60 * idle:
                return IDLE.format(idle)
            if now - self._begun > 60 * longest:
                return OVER.format(longest)
            ends = min(self._touched + 60 * idle, self._begun + 60 * longest)
            await asyncio.sleep(max(ends - now, 0.01))
