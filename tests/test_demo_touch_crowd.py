"""Touch on a real server, by sockets alone: visitors who vanish, and one who talks on and on."""

from __future__ import annotations

import asyncio
import json
import os
import select
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import uvicorn
from starlette.applications import Starlette

from demo.guard import COOKIE
from demo.settings import Settings
from demo.touch import Table, relay, socket_route
from support import touching
from support.websocket import TEXT, Visitor

HERE = Path(__file__).parent
ORDER = SimpleNamespace(gaussians=1000, scene=SimpleNamespace(names=["object"]))
WAYS = ("close", "reset", "half-open", "killed", "deaf")
"""Ways in which visitors disappear; the last two take long."""
QUIET = 0.4
"""Time of a run without a touch [min]: it ends who neither reads nor leaves."""


class Site:
    """A server with nothing but the socket, in a thread."""

    def __init__(self, most: int, **settings: float) -> None:
        self.chosen = Settings(max_touch=most, **settings)
        self.table = Table(most)
        app = Starlette(routes=[socket_route(self.table, self.chosen)])
        self.listening = socket.create_server(("127.0.0.1", 0))
        self.port = self.listening.getsockname()[1]
        config = uvicorn.Config(app, log_level="error", ws_per_message_deflate=False)
        self.server = uvicorn.Server(config)
        run = self.server.serve([self.listening])
        self.thread = threading.Thread(target=lambda: asyncio.run(run))

    def __enter__(self) -> Site:
        self.thread.start()
        until(lambda: self.server.started)
        return self

    def __exit__(self, *_: object) -> None:
        self.server.should_exit = True
        self.thread.join()

    def ticket(self, visitor: str) -> str:
        return self.table.give(visitor, ORDER).name


def in_a_process(port: int, visitor: str, ticket: str) -> None:
    """A visitor whose process is killed."""
    module = [sys.executable, "-m", "support.websocket"]
    command = [*module, str(port), f"{COOKIE}={visitor}", ticket]
    with subprocess.Popen(command, cwd=HERE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "ready"
        process.kill()


def until(condition) -> None:
    end = time.monotonic() + 300
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def runs() -> list[int]:
    """Processes of live runs that this one has started."""
    results = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            text = path.joinpath("stat").read_text().rsplit(")", 1)[1].split()
            command = path.joinpath("cmdline").read_bytes()
        except (OSError, IndexError):
            continue
        if int(text[1]) == os.getpid() and b"touch/child.py" in command:
            results.append(int(path.name))
    return results


def insist(visitor: Visitor, text: str) -> str:
    """Send a message again and again until a text message arrives; return its text."""
    kind = None
    while kind != TEXT:
        if select.select([visitor.socket], [], [], 0.01)[0]:
            kind, payload = visitor.frame()
        else:
            visitor.tell(text)
    return json.loads(payload)["text"]


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_nothing_remains_of_vanished_visitors(monkeypatch, count):
    monkeypatch.setattr(relay, "play", touching.flood_after_a_word)
    monkeypatch.setattr(relay, "Play", lambda order, most: order)
    ways = WAYS[:count]
    with Site(count, touch_idle_minutes=QUIET) as site:
        before, silent = descriptors(), []
        for index in range(count):
            name, way = f"{index:032x}", ways[index % len(ways)]
            ticket = site.ticket(f"cookie {name}")
            if way == "killed":
                in_a_process(site.port, name, ticket)
                continue
            visitor = Visitor(site.port, f"{COOKIE}={name}", ticket)
            assert visitor.text() == "ready"
            visitor.vanish(way)
            if way in ("deaf", "half-open"):
                silent.append(visitor)
        until(lambda: not len(site.table) and not runs())
        for visitor in silent:
            visitor.vanish("reset")
        until(lambda: descriptors() <= before)
        # Every place is free again.
        fresh = "f" * 32
        visitor = Visitor(site.port, f"{COOKIE}={fresh}", site.ticket(f"cookie {fresh}"))
        assert visitor.text() == "ready"
        visitor.vanish("close")
        until(lambda: not runs())


def test_ten_thousand_messages_do_not_stop_the_run(monkeypatch):
    monkeypatch.setattr(relay, "play", touching.echo)
    monkeypatch.setattr(relay, "Play", lambda order, most: order)
    me = "a" * 32
    with Site(1) as site:
        visitor = Visitor(site.port, f"{COOKIE}={me}", site.ticket(f"cookie {me}"))
        assert visitor.text() == "ready"
        visitor.tell(*10_000 * ['{"do": "pause"}'])
        assert visitor.text() == relay.TOO_MANY, "one sentence"
        # Messages count again as time goes on, but those that wait in the socket come first.
        assert insist(visitor, '{"do": "to", "value": 3}') == "to 3"
        visitor.vanish("close")
        until(lambda: not runs())
