"""Turns: how many requests are answered at the same time, and whose."""

import asyncio

from demo import traffic
from demo.traffic import EACH, PRESENT, RECEIVED, RECEIVED_EACH, TOGETHER, UPLOADS, Turns


class Page:
    """A page whose answers take until they are let go."""

    def __init__(self) -> None:
        self.door = Turns(self._answer)
        self.going: list[str] = []
        self.refused: list[int] = []
        self.let_go = asyncio.Event()

    async def _answer(self, scope, receive, send) -> None:
        self.going.append(scope["client"][0])
        await self.let_go.wait()

    async def _send(self, message) -> None:
        self.refused += [message["status"]] if "status" in message else []

    def ask(self, address: str, path: str = "/gradio_api/run/predict") -> asyncio.Task:
        scope = {
            "type": "http",
            "method": "POST",
            "path": path,
            "headers": [],
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
