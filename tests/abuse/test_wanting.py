"""One visitor who demands too much: disk space, streams, processor time, requests to other sites.

The server has little room and few open files; whatever is tried, others are served.
"""

import contextlib
import json
import socket
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from attacker import Attacker

from demo.traffic import STREAMS_ADDRESS, STREAMS_EACH
from support.served import ROOT, TIMEOUT, serving

pytestmark = pytest.mark.slow
DUCK = (ROOT / "demo/examples/duck.png").read_bytes()
FILES, STREAMS = 1024, 600
"""Files that the server may have open, and streams that an attacker opens."""
EACH, ALL, VISITORS = 5, 20, 40
"""Room of one visitor and of all [MB], and how many there may be."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(
        tmp_path_factory.mktemp("wanting"),
        files=FILES,
        warm_up=False,
        gaussians=1000,
        max_upload_mb=2,
        max_visitor_mb=EACH,
        max_total_mb=ALL,
        max_visitors=VISITORS,
        max_per_address=30,
        grace_minutes=0.3,
    ) as running:
        yield running


@pytest.fixture
def attacker(server) -> Attacker:
    return Attacker(server)


@pytest.fixture(autouse=True)
def others_are_served(server):
    """After all attacks, there is room for a visitor from another address."""
    yield
    visitor = Attacker(server, address="10.9.9.9")
    server.until(lambda: visitor.upload(DUCK)[0] == 200, "room for somebody else")


# ---- room ---------------------------------------------------------------------------------------


def _megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) / 1e6


def test_exports_fill_no_more_than_the_room_of_one_visitor(server, attacker):
    path, scene = attacker.uploaded(DUCK), {"frames": 40, "changes": {"view.views": ["front"]}}
    kinds = ["ply", "usd", "mcap", "html", "4dgs"]
    assert "your limit is" in attacker.generate({"path": path}, formats=kinds, **scene)
    for kind in kinds:
        answer = attacker.generate({"path": path}, formats=[kind], **scene)
        assert answer.startswith("complete"), answer
        assert kind in answer and _megabytes(Path(path).parents[1]) < EACH
    assert _megabytes(server.folder) < ALL


def test_a_run_that_would_take_more_is_refused_before_it_starts(attacker):
    path = {"path": attacker.uploaded(DUCK)}
    changes = {"velocities": True, "contacts": True}
    answer = attacker.generate(path, frames=72, changes=changes)
    assert f"your limit is {EACH} MB. Choose fewer frames" in answer


def test_newcomers_leave_the_picture_of_who_is_there(server):
    visitor = Attacker(server, address="10.0.0.1")
    path = visitor.uploaded(DUCK)
    assert visitor.choose(path) == "cut out"
    for _ in range(75):
        newcomer = Attacker(server, address="10.0.0.2")
        assert newcomer.upload(b"1")[0] in (200, 503)
        assert visitor.is_known()
    assert Path(path).exists() and server.health()["visitors"] <= VISITORS


def test_uploads_without_a_visitor_stay_few(server):
    for _ in range(200):
        Attacker(server, cookie=False, address="10.0.0.3").uploaded(DUCK)
    arrivals = list((server.folder / "visitors" / "arrivals").iterdir())
    assert 0 < len(arrivals) <= 64 and _megabytes(server.folder) < ALL


# ---- processor time -----------------------------------------------------------------------------


def test_thousands_of_forces_are_counted_and_no_more(attacker):
    scene = {"forces": [{"kind": "uniform"}] * 800}
    job = attacker.press("picture", "choose", [], upload=attacker.uploaded(DUCK))[0]["job"]
    assert attacker.followed(job)["state"] == "done"
    attacker.press("picture", "cut", [None, None], job=job)
    with ThreadPoolExecutor(30) as pool:
        change = partial(attacker.press, "scene", "change", [None, scene, None, 1])
        for asked in [pool.submit(change) for _ in range(30)]:
            assert "allows at most 16" in asked.result(TIMEOUT)[0]["html"]
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


def _has_ended(stream: socket.socket) -> bool:
    """Read what has come of an answer in chunks."""
    stream.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while data := stream.recv(4096):
            if data.endswith(b"0\r\n\r\n"):
                return True
        return True
    return False


@pytest.mark.parametrize(("cookie", "most"), [(True, STREAMS_EACH), (False, STREAMS_ADDRESS)])
def test_idle_streams_block_no_visitor(server, cookie, most):
    """A new stream of a cookie ends its oldest one, so more may have begun than are open."""
    attacker, opened = Attacker(server, cookie=cookie), []
    with contextlib.ExitStack() as stack:
        for number in range(STREAMS):
            connection = socket.create_connection(("127.0.0.1", server.port), timeout=TIMEOUT)
            opened.append(stack.enter_context(connection))
            head = f"GET /gradio_api/heartbeat/{number} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
            connection.sendall(f"{head}Cookie: {attacker.cookie}\r\n\r\n".encode())
        begun = []
        for connection in opened:
            status = ""
            with contextlib.suppress(OSError):
                status = connection.recv(12).decode()[-3:]
            assert status in ("200", "429", "")
            begun += [connection] if status == "200" else []
        ended = set()

        def few() -> bool:
            ended.update(stream for stream in begun if stream not in ended and _has_ended(stream))
            return 0 < len(begun) - len(ended) <= most

        server.until(few, f"an end of all streams but {most}")
        assert server.health()["status"] == "ok"


def test_streams_that_the_page_does_not_need_are_closed(attacker):
    assert attacker.get("/gradio_api/dev/reload")[0] == 404


# ---- pages of other sites -----------------------------------------------------------------------

FOREIGN = [
    {"Origin": "https://evil.example"},
    {"Origin": "http://localhost:3000"},
    {"Origin": "null"},
    {"Sec-Fetch-Site": "cross-site"},
    {"Sec-Fetch-Site": "same-site"},
]


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


# ---- what is left -------------------------------------------------------------------------------


def test_an_honest_visitor_is_served_after_all_that(server):
    visitor = Attacker(server, address="10.9.9.9")
    answer = visitor.generate({"path": visitor.uploaded(DUCK)})
    assert answer.startswith("complete"), (answer, server.said())
    assert _megabytes(server.folder) < ALL
