"""One visitor who wants too much: room, streams, processor time, work for other sites.

The server has little room and few open files; whatever is tried, others are served.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections import Counter
from concurrent.futures import ThreadPoolExecutor

import pytest
from attacker import Attacker

from support.served import ROOT, TIMEOUT, serving

DUCK = (ROOT / "demo/examples/duck.png").read_bytes()
FILES, STREAMS = 1024, 600
"""Files that the server may have open, and streams that an attacker opens."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    pytest.importorskip("gradio", reason="the extra demo is not installed")
    with serving(
        tmp_path_factory.mktemp("wanting"), files=FILES, warm_up=False, gaussians=1000,
        max_upload_mb=2,
    ) as running:  # fmt: skip
        yield running


@pytest.fixture
def attacker(server) -> Attacker:
    return Attacker(server)


@pytest.fixture(autouse=True)
def others_are_served(server):
    """Whatever was tried, a visitor from elsewhere gets a run afterwards."""
    yield
    visitor = Attacker(server, address="10.9.9.9")
    answer = visitor.generate({"path": visitor.uploaded(DUCK)})
    assert answer.startswith("complete"), (answer, server.said())


# ---- processor time -----------------------------------------------------------------------------


def test_thousands_of_forces_are_counted_and_no_more(attacker):
    scene = {"forces": [{"kind": "uniform"}] * 800}
    with ThreadPoolExecutor(30) as pool:
        asked = [pool.submit(attacker.press, "scene", "change", [None, scene, None])] * 30
        for answer in asked:
            assert "allows at most 16" in answer.result(TIMEOUT)[0]
    path = {"path": attacker.uploaded(DUCK)}
    changes = {"forces": [{"kind": "uniform"}] * 10_000}
    assert "longer than" in attacker.generate(path, changes=changes)


def test_json_that_takes_long_to_read_is_not_read(attacker):
    kind = {"Content-Type": "application/json"}
    deep, many, empty = "[" * 1000 + "]" * 1000, json.dumps([1] * 800_000), "{}," * 60_000
    for address in ("run/predict", "queue/join", "call/generate"):
        for data in (deep, many, f"[{empty}1]"):
            body = f'{{"fn_index": 0, "session_hash": "x", "data": {data}}}'
            status, text, _ = attacker.send("POST", f"/gradio_api/{address}", body, kind)
            assert (status, text[:27]) == (400, "This request cannot be read")


# ---- connections --------------------------------------------------------------------------------


@pytest.mark.parametrize("cookie", [True, False])
def test_idle_streams_shut_nobody_out(server, cookie):
    attacker, opened = Attacker(server, cookie=cookie), []
    with contextlib.ExitStack() as stack:
        for number in range(STREAMS):
            connection = socket.create_connection(("127.0.0.1", server.port), timeout=TIMEOUT)
            opened.append(stack.enter_context(connection))
            head = f"GET /gradio_api/heartbeat/{number} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            connection.sendall(f"{head}Cookie: {attacker.cookie}\r\n\r\n".encode())
        statuses: Counter[str] = Counter()
        for connection in opened:
            with contextlib.suppress(OSError):
                statuses[connection.recv(12).decode()[-3:]] += 1
        assert set(statuses) <= {"200", "429", ""} and 0 < statuses["200"] <= 64
        assert server.health()["status"] == "ok"


def test_streams_that_the_page_does_not_need_are_closed(attacker):
    assert attacker.get("/gradio_api/dev/reload")[0] == 404


# ---- pages of other sites -----------------------------------------------------------------------

FOREIGN = [
    {"Origin": "https://evil.example"}, {"Origin": "http://localhost:3000"}, {"Origin": "null"},
    {"Sec-Fetch-Site": "cross-site"}, {"Sec-Fetch-Site": "same-site"},
]  # fmt: skip


@pytest.mark.parametrize("sent", FOREIGN, ids=lambda sent: " ".join(*sent.items()))
def test_the_page_of_another_site_starts_nothing(server, attacker, sent):
    before = server.health()["visitors"]
    for method in ("POST", "OPTIONS"):
        for address in ("run/predict", "upload", "queue/join", "call/generate", "cancel"):
            path = f"/gradio_api/{address}"
            status, _, headers = attacker.send(method, path, b"{}", {**sent, "Accept": "*/*"})
            assert status == 403 and not any("access-control" in name for name in headers)
    assert server.health()["visitors"] == before
    headers = attacker.send("GET", "/config", None, sent)[2]
    assert not any("access-control" in name for name in headers)
