"""Real DDS over loopback: a subscriber in a process of its own, built without the bridge."""

import json
import os
import signal
import subprocess
import sys
import time
import zlib
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.clips import random_clip

pytest.importorskip("cyclonedds")

from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from bridge import delivery, live
from bridge.cdr import ENCAPSULATION
from bridge.discovery import domain_id
from bridge.idl import encoded_type, idl_type, sample
from bridge.layout import points
from bridge.messages import type_hash
from bridge.options import LIVE_POINTS, LIVE_PROFILE, Options
from bridge.player import Player
from bridge.sinks.dds import DISCOVERY, DdsSink, quality
from bridge.topics import COMMAND
from phy124.errors import InputError

SUBSCRIBER = Path(__file__).parent / "support/bridge_subscriber.py"
EPOCH = 1_700_000_000
TIMEOUT = 300.0
"""Longest wait for the other process [s]."""


@contextmanager
def subscriber(domain, *arguments):
    """Another process that prints what it receives."""
    command = [sys.executable, SUBSCRIBER, "--domain", str(domain), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline()) == {"ready": True}
        yield process


def wait_for_match(process):
    """Wait until both processes know each other; what was sent before may be lost."""
    assert json.loads(process.stdout.readline()) == {"matched": True}


def received(process):
    lines = [json.loads(line) for line in process.stdout]
    return [line for line in lines if "crc" in line]


def wait_until(condition):
    deadline = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < deadline, "nothing was discovered"
        time.sleep(0.02)


def check_every_frame_arrives(domain, frames, count, profile="full", **playing):
    clip = random_clip(frames=frames, count=count)
    player = Player(clip.times, **playing)
    counting = ("--count", str(frames))
    with (
        DdsSink(Options(epoch=EPOCH, profile=profile)) as sink,
        subscriber(domain, *counting) as other,
    ):
        wait_until(sink.subscribers)
        wait_for_match(other)
        live.play(clip, sink, player)
        lines = received(other)
    assert (player.shown, player.dropped) == (frames, 0)
    assert [line["stamp"] for line in lines] == [
        EPOCH * 10**9 + round(when * 1e9) for when in clip.times
    ]
    for frame, line in zip(clip.frames(), lines, strict=True):
        assert line["crc"] == zlib.crc32(points(frame, profile or LIVE_PROFILE).tobytes())
        assert line["width"] == count


def test_two_processes(domain):
    # Patient, so that a busy machine cannot make it fail.
    check_every_frame_arrives(domain, frames=15, count=8192, lateness=TIMEOUT)


def test_the_end_waits_for_all_topics(domain):
    asked = []
    with DdsSink() as sink:
        sink._acknowledged_on = lambda topic, seconds: bool(asked.append(topic)) or True
    assert {*asked} == {topic.name for topic in sink._encoder.topics} | {
        topic.name for topic in (*sink._reports.topics, DISCOVERY)
    }


@pytest.mark.slow
@pytest.mark.parametrize("attempt", range(3))
def test_sixty_of_sixty_frames_of_the_live_defaults_at_30_hz(domain, attempt):
    check_every_frame_arrives(domain, frames=60, count=LIVE_POINTS, profile=None, lateness=TIMEOUT)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [2.0, 4.0])
def test_acknowledgements_do_not_limit_the_rate(domain, speed):
    """66 kB at 60 and at 120 Hz."""
    check_every_frame_arrives(domain, frames=90, count=4096, profile="viz", speed=speed)


def test_a_subscriber_that_hangs_neither_ends_nor_stops_the_show(domain, monkeypatch):
    """cyclonedds stumbles over its own word for a timeout while it waits for acknowledgements."""
    monkeypatch.setattr(delivery, "LONGEST_WAIT", 0.05)
    monkeypatch.setattr(delivery, "FAREWELL", 0.05)
    with subscriber(domain, "--quiet", "30") as other:
        with DdsSink(Options(epoch=EPOCH)) as sink:
            wait_until(sink.subscribers)
            other.send_signal(signal.SIGSTOP)
            os.waitpid(other.pid, os.WUNTRACED)  # until it has stopped
            for frame in random_clip(frames=12, count=100).frames():
                sink.write(frame)
        other.kill()
    # Five are kept; of twelve, seven were pushed out, and the rest was not got.
    assert sink._delivery.lost >= 5


def test_a_late_joiner_gets_the_last_five(domain):
    clip = random_clip(frames=12, count=4096)
    with DdsSink(Options(epoch=EPOCH, profile="full")) as sink:
        for frame in clip.frames():
            sink.write(frame)
        with subscriber(domain, "--count", "5") as other:
            lines = received(other)
    stamps = [EPOCH * 10**9 + round(when * 1e9) for when in clip.times]
    assert [line["stamp"] for line in lines] == stamps[-5:]


