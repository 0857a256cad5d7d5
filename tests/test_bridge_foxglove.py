"""The Foxglove websocket, seen by a client of a few lines."""

import json
import re
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from support.clips import random_clip
from support.foxglove_client import PLAYBACK_STATE, Client
from support.steered import steered

pytest.importorskip("foxglove")

from bridge import live
from bridge.encoder import FrameEncoder
from bridge.layout import points
from bridge.messages import definition
from bridge.options import Options
from bridge.player import Player
from bridge.sinks.foxglove import FoxgloveSink
from bridge.sinks.foxglove_clients import FLOOD, Clients, from_json, schema
from bridge.steering import loop
from bridge.steering.loop import controls
from bridge.steering.run import State
from bridge.topics import PUSH, Controls, full_name
from phy124.errors import InputError

HERE = Path(__file__).parent
JAZZY = get_typestore(Stores.ROS2_JAZZY)
EPOCH = 1_700_000_000


@contextmanager
def connected(**options):
    with FoxgloveSink(Options(epoch=EPOCH, profile="full"), port=0, **options) as sink:
        client = Client(sink.port)
        try:
            yield sink, client
        finally:
            client.close()


def heard(sink, count):
    """The next orders the sink passes on."""
    orders, deadline = [], time.monotonic() + 60
    while len(orders) < count:
        assert time.monotonic() < deadline
        sink.listen(0.05, orders.append)
    return orders


def wait_for_job(sink, obey):
    """Let the sink carry out the next request."""
    deadline = time.monotonic() + 60
    while sink._jobs.empty():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    sink.listen(0.0, obey)


def test_a_viewer_gets_the_clip_to_the_last_bit():
    clip = random_clip()
    with connected(duration=0.1) as (sink, client):
        client.subscribe("/phy124/points", "/tf_static")
        # The newcomer is told the transform once the sink has noticed it.
        for _ in range(2):
            sink.listen(60.0, lambda text: None)
        for frame in clip.frames():
            sink.write(frame)
        seen = []
        while sum(subscription == 0 for subscription, *_ in seen) < len(clip):
            seen.append(client.data())
        channel = client.channels["/phy124/points"]
    assert (channel["encoding"], channel["schemaName"]) == ("cdr", "sensor_msgs/msg/PointCloud2")
    assert channel["schema"] == definition("sensor_msgs/msg/PointCloud2")
    clouds = [(when, data) for subscription, when, data in seen if subscription == 0]
    assert len(clouds) == 4
    for frame, (when, data) in zip(clip.frames(), clouds, strict=True):
        cloud = JAZZY.deserialize_cdr(data, "sensor_msgs/msg/PointCloud2")
        np.testing.assert_array_equal(cloud.data, points(frame, "full").view(np.uint8))
        assert when == EPOCH * 10**9 + round(frame.time * 1e9)
    assert {subscription for subscription, *_ in seen} == {0, 1}


def test_a_newcomer_gets_the_latest_frame_of_a_paused_clip():
    with connected(duration=0.1) as (sink, client):
        sink.write(random_clip().frame(2))
        client.subscribe("/phy124/points")
        sink.listen(60.0, lambda text: None)
        _, when, _ = client.data()
    assert when == EPOCH * 10**9 + round(1e9 / 15)


def test_playback_controls_become_commands():
    with connected(duration=2.0) as (sink, client):
        assert "playbackControl" in client.info["capabilities"]
        times = client.info["dataStartTime"], client.info["dataEndTime"]
        assert [t["sec"] for t in times] == [EPOCH, EPOCH + 2]
        client.control(False, speed=0.5)
        assert heard(sink, 2) == ["speed 0.5", "pause"]
        client.control(True, seek=EPOCH * 10**9 + 1_500_000_000, request="again")
        assert heard(sink, 3) == ["speed 1.0", "seek 1.5", "play"]


def test_a_state_answers_a_request_that_was_carried_out():
    """No state has the request's identifier before, and a refused seek is not reported as done."""
    player = Player(np.arange(20) / 10, paused=True)

    def obey(text):
        refusal = live._attempt(lambda: live.command(player, text, 0.0))
        sink.show(player)
        return refusal

    def next_state():
        state = client.binary(PLAYBACK_STATE)
        status, now, speed, sought, length = struct.unpack("<BQfBI", state[:18])
        assert length == len(state[18:])
        return status, now - EPOCH * 10**9, speed, sought, state[18:].decode()

    with connected(duration=1.9) as (sink, client):
        sink.show(player)
        assert next_state() == (1, 0, 1.0, 0, "")
        for seek, name in ((1_500_000_000, "again"), (5_000_000_000, "beyond")):
            client.control(True, seek=EPOCH * 10**9 + seek, speed=2.0, request=name)
            sink.show(player)  # the server's thread may have received the request
            wait_for_job(sink, obey)
        states = [next_state() for _ in range(4)]
    done = (0, 1_500_000_000, 2.0)
    assert states[:2] == [(1, 0, 1.0, 0, ""), (*done, 1, "again")]
    assert states[2:] == [(*done, 0, ""), (*done, 0, "beyond")]


