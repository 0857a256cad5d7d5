"""Bodies of requests: what their JSON may hold."""

import asyncio
import json

import pytest

from demo import bodies
from demo.bodies import DEEPEST, VALUES, BodyLimit, is_plain

PATIENCE = 60.0
"""Time after which a request without an answer fails its test [s]."""


def _nested(depth: int, beside: str = "") -> bytes:
    return ("[" * depth + beside + "]" * depth).encode()


@pytest.mark.parametrize(
    ("body", "plain"),
    [
        (b"", True),
        (b"[1,2,{}]", True),
        (json.dumps(['a\\"]'] * 9).encode(), True),
        (json.dumps({"url": "data:image/png;base64," + "A" * 10**6}).encode(), True),
        (json.dumps([1] * VALUES).encode(), True),
        (json.dumps([1] * 2 * VALUES).encode(), False),
        (json.dumps([{}] * VALUES).encode(), False),
        (b'"' * 10**7, False),
        (_nested(DEEPEST), True),
        (_nested(DEEPEST + 1), False),
        (_nested(DEEPEST - 1, json.dumps("[" * 99)), True),
        # Brackets in texts do not count, and closing ones take nothing away.
        (b'["]]]]\\"]]",' * (DEEPEST + 1) + b"]" * (DEEPEST + 1), False),
        (json.dumps([1]).encode("utf-16"), False),
        (json.dumps({"frames": float("nan")}).encode(), False),
        (json.dumps([-float("inf")]).encode(), False),
        (b'["NaN Infinity 1e999"]', True),
        (b"[1.5e+308, -2E-400, 1e5e9]", True),
        (b"[-1e999]", False),
        (b'{"E": 1' + b"0" * 400 + b".5}", False),
    ],
)
def test_json_is_bounded_in_number_and_depth(body, plain):
    assert is_plain(body) is plain


def _status(*parts: bytes, method: str = "POST", path: str = "/gradio_api/run/predict") -> int:
    """Status of the answer to a request in these parts; 200 if the page gets all of it."""
    sent, coming = [], list(parts)

    async def receive():
        body = coming.pop(0)
        return {"type": "http.request", "body": body, "more_body": bool(coming)}

    async def send(message):
        sent.append(message)

    async def page(scope, receive, send):
        more, body = True, b""
        while more:
            message = await receive()
            more, body = message.get("more_body", False), body + message.get("body", b"")
        sent.append({"status": 200 if body == b"".join(parts) else 0})

    scope = {"type": "http", "method": method, "path": path, "headers": []}
    asyncio.run(BodyLimit(page, "/upload", (90, "large"), (60, "large"))(scope, receive, send))
    return sent[0]["status"]


def test_bodies_that_trickle_in_have_only_so_much_memory(monkeypatch):
    monkeypatch.setattr(bodies, "HELD", 100)
    monkeypatch.setattr(bodies, "SMALL", 10)

    async def visit() -> list[int]:
        more, answers = asyncio.Event(), []

        async def page(scope, receive, send):
            answers.append(200)

        async def send(message):
            answers.append(message.get("status", 0)) if "status" in message else None

        limit = BodyLimit(page, "/upload", (90, "large"), (90, "large"))

        def ask(size: int) -> asyncio.Task:
            parts = [bytes(size).replace(b"\0", b" "), b""]

            async def receive():
                if len(parts) == 1:
                    await more.wait()
                body = parts.pop(0)
                return {"type": "http.request", "body": body, "more_body": bool(parts)}

            scope = {"type": "http", "method": "POST", "path": "/", "headers": []}
            return asyncio.create_task(limit(scope, receive, send))

        asked = []
        for size in (80, 30, 10, 5):
            asked.append(ask(size))
            await asyncio.sleep(0)
        await asyncio.wait_for(asked[1], PATIENCE)
        more.set()
        await asyncio.gather(*asked)
        assert limit._held == 0
        return answers

    assert asyncio.run(visit()) == [413, 200, 200, 200]


def test_bodies_reach_the_page_whole_or_not_at_all():
    assert _status(b"[1,", b"2]") == 200
    assert _status(b"[" * 30, b"[" * 29) == 400
    assert _status(b"[1]" * 10, b"[1]" * 11) == 413
    assert _status(b"[" * 80, path="/upload") == 200, "a file is no JSON"
    assert _status(b"[" * 91, path="/upload") == 0, "to the page the sender has gone"
