"""Turns: how many requests are answered at the same time, and whose."""

import asyncio
from collections import Counter
from contextlib import contextmanager
from typing import Any

from demo import traffic
from demo.traffic import EACH, PRESENT, RECEIVED, RECEIVED_EACH, TOGETHER, UPLOADS, Present, Turns


class Page:
    """A page whose answers take until they are let go."""

    def __init__(self) -> None:
        self.door: Any = Turns(self._answer)
        self.going: list[str] = []
        self.refused: list[int] = []
        self.let_go = asyncio.Event()

    async def _answer(self, scope, receive, send) -> None:
        self.going.append(scope["client"][0])
        await self.let_go.wait()

    async def _send(self, message) -> None:
        self.refused += [message["status"]] if "status" in message else []

    def ask(
        self,
        address: str,
        path: str = "/gradio_api/run/predict",
        cookie: str = "",
        method: str = "POST",
    ) -> asyncio.Task:
        headers = [(b"cookie", f"phy124={cookie * 32}".encode())] if cookie else []
        scope = {
            "type": "http",
            "method": method,
            "path": path,
            "headers": headers,
            "client": (address, 1),
        }
        return asyncio.create_task(self.door(scope, None, self._send))


async def _settled() -> None:
    for _ in range(200):
        await asyncio.sleep(0)


def test_a_few_are_answered_at_once_and_fewer_of_one_address():
    async def visit():
        page = Page()
        asked = [page.ask("10.0.0.1") for _ in range(30)]
        await _settled()
        assert page.going == ["10.0.0.1"] * EACH
        asked += [page.ask(f"10.0.0.{number}") for number in range(2, 9)]
        await _settled()
        assert len(page.going) == TOGETHER and "10.0.0.2" in page.going
        asked.append(page.ask("10.0.0.1", "/phy124/here"))
        await _settled()
        assert len(page.going) == TOGETHER + 1, "what computes nothing does not wait"
        page.let_go.set()
        await asyncio.gather(*asked)
        assert len(page.going) == 38 and page.door._addresses == {} and not page.refused

    asyncio.run(visit())


def test_slow_uploads_do_not_delay_runs():
    async def visit():
        page = Page()
        page.door = Turns(Turns(page._answer, UPLOADS, RECEIVED, RECEIVED_EACH))
        asked = [page.ask("10.0.0.1", "/gradio_api/upload") for _ in range(RECEIVED_EACH + 5)]
        await _settled()
        assert len(page.going) == RECEIVED_EACH
        asked.append(page.ask("10.0.0.1"))
        await _settled()
        assert len(page.going) == RECEIVED_EACH + 1
        page.let_go.set()
        await asyncio.gather(*asked)

    asyncio.run(visit())


def test_full_queue_and_long_waits_are_refused(monkeypatch):
    async def visit():
        page = Page()
        asked = [page.ask("10.0.0.1") for _ in range(PRESENT + 3)]
        await _settled()
        assert page.refused == [429] * 3
        page.let_go.set()
        await asyncio.gather(*asked)
        page.let_go.clear()
        asked = [page.ask("10.0.0.2") for _ in range(EACH)]
        await _settled()
        monkeypatch.setattr(traffic, "LONGEST", 0.0)
        asked.append(page.ask("10.0.0.2"))
        await asked[-1]
        assert page.refused == [429] * 4
        page.let_go.set()
        await asyncio.gather(*asked)

    asyncio.run(visit())


def test_a_visitor_whose_request_waits_is_present():
    async def visit():
        page, present = Page(), Counter()

        @contextmanager
        def asking(name):
            present[name] += 1
            yield
            present[name] -= 1

        page.door = Present(page.door, asking)
        asked = [page.ask("10.0.0.1", cookie=letter) for letter in "abcdd"]
        await _settled()
        assert len(page.going) == EACH, "the other requests wait"
        names = {f"cookie {letter * 32}": n for letter, n in zip("abcd", (1, 1, 1, 2), strict=True)}
        assert present == names
        page.let_go.set()
        await asyncio.gather(*asked)
        assert not +present

    asyncio.run(visit())


def test_a_stream_does_not_make_a_visitor_present():
    """The stream of a page that was closed without notice may stay open for hours."""

    async def visit():
        page, present = Page(), []

        @contextmanager
        def asking(name):
            present.append(name)
            yield

        page.door = Present(page.door, asking)
        asked = page.ask("10.0.0.1", "/gradio_api/heartbeat/x", "a", method="GET")
        await _settled()
        assert page.going and not present
        page.let_go.set()
        await asked

    asyncio.run(visit())
