"""The Foxglove websocket, seen by a client of a few lines (RFC 6455 and Foxglove's protocol)."""

import base64
import json
import os
import socket
import struct
import time
from contextlib import contextmanager

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from support.clips import random_clip

pytest.importorskip("foxglove")

from bridge import live
from bridge.layout import points
from bridge.messages import definition
from bridge.options import Options
from bridge.player import Player
from bridge.sinks.foxglove import FoxgloveSink
from phy124.errors import InputError

JAZZY = get_typestore(Stores.ROS2_JAZZY)
EPOCH = 1_700_000_000
TEXT, BINARY = 1, 2
MESSAGE_DATA, PLAYBACK_STATE, PLAYBACK_REQUEST = 1, 5, 3


class Client:
    """A websocket client that can subscribe and move the playback controls."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self.stream = self.socket.makefile("rb")
        assert b"101" in self.stream.readline()
        while self.stream.readline().strip():
            pass
        self.info = self.text("serverInfo")
        self.channels = {}

    def receive(self):
        """The next text message as an object, or binary message as bytes."""
        first, second = self.stream.read(2)
        length = second & 0x7F
        if length >= 126:
            form = ">H" if length == 126 else ">Q"
            (length,) = struct.unpack(form, self.stream.read(struct.calcsize(form)))
        payload = self.stream.read(length)
        return json.loads(payload) if first & 0x0F == TEXT else payload

    def text(self, op):
        while True:
            message = self.receive()
            if isinstance(message, dict) and message["op"] == op:
                return message

    def binary(self, opcode):
        while True:
            message = self.receive()
            if isinstance(message, bytes) and message[0] == opcode:
                return message[1:]

    def send(self, payload, kind):
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[i % 4] for i, byte in enumerate(payload))
        assert len(masked) < 126
        self.socket.sendall(bytes([0x80 | kind, 0x80 | len(masked)]) + mask + masked)

    def subscribe(self, *topics):
        while not set(topics) <= self.channels.keys():
            for channel in self.text("advertise")["channels"]:
                self.channels[channel["topic"]] = channel
        wanted = [{"id": i, "channelId": self.channels[t]["id"]} for i, t in enumerate(topics)]
        self.send(json.dumps({"op": "subscribe", "subscriptions": wanted}).encode(), TEXT)

    def control(self, playing, speed=1.0, seek=None, request="r1"):
        sought = struct.pack("<BQ", seek is not None, seek or 0)
        name = request.encode()
        body = struct.pack("<BBf", PLAYBACK_REQUEST, 0 if playing else 1, speed) + sought
        self.send(body + struct.pack("<I", len(name)) + name, BINARY)

    def data(self):
        """Subscription, log time and payload of the next message."""
        message = self.binary(MESSAGE_DATA)
        return *struct.unpack("<IQ", message[:12]), message[12:]

    def close(self):
        self.stream.close()
        self.socket.close()


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
    orders, deadline = [], time.monotonic() + 10
    while len(orders) < count:
        assert time.monotonic() < deadline
        sink.listen(0.05, orders.append)
    return orders


def test_a_viewer_gets_the_clip_to_the_last_bit():
    clip = random_clip()
    with connected(duration=0.1) as (sink, client):
        client.subscribe("/phy124/points", "/tf_static")
        # The newcomer is told the transform once the sink has noticed it.
        for _ in range(2):
            sink.listen(10.0, lambda text: None)
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
        sink.listen(10.0, lambda text: None)
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
        player = Player(np.arange(20) / 10)
        player.due(0.0)
        for text in ("seek 1.5", "play"):
            live.command(player, text, 0.0)
        player.due(0.0)
        sink.show(player)
        state = client.binary(PLAYBACK_STATE)
    status, now, speed, sought, length = struct.unpack("<BQfBI", state[:18])
    assert (status, now, speed) == (0, EPOCH * 10**9 + 1_500_000_000, 1.0)
    assert (sought, state[18 : 18 + length]) == (1, b"again")


def test_a_running_simulation_has_no_controls():
    with connected() as (sink, client):
        assert sink.monotonic
        assert "playbackControl" not in client.info["capabilities"]
        sink.show(Player(np.arange(2.0)))


def test_taken_port():
    sentence = r"cannot be opened.*choose another port"
    with FoxgloveSink(port=0) as first, pytest.raises(InputError, match=sentence):
        FoxgloveSink(port=first.port).__enter__()
