"""Attacks on a real server, after the threat model in docs/guide/security.md; a minute or two.

Each test is an attacker; the last ones look at what all of them have left behind.
"""

import contextlib
import http.client
import io
import json
import re
import resource
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import pytest
from attacker import Attacker
from PIL import Image
from proxy import in_front_of

from phy124.io.ply import encode
from phy124.scene import Scene
from support.hostile import PHONE, bomb, heic_claiming
from support.photographs import Entry, exif_of, file_of, segment_of, upright, with_segment
from support.served import ROOT, TIMEOUT, serving
from support.shapes import ball

DUCK = (ROOT / "demo/examples/duck.png").read_bytes()
FILE = encode(ball(300))
"""A file of Gaussians, which takes less time than a picture."""
GIGABYTE = 1 << 30
NOT_HERE = "The server does not have this picture. Choose it again."
SECRETS = ["/etc/passwd", "/dev/zero", "/dev/random", "/no/such/file.png", "../../app.py"]
CROWD = 9
"""Visitors who come at once, more than twice as many as may wait."""
SLOW, FILES = 2000, 1024
"""Connections that never finish their request, and how many files the server may have open."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving(
        tmp_path_factory.mktemp("abuse"),
        files=FILES,
        warm_up=False,
        gaussians=1000,
        max_upload_mb=2,
        max_file_mb=3,
        max_visitors=40,
        grace_minutes=0.3,
        max_cut_seconds=60,
        max_seconds=120,
        max_queue=4,
        max_video_mb=3,
    ) as running:
        yield running


@pytest.fixture(scope="module", autouse=True)
def slow_sockets(server):
    """Open from the beginning: nobody else notices, and by the end they must have been closed."""
    now, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    attacker = Attacker(server)
    opened = [attacker.slow_socket() for _ in range(SLOW // 2)]
    body = b"POST /gradio_api/upload HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\nX-Slow: "
    opened += [attacker.slow_socket(body) for _ in range(SLOW // 2)]
    yield opened
    for connection in opened:
        connection.close()
    resource.setrlimit(resource.RLIMIT_NOFILE, (now, most))


@pytest.fixture
def attacker(server) -> Attacker:
    server.check_running()
    return Attacker(server)


@pytest.fixture(autouse=True)
def alive(server):
    """After all attacks, the server still answers."""
    yield
    assert server.health()["status"] == "ok", server.said()


# ---- files of the server ------------------------------------------------------------------------


@pytest.mark.parametrize("path", SECRETS)
@pytest.mark.parametrize("meta", [True, False])
def test_no_file_of_the_server_is_read_as_a_picture(server, attacker, path, meta):
    """Neither its content nor whether it exists is told."""
    image = {"path": path, **({"meta": {"_type": "gradio.FileData"}} if meta else {})}
    for inputs in (
        {"image": image},
        {"image": None, "side": image},
        {"image": None, "depth": image},
    ):
        answer = attacker.generate(**inputs)
        assert "root:" not in answer and ("error" in answer or "not in the cache" in answer), answer
        if not meta:
            assert NOT_HERE in answer
    assert attacker.choose(path) == NOT_HERE
    for option in ("side", "depth"):
        (stated,) = attacker.press("known", "choose", [], option=option, upload=path)
        assert stated["answer"] == {"option": option, "message": NOT_HERE}


def test_pictures_are_private_to_their_visitor(server, attacker):
    theirs = Attacker(server).uploaded(DUCK)
    assert attacker.choose(theirs) == NOT_HERE
    shown = str(attacker.press("scene", "change", [None, _scene(), {"side": theirs}, 1])[0])
    assert theirs not in shown
    assert NOT_HERE in attacker.generate({"path": theirs})


@pytest.mark.parametrize(
    "changes",
    [
        {"stiffness": {"kind": "array", "file": "/dev/zero"}},
        {"stiffness": {"kind": "picture", "file": "/etc/hostname"}},
        {"parts": [{"mask": "/etc/passwd", "material": {"law": "sand"}}]},
        {"parts": [{"mask": "/no/such/file", "material": {"law": "sand"}}]},
    ],
)
def test_no_scene_names_a_file_of_the_server(attacker, changes):
    path = attacker.uploaded(DUCK)
    answer = attacker.generate({"path": path}, changes=changes)
    assert "a scene cannot name a file, except a picture that you have uploaded" in answer, answer


@pytest.mark.parametrize(
    "path",
    [
        "/gradio_api/file=/etc/passwd",
        "/gradio_api/file=../../../../etc/passwd",
        "/gradio_api/file=app.py",
        "/phy124/static/../../pyproject.toml",
        "/phy124/static/%2e%2e/settings.py",
        "/phy124/viewer/..%2f..%2fapp.py",
        "/gradio_api/file=https://example.com/",
        "/gradio_api/file=http://127.0.0.1:22/",
        "/gradio_api/file=HTTP://169.254.169.254/",
        "/gradio_api/proxy=https://example.com/",
        "/gradio_api/file%3Dhttps://example.com/",
        "/gradio_api/file=//example.com/",
        "/phy124/jobs/../../health/",
        "/gradio_api/stream/a/b/c/playlist.m3u8",
    ],
)
def test_addresses_lead_to_nothing_else(attacker, path):
    status, text, _ = attacker.get(path)
    assert status >= 400, (status, text[:200])
    assert "root:" not in text and "[project]" not in text


@pytest.mark.parametrize("name", ["../../../x.png", "/etc/x.png", "a\0b.png", "x" * 300, ".png"])
def test_names_of_uploads_do_not_matter(server, attacker, name):
    path = Path(attacker.uploaded(DUCK, name.replace("\0", "")))
    assert path.parent.name == "uploads" and server.folder in path.parents


def test_nothing_is_fetched_for_anybody(attacker):
    for url in ("http://127.0.0.1:9/a.png", "https://example.com/a.png", "file:///etc/passwd"):
        file = {"path": url, "url": url, "meta": {"_type": "gradio.FileData"}}
        answer = attacker.generate(file)
        assert "error" in answer and "complete" not in answer.split("\n")[0], answer


# ---- what is too large --------------------------------------------------------------------------


def test_bodies_are_limited_however_they_come(server, attacker):
    large = bytes(4_000_000)
    assert attacker.upload(large)[0] == 413
    packed = "data:image/png;base64," + "A" * 3_000_000
    status, _, _ = attacker.post("/gradio_api/call/generate", {"data": [{"url": packed}]})
    assert status == 413
    for length in ("-1", "x", str(10**15)):
        connection = attacker.slow_socket(
            f"POST /gradio_api/upload HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: {length}"
            "\r\nConnection: close\r\n\r\n".encode()
        )
        connection.close()
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=TIMEOUT)
    connection.putrequest("POST", "/gradio_api/queue/join")
    connection.putheader("Transfer-Encoding", "chunked")
    connection.endheaders()
    try:
        for _ in range(100):
            connection.send(b"%x\r\n" % 100_000 + bytes(100_000) + b"\r\n")
        connection.send(b"0\r\n\r\n")
        assert connection.getresponse().status >= 400
    except OSError:
        pass  # It has hung up.
    finally:
        connection.close()


def test_many_files_in_one_request_are_refused(attacker):
    part = '--b\r\nContent-Disposition: form-data; name="files"; filename="a.png"\r\n\r\nx\r\n'
    kind = {"Content-Type": "multipart/form-data; boundary=b"}
    body = (part * 500 + "--b--\r\n").encode()
    assert attacker.send("POST", "/gradio_api/upload", body, kind)[0] == 400
    assert attacker.send("POST", "/gradio_api/upload", b"nonsense", kind)[0] == 400
    status, text, _ = attacker.send("POST", "/gradio_api/upload", b"{}", {})
    assert (status, text) == (200, "[]") or status == 400


def _scene(frames: int = 2, **changes: object) -> dict:
    """A scene as the page sends it: small videos from the front."""
    few = {"view.views": ["front"], "view.size": 64, "accuracy": "draft", "time.frames": frames}
    return Scene.named("drop").replaced({**few, **changes}).data()


def _as(kind: str, colour: str = "white") -> bytes:
    with io.BytesIO() as file:
        Image.new("RGB", (64, 64), colour).save(file, kind)
        return file.getvalue()


BILLION = encode(ball(10)).replace(b"element vertex 10\n", b"element vertex 1000000000\n")
ODD = {
    "bomb": (partial(bomb, 16_000), "million pixels"),
    "larger bomb": (partial(bomb, 30_000), "million pixels"),
    "empty": (b"", "empty"),
    "text": (b"hello " * 100, "not a PNG"),
    "half": (DUCK[:9000], "cut short"),
    "tiff": (_as("TIFF"), "not a PNG"),
    "gif": (_as("GIF"), "not a PNG"),
    "bmp": (_as("BMP"), "not a PNG"),
    "eps": (_as("EPS"), "not a PNG"),
    "svg": (
        b'<svg xmlns="http://www.w3.org/2000/svg"><script>alert(1)</script></svg>',
        "not a PNG",
    ),
    "heic bomb": (heic_claiming(30_000, 30_000), "million pixels"),
    "heic of a small name": (heic_claiming(64, 64), "broken"),
    "half a heic": (PHONE.read_bytes()[:900], "broken"),
    "file of a billion Gaussians": (BILLION, "states 1,000,000,000 Gaussians"),
    "one colour": (_as("PNG", "#808080"), "No object"),
    "another colour": (_as("JPEG", "#3366cc"), "No object"),
}


def _odd(kind: str) -> bytes:
    data = ODD[kind][0]
    return data() if callable(data) else data


@pytest.mark.parametrize("kind", ODD)
def test_odd_pictures_are_refused_with_a_message(attacker, kind):
    said = attacker.choose(attacker.uploaded(_odd(kind)))
    assert ODD[kind][1] in said
    assert "uploads" not in said and "/tmp" not in said


@pytest.mark.parametrize("option", ["side", "back", "depth"])
def test_a_refusal_names_the_picture_that_it_is_about(attacker, option):
    duck = {"path": attacker.uploaded(DUCK), "meta": {"_type": "gradio.FileData"}}
    for kind in ("text", "bomb", "empty", "heic bomb"):
        sent = {"path": attacker.uploaded(_odd(kind)), "meta": {"_type": "gradio.FileData"}}
        assert f"{option}: " in attacker.generate(duck, **{option: sent}), kind
    for none in ("x", {"url": "data:image/png;base64,*", "path": "a.png"}):
        assert f"{option}: " in attacker.generate(duck, **{option: none})


def test_several_pictures_in_a_jpeg_pass_no_limit(attacker):
    """Phones append a picture (MPO); its decoder is the same, and so are its limits."""
    many = file_of(Image.open(io.BytesIO(DUCK)).convert("RGB"), "JPEG", progressive=True)
    passes = many[many.index(b"\xff\xda") : -2] * 60
    both = file_of(
        Image.new("RGB", (9, 9)), "MPO", save_all=True, append_images=[Image.new("L", (9, 9))]
    )
    bomb = with_segment(many[:-2] + passes + b"\xff\xd9", 0xE2, segment_of(both, b"MPF\0"))
    assert "more than 100 passes" in attacker.choose(attacker.uploaded(bomb))


def test_odd_metadata_of_a_photograph_changes_nothing(attacker):
    photograph = Image.new("RGB", (64, 64), "white")
    photograph.paste((200, 40, 30), (20, 16, 44, 52))
    software = Entry(0x0131, 5, 1, bytes(8))
    exif = exif_of([upright(6), software])
    jpeg = with_segment(file_of(photograph, "JPEG", icc_profile=b"damaged"), 0xE1, exif)
    assert attacker.choose(attacker.uploaded(jpeg)) == "cut out"


def test_strokes_are_limited_and_no_picture_comes_with_them(attacker):
    path = attacker.uploaded(DUCK)
    assert attacker.choose(path) == "cut out"
    shown = {"picture": {"path": path}}
    stroke = {"keep": True, "width": 0.1, "points": [[0.5, 0.5]]}
    for strokes in (
        [stroke] * 1000,
        [{**stroke, "points": [[0, 0]] * 9000}],
        [{"layer": path}],
        "x",
    ):
        answer = attacker.press("picture", "correct", [shown, None], strokes=strokes)
        assert "cannot be read" in json.dumps(answer), answer
    status, _, _ = attacker.post("/gradio_api/component_server", {"fn_name": "accept_blobs"})
    assert status >= 400


# ---- scripts, names, frames ---------------------------------------------------------------------

SCRIPT = "<img src=x onerror=alert(1)>"


def test_nothing_that_is_pasted_becomes_a_script(attacker):
    for scene in ({SCRIPT: 1}, {"material": {"law": SCRIPT}}, {"description": SCRIPT, SCRIPT: 1}):
        shown = str(attacker.press("scene", "change", [None, scene, None, 1])[0])
        assert SCRIPT not in shown, shown


def test_the_page_runs_no_script_but_its_own(attacker):
    first, second = (attacker.get("/") for _ in range(2))
    for _, text, headers in (first, second):
        policy = headers["content-security-policy"]
        scripts = re.search(r"script-src ([^;]*)", policy)[1]
        assert "unsafe-inline" not in scripts and "*" not in policy
        nonce = re.search(r"'nonce-([^']+)'", scripts)[1]
        assert text.count("<script") == text.count(f'<script nonce="{nonce}"') > 1
        assert headers["x-content-type-options"] == "nosniff"
    assert first[2]["content-security-policy"] != second[2]["content-security-policy"]


def test_streams_are_not_held_back_by_proxies(server, attacker):
    with socket.create_connection(("127.0.0.1", server.port), timeout=TIMEOUT) as connection:
        connection.sendall(b"GET /gradio_api/heartbeat/abc HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        head = connection.recv(4000).decode().lower()
    assert "x-accel-buffering: no" in head and "nosniff" in head


def test_a_proxy_that_holds_answers_back_hides_no_progress(server):
    """The page only asks short questions, so there is nothing to be held back."""
    with in_front_of(server) as seen:
        visitor = Attacker(seen)
        declared = visitor.use_the_page(visitor.uploaded(DUCK), _scene(24, **{"material.E": 1e7}))
        assert {row["state"] for row in declared} >= {"running", "done"}
        drawn = [len(row["live"]) for row in declared if row["state"] == "running"]
        assert any(0 < count < 24 for count in drawn), drawn
        assert visitor.generate({"path": visitor.uploaded(FILE)}).startswith("complete")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_the_page_answers_to_no_foreign_name(attacker, host):
    assert attacker.get("/", Host=host)[0] in (400, 421)
    assert attacker.get("/health", Host="localhost:7860")[0] == 200


def test_other_sites_read_nothing(attacker):
    evil = {"Origin": "https://evil.example", "Access-Control-Request-Method": "POST"}
    for method in ("GET", "OPTIONS"):
        for path in ("/config", "/health", "/", "/gradio_api/upload", "/phy124/here"):
            headers = attacker.send(method, path, None, evil)[2]
            assert headers.get("access-control-allow-origin") in (None, ""), (method, path)


# ---- crowds -------------------------------------------------------------------------------------


def test_one_tiny_run_teaches_nothing(attacker):
    path = {"path": attacker.uploaded(FILE)}
    tiny = {"view.size": 16, "view.views": ["front"]}
    assert attacker.generate(path, preset="press", changes=tiny).startswith("complete")
    answer = attacker.generate(path, preset="bounce", frames=3)
    assert answer.startswith("complete"), answer


def test_tickets_displace_no_visitor(server):
    good = Attacker(server)
    good.choose(good.uploaded(DUCK))
    before = server.health()["visitors"]
    for _ in range(70):
        ticket = Attacker(server)
        answer = ticket.press("go", "click", [None, {}, None])
        assert answer[0]["state"] == "refused"
        assert good.is_known()
    assert server.health()["visitors"] <= before


def test_a_storm_of_cancels_stops_only_ones_own(server):
    good, bad = Attacker(server), Attacker(server)
    path = good.uploaded(FILE)
    with ThreadPoolExecutor(9) as pool:
        answer = pool.submit(good.generate, {"path": path})
        storm = [pool.submit(bad.press, "cancel", "click", []) for _ in range(40)]
        assert answer.result(TIMEOUT).startswith("complete")
        assert all(isinstance(each.result(TIMEOUT), list) for each in storm)


@pytest.mark.slow
def test_a_crowd_of_visitors_does_not_silence_health(server):
    delays, stop = [], threading.Event()

    def probe() -> None:
        while not stop.is_set():
            start = time.monotonic()
            server.health()
            delays.append(time.monotonic() - start)
            time.sleep(0.05)

    def visit(number: int) -> str:
        visitor = Attacker(server, cookie=False, address=f"10.0.0.{number}")
        visitor.get("/")
        return visitor.generate({"path": visitor.uploaded(DUCK)})

    probing = threading.Thread(target=probe)
    probing.start()
    with ThreadPoolExecutor(CROWD) as pool:
        answers = list(pool.map(visit, range(CROWD)))
    stop.set()
    probing.join()
    served = sum(answer.startswith("complete") for answer in answers)
    said = {answer[:200] for answer in answers if not answer.startswith("complete")}
    assert served > 3 and all("full" in s or "Too many" in s for s in said), (served, said)
    # Were a run, a cut-out or a film in its way, there would be one answer for each of them.
    assert len(delays) > 10 * served, f"{len(delays)} answers during {served} runs"


# ---- what is left -------------------------------------------------------------------------------


def test_slow_sockets_are_given_up(server, slow_sockets):
    for connection in slow_sockets:
        connection.settimeout(TIMEOUT)
        with contextlib.suppress(ConnectionResetError):
            while connection.recv(1000):
                pass


def test_slow_sockets_never_took_the_last_file(server):
    """Otherwise one burst could end the server while it starts."""
    assert "Too many open files" not in server.log.read_text()


def test_an_honest_visitor_is_served_after_all_that(server):
    visitor = Attacker(server)
    assert visitor.generate({"path": visitor.uploaded(FILE)}).startswith("complete")


def test_memory_stayed_within_bounds(server):
    assert server.peak_memory() < 1.5 * GIGABYTE


def test_nothing_of_anybody_is_left(server):
    server.until_idle()
    server.until(lambda: server.health()["visitors"] == 0, "everybody's leaving")
    visitors = server.folder / "visitors"
    server.until(lambda: {p.name for p in visitors.iterdir()} == {"arrivals"}, "an empty folder")
    server.until(lambda: server.threads() == 0, "an end of all threads")