def test_a_string_command_pauses(domain):
    clip = random_clip(frames=60, count=256)
    player, deadline = Player(clip.times, loop=True), time.monotonic() + TIMEOUT

    def obey(text):
        live.command(player, text, time.monotonic())

    saying = ("--say", "6:pause", "--quiet", "1")
    with DdsSink(Options()) as sink, subscriber(domain, *saying) as other:
        wait_until(sink.subscribers)
        wait_for_match(other)
        while not player.paused:
            assert time.monotonic() < deadline, "no command came"
            sink.listen(player.wait(time.monotonic()), obey)
            if tick := player.due(time.monotonic()):
                sink.write(clip.frame(tick.index))
        lines = received(other)
    assert 6 <= len(lines) <= player.shown


def test_a_text_that_is_not_utf8_is_refused(domain, caplog):
    """The next message of the same peer is heard."""
    texts, kind = [], "std_msgs/msg/String"
    with DdsSink(Options()) as sink:
        peer = DomainParticipant(domain)
        topic = Topic(peer, "rt/phy124/command", encoded_type(kind))
        writer = DataWriter(peer, topic, qos=quality(COMMAND))
        wait_until(writer.get_matched_subscriptions)
        for text in (b"pa\xfcse\0", b"pause\0"):
            data = ENCAPSULATION + len(text).to_bytes(4, "little") + text
            writer.write(sample(kind, data))
        wait_until(lambda: sink.listen(0.02, texts.append) or texts)
    assert texts == ["pause"]
    assert "rt/phy124/command: a message cannot be decoded ('utf-8' codec" in caplog.text


def test_dds_entities_are_as_ros_2_expects(domain):
    """Mangled names, XCDR1, type hash, durability, and the node's name."""
    with DdsSink(Options(ellipsoids=1)):
        observer = DomainParticipant(domain)
        publications = BuiltinDataReader(observer, BuiltinTopicDcpsPublication)
        topic = Topic(observer, "ros_discovery_info", idl_type(DISCOVERY.type))
        discovery = DataReader(observer, topic, qos=quality(DISCOVERY))
        results = {}

        def complete():
            for sample in publications.take(20):
                results[sample.topic_name] = sample
            return len(results) == 6

        wait_until(complete)
        (info,) = discovery.take(1) or [discovery.take_one(timeout=60 * 10**9)]
    types = {
        "rt/phy124/points": "sensor_msgs/msg/PointCloud2",
        "rt/phy124/ellipsoids": "visualization_msgs/msg/MarkerArray",
        "rt/tf_static": "tf2_msgs/msg/TFMessage",
        "rt/phy124/player/status": "diagnostic_msgs/msg/DiagnosticStatus",
        "rt/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
        "ros_discovery_info": DISCOVERY.type,
    }
    assert results.keys() == types.keys()
    for name, kind in types.items():
        package, _, base = kind.split("/")
        sample = results[name]
        assert sample.type_name == f"{package}::msg::dds_::{base}_"
        assert sample.qos[Policy.Userdata].data == f"typehash={type_hash(kind)};".encode()
        kept = name != "rt/diagnostics"
        assert (sample.qos[Policy.Durability] == Policy.Durability.TransientLocal) is kept
        assert sample.qos[Policy.DataRepresentation].use_cdrv0_representation
    (node,) = info.node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/phy124", "player")
    written = {bytes(gid.data) for gid in node.writer_gid_seq}
    named = [name for name, sample in results.items() if sample.key.bytes in written]
    assert sorted(named) == sorted(types.keys() - {"ros_discovery_info"})


def test_a_second_node_of_the_same_name_is_warned_of(domain, monkeypatch, caplog):
    monkeypatch.setattr("bridge.reports.DIAGNOSTICS_EVERY", 0.02)

    def introduce(participant, name):
        gid = idl_type("rmw_dds_common/msg/Gid")(list(participant.guid.bytes))
        node = idl_type("rmw_dds_common/msg/NodeEntitiesInfo")("/phy124", name, [], [])
        topic = Topic(participant, DISCOVERY.name, idl_type(DISCOVERY.type))
        writer = DataWriter(participant, topic, qos=quality(DISCOVERY))
        writer.write(idl_type(DISCOVERY.type)(gid, [node]))
        return writer

    with DdsSink(Options()) as sink:
        sink.show(Player(random_clip().times))
        names = ["elsewhere", *["player"] * 4]
        others = [introduce(DomainParticipant(domain), name) for name in names]

        def counted():
            sink.listen(0.02, lambda text: None)
            return sink._namesakes() == 4

        wait_until(counted)
        wait_until(lambda: counted() and "another node /phy124/player" in caplog.text)
    assert len(others) == 5


def test_live_limit_holds(domain, caplog):
    with DdsSink(Options()) as sink:
        sink.write(random_clip(frames=1, count=40_000).frame(0))
    assert "Sending 32,768 of 40,000 Gaussians" in caplog.text


def test_own_configuration_is_honoured(domain, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS><Nonsense/></CycloneDDS>")
    with pytest.raises(InputError, match=r"DDS cannot start.*Check CYCLONEDDS_URI"):
        DdsSink().__enter__()


@pytest.mark.parametrize("text", ["-1", "233", "x", "1.5"])
def test_bad_domain(monkeypatch, text):
    monkeypatch.setenv("ROS_DOMAIN_ID", text)
    with pytest.raises(InputError, match="whole number from 0 to 232"):
        domain_id()


def test_default_domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "")
    assert domain_id() == 0
