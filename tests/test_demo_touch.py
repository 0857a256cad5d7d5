"""Touch without a browser: tickets, the relay and its limits, and what travels to the browser."""

import json
import struct
from types import SimpleNamespace

import numpy as np
import pytest
from starlette.applications import Starlette
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from demo.catalogue import scene_of
from demo.guard import COOKIE, Doorkeeper
from demo.settings import Settings
from demo.touch import Table, lattice, relay, socket_route
from demo.touch.lattice import Lattice, Walls
from demo.touch.player import BINDING, FRAME, HEAD, Player, play
from demo.touch.table import FORCES, limits_of, shorten_session
from phy124.errors import InputError
from phy124.generators.shapes import ball
from phy124.imaging.painted import WHOLE
from phy124.live import Live
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Stopped
from support import touching

pytestmark = pytest.mark.usefixtures("coarse_solids")

ORDER = SimpleNamespace(gaussians=1000, scene=SimpleNamespace(names=["object"]))
ME, OTHER = "a" * 32, "b" * 32
HOME = {"origin": "http://testserver"}


@pytest.fixture
def page(monkeypatch):
    """A page with nothing but the socket; `page.process` is what runs in the other process."""
    monkeypatch.setattr(relay, "Play", lambda order, most: order)
    made = {}

    def start(process=touching.echo, **settings):
        monkeypatch.setattr(relay, "play", process)
        chosen = Settings(**settings)
        table = Table(chosen.max_touch)
        app = Doorkeeper(Starlette(routes=[socket_route(table, chosen)]), frozenset({"testserver"}))
        made["client"] = TestClient(app).__enter__()
        return table, made["client"]

    yield start
    made["client"].__exit__(None, None, None)


def touched(client, table, visitor=ME, ticket=None, headers=HOME):
    ticket = table.give(f"cookie {visitor}", ORDER) if ticket is None else ticket
    cookie = {"cookie": f"{COOKIE}={visitor}", **headers}
    return client.websocket_connect(f"/phy124/touch/{ticket.name}", headers=cookie)


def said(socket) -> str:
    return json.loads(socket.receive_text())["text"]


def test_a_slow_browser_gets_the_newest_frame_and_no_queue(page):
    table, client = page(touching.flood)
    with touched(client, table) as socket:
        assert socket.receive_bytes() == BINDING + b"binding"
        got, word = [], None
        while word is None:
            message = socket.receive()
            word = message.get("text")
            if word is None:
                got.append(message["bytes"])
        assert len(got) <= relay.ON_THE_WAY, "it has acknowledged none"
        for wrong in (None, "many", -5, 0):
            socket.send_text(json.dumps({"do": "seen", "value": wrong}))
        # It has drawn the second and left out the first.
        socket.send_text(json.dumps({"do": "seen", "value": len(got)}))
        last = socket.receive_bytes()
        assert last[:1] == FRAME and struct.unpack("<I", last[1:5]) == (touching.FRAMES - 1,)


def test_a_crash_is_a_sentence_and_frees_the_place(page):
    table, client = page(touching.crash, max_touch=1)
    with touched(client, table) as socket:
        assert socket.receive_bytes() == BINDING + b"binding"
        assert said(socket) == relay.BROKEN
        with pytest.raises(WebSocketDisconnect):
            socket.receive_text()
    assert len(table) == 0


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [({"touch_idle_minutes": 1e-3}, relay.IDLE), ({"touch_minutes": 1e-3}, relay.OVER)],
)
def test_a_run_ends_when_its_time_is_up(page, settings, sentence):
    table, client = page(**settings)
    with touched(client, table) as socket:
        texts = [said(socket)]
        while texts[-1] in ("ready",):
            texts.append(said(socket))
        assert texts[-1] == sentence.format(*settings.values())


def test_invalid_and_thousands_of_orders_do_no_harm(page, monkeypatch):
    monkeypatch.setattr(relay, "PER_SECOND", 0.0)
    table, client = page()
    with touched(client, table) as socket:
        assert said(socket) == "ready"
        for bad in ("", "{", "[" * 900, '"grab"', '{"do": "delete"}', '{"do": ["to"]}', "x" * 2000):
            socket.send_text(bad)
            assert said(socket) == relay.NOT_UNDERSTOOD
        socket.send_bytes(b"\xff\x00")
        assert said(socket) == relay.NOT_UNDERSTOOD
        for _ in range(1000):
            socket.send_text('{"do": "pause"}')
        assert said(socket) == relay.TOO_MANY
        monkeypatch.setattr(relay, "PER_SECOND", 1e9)
        socket.send_text('{"do": "to", "value": 3}')
        assert said(socket) == "to 3"