def test_a_running_simulation_has_no_controls():
    with connected() as (sink, client):
        assert sink.monotonic
        assert "playbackControl" not in client.info["capabilities"]
        sink.show(Player(np.arange(2.0)))


def test_taken_port():
    sentence = r"cannot be opened.*choose another one"
    with FoxgloveSink(port=0) as first, pytest.raises(InputError, match=sentence):
        FoxgloveSink(port=first.port).__enter__()


@pytest.mark.parametrize("port", [-1, 65536])
def test_port_out_of_range_is_refused(port):
    with pytest.raises(InputError, match="whole number up to 65535"):
        FoxgloveSink(port=port)


def quit_after(client, run):
    client.wait()
    run.state = State.QUITTING


def test_a_viewer_in_another_process_steers_a_run(monkeypatch):
    run, remarks = steered(paused=False), []
    monkeypatch.setattr(run.remarks, "add", remarks.append)
    offered = controls(run, Options(), "coarse", action=False)
    options = Options(epoch=EPOCH, profile="viz")
    with FoxgloveSink(options, port=0, controls=offered) as sink:
        command = [sys.executable, "-m", "support.foxglove_client", str(sink.port)]
        with subprocess.Popen(command, cwd=HERE, stdout=subprocess.PIPE, text=True) as client:
            # However the viewer ends, the run does, too.
            threading.Thread(target=lambda: quit_after(client, run), daemon=True).start()
            loop.steer(run, sink, options)
            assert client.stdout is not None
            said = json.loads(client.stdout.read())
    ok = {"result": {"result": 1, "error_message": ""}}
    assert said["pause"] == said["step"] == said["reset"] == said["quit"] == ok
    assert "must be a uint64" in said["wrong"] and said["cdr"] == "Unsupported encoding"
    assert 31 in said["features"]["features"]["features"] and said["contact"] > 60
    # Two topics, four messages that are none, and a wrench that is no number. How often the flood
    # is too fast for the sink's thread or for the run depends on the machine.
    assert len([s for s in remarks if s not in (FLOOD, loop.FLOOD)]) == 7


def test_ten_thousand_messages_are_skipped_with_one_line():
    refused, heard, jobs = [], [], []
    offered = Controls(node="live", heard={PUSH: heard.append}, refused=refused.append)
    clients = Clients(offered, jobs.append)
    clients.advertise(1, 1, "/phy124/live/push", "json")
    for strength in range(10_000):
        clients.message(1, 1, json.dumps({"wrench": {"force": {"z": strength}}}).encode())
    for job in jobs:
        job(None)
    clients.hear(lambda text: None)
    assert refused == [FLOOD] and len(jobs) == 2
    assert [message.wrench.force.z for message in heard] == [*range(9900, 10_000)]


def test_invalid_messages_are_refused_in_a_sentence():
    wrong = [b"{", b"[]", b'{"x": "1"}', b'{"y": true}', b'{"w": 1}', b"[" * 100_000]
    huge = b'{"x": 1%s}' % (b"0" * 400)
    for data in (*wrong, huge):
        with pytest.raises(InputError, match="Send JSON"):
            from_json("geometry_msgs/msg/Point", data)
    with pytest.raises(
        InputError, match=r"Time\.sec = 2147483648: it is outside the range of int32"
    ):
        from_json("builtin_interfaces/msg/Time", b'{"sec": 2147483648}')
    assert type(from_json("geometry_msgs/msg/Point", b'{"x": 100000000000000000000}').x) is float
    message = from_json("geometry_msgs/msg/PointStamped", b'{"point": {"y": 2}}')
    assert (message.header.frame_id, message.point.x, message.point.y) == ("", 0.0, 2)
    answer = schema("simulation_interfaces/msg/SimulatorFeatures")["properties"]
    assert answer["features"] == {"type": "array", "items": {"type": "integer"}}
    assert schema("geometry_msgs/msg/Point")["properties"]["x"] == {"type": "number"}


def test_the_layout_shows_what_a_run_has():
    import support.foxglove_layout as built

    text = built.SHIPPED.read_text(encoding="utf-8")
    assert text == built.text(), "run python tests/support/foxglove_layout.py"
    run = steered()
    offered = controls(run, Options(), "", action=False)
    topics = {*offered.published, *offered.heard, *FrameEncoder(Options()).topics}
    names = {full_name(each.name, offered.node) for each in (*topics, *offered.services)}
    used = re.findall(r'"(/phy124[\w/]*)', text)
    assert len(used) >= 10 and set(used) <= names
