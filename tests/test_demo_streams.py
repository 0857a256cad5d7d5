"""Streams: how many a cookie, an address and all may have, and how long one lives."""

import asyncio

import pytest

from demo import traffic
from demo.traffic import STREAMS_ADDRESS, STREAMS_EACH, Streams

PATIENCE = 60.0
"""Time after which a stream that should have ended fails its test [s]."""


class Page:
    """Streams that are open until something ends them."""

    def __init__(self, most: int = 1000, here: bool = False) -> None:
        self.answers: list[list[dict]] = []
        self.open = 0
        self.door = Streams(self._answer, most, lambda cookie: here)

    async def _answer(self, scope, receive, send) -> None:
        await send({"type": "http.response.start", "status": 200, "headers": []})
        self.open += 1
        try:
            await asyncio.sleep(1000)
        finally:
            self.open -= 1

    async def visit(self, cookie: str, address: str = "10.0.0.1") -> asyncio.Task:
        """Open a stream, and wait until it is answered."""
        sent: list[dict] = []
        self.answers.append(sent)

        async def send(message):
            sent.append(message)

        headers = [(b"cookie", f"phy124={cookie * 32}".encode())] if cookie else []
        scope = {
            "type": "http",
            "method": "GET",
            "path": "/gradio_api/heartbeat/x",
            "headers": headers,
            "client": (address, 1),
        }
        task = asyncio.create_task(self.door(scope, None, send))
        while not sent:
            await asyncio.sleep(0)
        return task

    @property
    def statuses(self) -> list[int]:
        return [sent[0]["status"] for sent in self.answers]


def test_oldest_of_too_many_streams_of_a_cookie_ends():
    async def visit():
        page = Page()
        opened = [await page.visit("a") for _ in range(STREAMS_EACH)]
        other = await page.visit("b")
        await page.visit("a")
        await asyncio.wait_for(opened[0], PATIENCE)
        assert page.answers[0][-1] == {
            "type": "http.response.body",
            "body": b"",
            "more_body": False,
        }
        assert page.open == STREAMS_EACH + 1 and not any(
            item.done() for item in (*opened[1:], other)
        )
        assert set(page.statuses) == {200}

    asyncio.run(visit())


def test_an_answer_that_completes_when_cancelled_ends_once():
    """Gradio's heartbeat does so."""
    last = {"type": "http.response.body", "body": b"", "more_body": False}

    async def beat(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})
        try:
            await asyncio.sleep(1000)
        except asyncio.CancelledError:
            await send(last)
            raise

    async def visit():
        page = Page()
        page.door.app = beat
        opened = [await page.visit("a") for _ in range(STREAMS_EACH + 1)]
        await asyncio.wait_for(opened[0], PATIENCE)
        assert page.answers[0][1:] == [last]

    asyncio.run(visit())


def test_an_address_and_all_together_have_only_so_many_streams():
    async def visit():
        page = Page(most=STREAMS_ADDRESS + 2)
        for number in range(STREAMS_ADDRESS + 5):
            await page.visit("" if number % 2 else chr(97 + number // 8))
        assert page.statuses == [200] * STREAMS_ADDRESS + [429] * 5
        for number in range(2, 6):
            await page.visit("", f"10.0.0.{number}")
        assert page.statuses[-4:] == [200, 200, 429, 429] and page.open == STREAMS_ADDRESS + 2

    asyncio.run(visit())


@pytest.mark.parametrize("here", [True, False])
def test_a_stream_lives_on_only_while_its_page_is_here(monkeypatch, here):
    monkeypatch.setattr(traffic, "LIFE", 0.0)

    async def visit():
        page = Page(here=here)
        task = await page.visit("a")
        await asyncio.wait([task], timeout=0.1 if here else PATIENCE)
        assert task.done() is not here

    asyncio.run(visit())