def test_run_is_reachable_only_for_its_visitor(page):
    table, client = page(max_touch=2)
    mine = table.give(f"cookie {ME}", ORDER)
    for visitor, ticket in ((OTHER, mine), (ME, type(mine)("", None))):
        with (
            pytest.raises(WebSocketDisconnect) as end,
            touched(client, table, visitor, ticket) as socket,
        ):
            socket.receive_text()
        assert end.value.code == relay.GONE
    for headers in ({"origin": "http://evil.example"}, {}, {"origin": "null"}):
        with pytest.raises(WebSocketDisconnect), touched(client, table, ME, mine, headers):
            pass
    with touched(client, table, ME, mine) as socket, touched(client, table, OTHER) as second:
        assert said(socket) == said(second) == "ready"
        with pytest.raises(InputError, match="cannot run more live runs"):
            table.give("cookie third", None)
        socket.send_text('{"do": "save"}')
        assert said(socket) == "save None"
        assert table.ticket_of(f"cookie {ME}").session == {"forces": []}
        assert table.ticket_of(f"cookie {OTHER}").session is None
        table.give(f"cookie {ME}", None)
        assert said(socket) == relay.REPLACED
        second.send_text('{"do": "to", "value": 3}')
        assert said(second) == "to 3"


def test_unused_tickets_take_no_place(monkeypatch):
    table = Table(1)
    for number in range(9):
        table.give(f"idle {number}", ORDER)
    mine, other = table.give("me", ORDER), table.give("you", ORDER)
    assert table.take("me", mine.name) is mine
    for try_it in (lambda: table.give("third", ORDER), lambda: table.take("you", other.name)):
        with pytest.raises(InputError, match="cannot run more live runs"):
            try_it()
    table.over(mine)
    assert table.take("you", other.name) is other
    table.leave("you")
    monkeypatch.setattr("demo.touch.table.WAITS", -1)
    table.give("last", ORDER)
    assert len(table) == 1, "the others are lost"


def test_visitor_without_a_free_place_is_notified(page):
    table, client = page(max_touch=1)
    tickets = [table.give(f"cookie {visitor}", ORDER) for visitor in (ME, OTHER)]
    with touched(client, table, ME, tickets[0]) as socket:
        assert said(socket) == "ready"
        with touched(client, table, OTHER, tickets[1]) as second:
            assert "cannot run more live runs" in said(second)


class Spoken:
    """A line of which everything is kept."""

    def __init__(self) -> None:
        self.sent, self.orders = [], []

    def tell(self, letter, content):
        self.sent.append((letter, content))

    def take_messages(self):
        result, self.orders = self.orders, []
        return result

    def wait(self, seconds):
        pass


def small(**changes) -> Scene:
    base = Scene.named("drop").replaced({"accuracy": {"cells": 8}, "binding": "lattice"})
    return base.replaced({"object.lift": 0.1, **changes})


@pytest.fixture(scope="module")
def live():
    run = Live(ball(400), small(), RunContext(threads=1))
    run.step()
    return run


def bound(sent: bytes, splats: int, nodes: int) -> dict[str, np.ndarray]:
    """The arrays of a binding, as the browser reads them."""
    kinds = [
        ("means", "<f4", splats, 3),
        ("sigma", "<f4", splats, 6),
        ("stretch", "<f4", splats, 1),
        ("rest", "<f4", nodes, 3),
        ("near", "<u2", splats, 8),
        ("weights", "u1", splats, 8),
        ("colours", "u1", splats, 4),
    ]
    results = {}
    for name, kind, rows, columns in kinds:
        size = rows * columns * np.dtype(kind).itemsize
        results[name] = np.frombuffer(sent[:size], kind).reshape(rows, columns)
        sent = sent[size:]
    assert not sent
    return results


