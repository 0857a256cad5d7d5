"""The server as it is put together: each limit stands in front of the page."""

import asyncio
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from demo import connections, traffic
from demo.connections import Patient
from demo.settings import Settings
from demo.visitors import Visitors


class Page:
    """A page that never answers, behind all that stands in front of it."""

    def __init__(self, folder: Path) -> None:
        from demo.server import doors

        self.asked, self.statuses = 0, []
        self.door: Any = self._answer
        studio: Any = SimpleNamespace(settings=Settings(), visitors=Visitors(folder))
        for each in reversed(doors(studio, 1000)):
            self.door = each.cls(self.door, *each.args, **each.kwargs)

    async def _answer(self, scope, receive, send) -> None:
        self.asked += 1
        await asyncio.sleep(1000)

    async def _send(self, message: dict[str, Any]) -> None:
        self.statuses += [message["status"]] if "status" in message else []

    def ask(self, method: str, path: str, body: bytes = b"{}", **headers: str) -> asyncio.Task:
        """A request of the same address as all others."""
        parts = [{"type": "http.request", "body": body, "more_body": False}]

        async def receive() -> dict[str, Any]:
            return parts.pop() if parts else await asyncio.sleep(1000, {})

        options = {"host": "localhost", **headers}
        scope = {
            "type": "http", "method": method, "path": path, "client": ("10.0.0.1", 1),
            "headers": [(name.encode(), value.encode()) for name, value in options.items()],
        }  # fmt: skip
        return asyncio.create_task(self.door(scope, receive, self._send))


async def _settled() -> None:
    for _ in range(2000):
        await asyncio.sleep(0)


@pytest.mark.parametrize(
    ("method", "path", "most"),
    [
        ("POST", "/gradio_api/run/predict", traffic.EACH),
        ("POST", "/gradio_api/upload", traffic.RECEIVED_EACH),
        ("GET", "/gradio_api/heartbeat/x", traffic.STREAMS_ADDRESS),
    ],
)
def test_an_address_asks_only_so_much_at_once(tmp_path, method, path, most):
    async def visit() -> int:
        page = Page(tmp_path)
        for _ in range(most + 9):
            page.ask(method, path)
        await _settled()
        return page.asked

    assert asyncio.run(visit()) == most


@pytest.mark.parametrize(
    ("status", "method", "path", "body", "headers"),
    [
        (400, "POST", "/gradio_api/run/predict", b"[" * 99, {}),
        (413, "POST", "/gradio_api/run/predict", b"", {"content-length": "999999999"}),
        (404, "GET", "/gradio_api/dev/reload", b"", {}),
        (421, "GET", "/", b"", {"host": "evil.example"}),
        (403, "POST", "/gradio_api/upload", b"", {"origin": "https://evil.example"}),
    ],
    ids=["deep", "long", "closed", "name", "site"],
)
def test_refused_requests_do_not_reach_the_page(tmp_path, status, method, path, body, headers):
    async def visit() -> Page:
        page = Page(tmp_path)
        page.ask(method, path, body, **headers)
        await _settled()
        return page

    page = asyncio.run(visit())
    assert (page.statuses, page.asked) == ([status], 0)


def test_the_page_knows_who_asks(tmp_path, monkeypatch):
    from demo.sessions import ASKER

    async def visit() -> list[tuple[str | None, str]]:
        page, asker = Page(tmp_path), []

        async def answer(page: Page, scope, receive, send) -> None:
            asker.append(ASKER.get())

        monkeypatch.setattr(Page, "_answer", answer)
        page = Page(tmp_path)
        await page.ask("POST", "/gradio_api/run/predict", cookie=f"phy124={'a' * 32}")
        return asker

    assert asyncio.run(visit()) == [(f"cookie {'a' * 32}", "10.0.0.1")]


def test_excess_connections_are_closed(monkeypatch):
    """Create connections as uvicorn does; each knows the largest number of connections."""
    closed: list[Patient] = []
    monkeypatch.setattr(connections.H11Protocol, "__init__", lambda self: None)
    monkeypatch.setattr(connections.H11Protocol, "connection_made", lambda self, transport: None)
    monkeypatch.setattr(Patient, "_watch", lambda self: None)
    monkeypatch.setattr(Patient, "_make_room", lambda self: closed.append(self))  # noqa: PLW0108
    made: list[Any] = [partial(Patient, most=2)() for _ in range(3)]
    for number, each in enumerate(made, 1):
        each.connections = set(made[:number])
        each.connection_made(None)
    assert closed == made[2:]