def test_browser_binding_matches_the_engine(live):
    made = Lattice(live)
    arrays = bound(made.binding(), len(made.gaussians), len(made.nodes))
    live.push((0, 300, 100), torque=(100, 0, 0), seconds=0.1)
    frame = list(live.frames(3))[-1]
    sent = made.frame()
    p = len(made.nodes)
    assert len(sent) == 24 + 24 * p
    box = np.frombuffer(sent[:24], "<f4").reshape(2, 3)
    steps = np.frombuffer(sent[24 : 24 + 6 * p], "<u2").reshape(p, 3)
    F = np.frombuffer(sent[24 + 6 * p :], "<i2").reshape(p, 3, 3) * (lattice.REACH / 32767)
    x = box[0] + steps / 65535 * (box[1] - box[0])
    near = arrays["near"]
    weights = arrays["weights"] / arrays["weights"].sum(axis=1, keepdims=True)
    away = np.einsum("nkij,nkj->nki", F[near], arrays["means"][:, None] - arrays["rest"][near])
    means = (weights[..., None] * (x[near] + away)).sum(axis=1)
    order = np.random.default_rng(0).permutation(len(means))
    moved = np.abs(frame.gaussians.means - live.look.gaussians.means).max()
    assert moved > 0.02
    assert np.abs(means - frame.gaussians.means[order]).max() < 1e-3


def test_a_frame_stays_below_three_megabytes_a_second(live):
    few = Lattice(live, most=60)
    assert 30 <= len(few.nodes) <= 60 and np.allclose(few.weights.sum(axis=1), 1, atol=1e-3)
    assert 24 * (24 + 24 * lattice.MOST + HEAD.size) <= 3e6


def test_walls_are_where_the_scene_has_them_and_move_with_it():
    boundaries = [
        {"kind": "ground", "height": -0.1},
        {
            "kind": "sphere",
            "centre": [0, 2, 0.3],
            "radius": 0.2,
            "friction": 0.1,
            "motion": {"kind": "path", "points": [[0, 0, 0], [0, -1, 0]], "smooth": False},
        },
        {"kind": "held", "lower": [-9, -9, -9], "upper": [9, 9, 0.1], "end": 0.05},
    ]
    rest = ball(100).means.astype(float)
    still = {"rest": rest, "bodies": {"": rest}, "time": 0.0}
    run = SimpleNamespace(scene=small(boundaries=boundaries), **still)
    walls = Walls(run)
    assert walls.floor == pytest.approx(-0.1)
    sphere, clamp = walls.data()
    assert sphere["centre"] == [0, 2, 0.3] and sphere["radius"] == 0.2 and clamp["radius"] == 0
    json.dumps(walls.data())
    assert np.allclose(np.frombuffer(walls.frame(), "<f4"), [-0.1, 0, 0, 0, 0, 0, 0])
    run.time = 0.25
    later = np.frombuffer(walls.frame(), "<f4")
    assert later[2] == pytest.approx(-0.25) and np.isnan(later[4:]).all(), "it has let go"
    alone = Walls(SimpleNamespace(scene=small(boundaries=[]), **still))
    assert alone.floor is None and alone.data() == []
    assert np.isnan(np.frombuffer(alone.frame(), "<f4")).all()


@pytest.fixture
def player(monkeypatch, tmp_path):
    monkeypatch.setattr("demo.touch.player.gaussians_of", lambda *_: ball(400))
    monkeypatch.setattr("demo.touch.player.made_gaussians", lambda order: tmp_path)
    monkeypatch.setattr("demo.touch.player.RealTime.wait", lambda self: 1.0)
    monkeypatch.setattr(
        "demo.touch.player.held_rate",
        lambda gaussians, scene, *_, **__: type("Choice", (), {"scene": scene, "sentence": "so"}),
    )
    extras = type("Extras", (), {"cut_views": lambda self, deadline: None})()
    order = SimpleNamespace(
        device="cpu",
        scene=small(),
        extras=extras,
        others=(),
        cut_views=extras.cut_views,
        gaussians=1000,
        crop=WHOLE,
    )
    line = Spoken()
    return Player(type("Play", (), {"order": order, "most": Settings(max_frames=4)})(), line), line


def test_masks_are_where_the_picture_has_them(player, monkeypatch):
    run, line = player
    crops = []

    def start(*sent, crop=WHOLE, **options):
        crops.append(crop)
        return Live(*sent, crop=crop, **options)

    monkeypatch.setattr("demo.touch.player.Live", start)
    run._what.order.crop = (0.1, 0.2, 0.5, 0.6)
    Player(run._what, line)
    assert crops == [(0.1, 0.2, 0.5, 0.6)]


def test_failed_simulation_is_reported(player, monkeypatch):
    run, line = player

    def fail():
        raise Stopped("frame 1 is not valid.")

    monkeypatch.setattr(run.live, "step", fail)
    monkeypatch.setattr("demo.touch.player.Player", lambda what, line: run)
    play(run._what, line)
    assert b'"ended"' in line.sent[-1][1] and b"not valid" in line.sent[-1][1]


def test_impossible_orders_are_reported_and_the_run_continues(player):
    run, line = player
    mars = [2.25e11, 0, 0]
    bad = [
        ("grab", None),
        ("grab", "x"),
        ("grab", [float("nan"), 0, 0]),
        ("grab", mars),
        ("grab", [10**400, 0, 0]),
        ("gravity", 1e30),
        ("gravity", {}),
        ("speed", float("nan")),
    ]
    line.orders = [json.dumps({"do": do, "value": value, "seq": 7}) for do, value in bad]
    run.frame()
    kinds = [letter for letter, _ in line.sent]
    assert kinds.count(b"t") - 2 == len(bad), "a sentence for each, after the two at the start"
    line.orders = [json.dumps({"do": "grab", "value": [0, 0, 1.0]})]
    run.frame()
    line.orders = [
        json.dumps({"do": "to", "value": at, "seq": 9}) for at in ([0, 0, 1.2], [1e30, 0, 0], mars)
    ]
    run.frame()
    assert "reduced to the limit" in line.sent[-2][1].decode(), "of three targets, the last"
    assert HEAD.unpack(line.sent[-1][1][: HEAD.size])[1] == 9
    x, F = run.live.particles
    assert np.isfinite(x).all() and np.isfinite(F).all()


def test_every_note_of_a_long_run_is_sent(player):
    run, line = player
    notes = [f"note {number}" for number in range(30)]
    for note in notes:
        run.live._note(note)
        run._tell_notes()
    assert [json.loads(content)["text"] for _, content in line.sent[-30:]] == notes


def test_a_saved_session_is_a_scene_no_longer_than_a_run_may_be(player):
    run, line = player
    for order in ({"do": "grab", "value": [0, 0, 1.0]}, None, None, None, None, {"do": "release"}):
        line.orders = [json.dumps(order)] if order else []
        run.frame()
    line.orders = ['{"do": "gravity", "value": 1.62}', '{"do": "save"}']
    count = run.live.count
    run.frame()
    assert run.live.count == count, "it pauses"
    session = Scene.from_data(json.loads(dict(line.sent)[b"s"]))
    assert session.time.frames == 4 and "the first" in line.sent[-1][1].decode()
    assert {force.kind for force in session.forces} == {"gravity", "grab"}
    assert shorten_session(session, Settings(max_frames=5)) is session
    line.orders = ['{"do": "reset"}']
    run.frame()
    assert run.live.count == 1


def test_a_session_that_cannot_be_saved_does_not_pause_the_run(player, monkeypatch):
    run, line = player

    def fail():
        raise InputError("session", "none", "It cannot be saved.", "Reset it.")

    monkeypatch.setattr(run.live, "session", fail)
    line.orders, count = ['{"do": "save"}'], run.live.count
    run.frame()
    assert b"cannot be saved" in line.sent[-2][1] and run.live.count == count + 1


def test_session_may_be_longer_than_a_run():
    page = Settings()
    assert limits_of(page, 100_000).max_frames == 277, "half of 1000 MB at 1.8 MB per frame"
    assert limits_of(page, 50_000).max_frames == 432, "18 s, a tenth of the longest run"
    assert limits_of(Settings(max_visitor_mb=1, max_frames=30), 50_000).max_frames == 30
    holds = [{"kind": "grab", "start": k / 24, "end": (k + 1) / 24} for k in range(FORCES + 9)]
    session = small(forces=holds, boundaries=[{"kind": "ground"}], time={"fps": 24, "frames": 80})
    kept = shorten_session(session, limits_of(page, 50_000))
    assert len(kept.forces) + 1 == FORCES and kept.time.frames == FORCES
    assert scene_of(kept.data(), limits_of(page, 50_000)) == kept
    with pytest.raises(InputError, match="at most 16"):
        scene_of(kept.replaced({"time.frames": 70}).data(), page)
