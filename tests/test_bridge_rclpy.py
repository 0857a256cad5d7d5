"""The rclpy sink and the node against a recording double; none of this has run on ROS here."""

import enum
import logging
import sys
import time
import types
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest
from bridge_clips import random_clip
from rosbags.typesys import Stores, get_typestore

from bridge import live, node
from bridge.options import Options
from bridge.player import Player
from bridge.sinks.rclpy import RclpySink, require_rclpy
from bridge.topics import POINTS
from phy124.errors import InputError

JAZZY = get_typestore(Stores.ROS2_JAZZY)
SOURCE = Path(__file__).parents[1] / "bridge" / "sinks" / "rclpy.py"
POLICIES = ("HISTORY", "DEPTH", "RELIABILITY", "DURABILITY", "LIVELINESS")


@dataclass
class Publisher:
    kind: type
    topic: str
    qos: SimpleNamespace
    overrides: list
    sent: list = field(default_factory=list)

    def publish(self, message):
        assert type(message) is bytes
        self.sent.append(message)


class Node:
    """What rclpy.node.Node does, as far as the sink uses it."""

    made: list  # set by the fixture
    parameters: dict

    def __init__(self, name, *, namespace):
        self.name = f"/{namespace}/{name}"
        self.context = SimpleNamespace(ok=lambda: not self.over)
        self.over = self.destroyed = False
        self.publishers, self.services, self.subscriptions = {}, {}, {}
        self.declared, self.log = {}, []
        self.made.append(self)

    def create_publisher(self, kind, topic, qos, *, qos_overriding_options):
        made = Publisher(kind, topic, qos, qos_overriding_options)
        self.publishers[topic] = made
        return made

    def create_service(self, kind, name, callback):
        self.services[name] = (kind, callback)

    def create_subscription(self, kind, topic, callback, qos):
        self.subscriptions[topic] = (kind, callback, qos)

    def declare_parameter(self, name, value, descriptor):
        assert type(value) in (str, float, int, bool, list), name
        assert descriptor.read_only
        self.declared[name] = self.parameters.get(name, value)

    def get_parameter(self, name):
        return SimpleNamespace(value=self.declared[name])

    def get_logger(self):
        return SimpleNamespace(info=self.log.append, fatal=self.log.append)

    def destroy_node(self):
        self.destroyed = True

    def call(self, service, **request):
        response = SimpleNamespace(success=None, message="")
        return self.services[service][1](SimpleNamespace(**request), response)


class Executor:
    """Runs one scripted callback per spin."""

    script: list  # set by the fixture

    def __init__(self, *, context):
        self.nodes, self.stopped = [], False

    def add_node(self, added):
        self.nodes.append(added)

    def spin_once(self, *, timeout_sec):
        assert timeout_sec >= 0
        time.sleep(min(timeout_sec, 0.001))
        if self.script:
            self.script.pop(0)(self.nodes[0])

    def shutdown(self):
        self.stopped = True


@pytest.fixture
def ros(monkeypatch):
    """Modules in the shape of ROS 2 Jazzy's Python packages."""
    state = SimpleNamespace(log=[], nodes=[], script=[])
    Node.made, Node.parameters, Executor.script = state.nodes, {}, state.script

    def module(name, **content):
        made = types.ModuleType(name)
        vars(made).update(content)
        monkeypatch.setitem(sys.modules, name, made)
        return made

    module(
        "rclpy",
        init=lambda args=None: state.log.append("init"),
        try_shutdown=lambda: state.log.append("shutdown"),
    )
    module("rclpy.node", Node=Node)
    module("rclpy.executors", SingleThreadedExecutor=Executor)
    module("rclpy.qos_overriding_options", QoSOverridingOptions=list)
    enums = {
        "HistoryPolicy": "KEEP_LAST KEEP_ALL",
        "ReliabilityPolicy": "RELIABLE BEST_EFFORT",
        "DurabilityPolicy": "TRANSIENT_LOCAL VOLATILE",
        "QoSPolicyKind": " ".join(POLICIES),
    }
    module(
        "rclpy.qos",
        QoSProfile=SimpleNamespace,
        **{name: enum.Enum(name, members) for name, members in enums.items()},
    )
    classes = {
        "sensor_msgs": "PointCloud2",
        "tf2_msgs": "TFMessage",
        "visualization_msgs": "MarkerArray",
        "rosgraph_msgs": "Clock",
        "std_msgs": "String",
    }
    for package, name in classes.items():
        module(f"{package}.msg", **{name: type(name, (), {})})
    module("rcl_interfaces.msg", ParameterDescriptor=SimpleNamespace)
    module("std_srvs.srv", Trigger=type("Trigger", (), {}))
    module("rosbag2_interfaces.srv", Seek=type("Seek", (), {}))
    return state


def test_topics_qos_and_bytes(ros):
    clip = random_clip()
    options = Options(epoch=1_700_000_000, ellipsoids=2, profile="viz")
    with RclpySink(options, clock=True) as sink:
        for frame in clip.frames():
            sink.write(frame)
    (made,) = ros.nodes
    assert made.name == "/phy124/player"
    sent = {topic: len(publisher.sent) for topic, publisher in made.publishers.items()}
    assert sent == {"/tf_static": 1, "points": 4, "ellipsoids": 4, "/clock": 4}
    qos = {
        topic: (p.qos.history.name, p.qos.depth, p.qos.reliability.name, p.qos.durability.name)
        for topic, p in made.publishers.items()
    }
    assert qos["points"] == ("KEEP_LAST", 5, "RELIABLE", "TRANSIENT_LOCAL")
    assert qos["/tf_static"] == ("KEEP_LAST", 1, "RELIABLE", "TRANSIENT_LOCAL")
    assert qos["/clock"] == ("KEEP_LAST", 1, "BEST_EFFORT", "VOLATILE")
    for publisher in made.publishers.values():
        assert [kind.name for kind in publisher.overrides] == list(POLICIES[:4])
        assert publisher.kind.__name__ in ("TFMessage", "PointCloud2", "MarkerArray", "Clock")
    cloud = JAZZY.deserialize_cdr(made.publishers["points"].sent[3], "sensor_msgs/msg/PointCloud2")
    assert (cloud.width, cloud.point_step, cloud.header.stamp.nanosec) == (50, 16, 100_000_000)
    clock = JAZZY.deserialize_cdr(made.publishers["/clock"].sent[3], "rosgraph_msgs/msg/Clock")
    assert clock.clock.nanosec == 100_000_000


def test_clean_shutdown_even_after_an_error(ros):
    with pytest.raises(KeyError), RclpySink():
        raise KeyError
    assert ros.log == ["init", "shutdown"]
    assert ros.nodes[0].destroyed


def test_publishing_while_ros_shuts_down_is_the_end_not_an_error(ros):
    def refuse(self, message):
        ros.nodes[0].over = True
        raise RuntimeError("publisher's context is invalid")

    with pytest.raises(KeyboardInterrupt), RclpySink() as sink:
        Publisher.publish, before = refuse, Publisher.publish
        try:
            sink.write(random_clip().frame(0))
        finally:
            Publisher.publish = before
    assert ros.log == ["init", "shutdown"]


def test_other_errors_of_publishing_are_not_hidden(ros):
    with pytest.raises(AssertionError), RclpySink() as sink:
        sink._publish(POINTS, "no bytes")


def test_node_ends_if_opening_fails(ros, monkeypatch):
    monkeypatch.setattr(Node, "create_service", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        RclpySink().__enter__()
    assert ros.log == ["init", "shutdown"]


def test_services_and_topic_command_playback(ros):
    clip, answers = random_clip(frames=30), []

    def call(service, **request):
        return lambda made: answers.append(made.call(service, **request))

    at = SimpleNamespace
    ros.script += [
        call("~/pause"),
        call("~/seek", time=at(sec=0, nanosec=500_000_000)),
        call("~/seek", time=at(sec=99, nanosec=0)),
        call("~/restart"),
        lambda made: made.subscriptions["command"][1](at(data="speed 100")),
        call("~/play"),
    ]
    player = Player(clip.times)
    with RclpySink() as sink:
        live.play(clip, sink, player)
    assert [answer.success for answer in answers] == [True, True, False, True, True]
    assert player.finished
    assert player.speed == 100
    services = {name: kind.__name__ for name, (kind, _) in ros.nodes[0].services.items()}
    assert services == {
        "~/play": "Trigger",
        "~/pause": "Trigger",
        "~/restart": "Trigger",
        "~/seek": "Seek",
    }


def test_refused_services_say_why(ros):
    with RclpySink() as sink:
        answer = ros.nodes[0].call("~/play")
        assert (answer.success, answer.message) == (False, "play: nothing is playing")
        del sink


def test_without_rosbag2_interfaces_there_is_no_seek(ros, monkeypatch, caplog):
    monkeypatch.setitem(sys.modules, "rosbag2_interfaces.srv", None)
    with RclpySink():
        assert "~/seek" not in ros.nodes[0].services
    assert "there is no service ~/seek" in caplog.text


def run_node(ros, tmp_path, stop_after, **parameters):
    path = tmp_path / "clip.safetensors"
    random_clip(frames=5, fps=1000).save(path)
    Node.parameters = {"clip": str(path), **parameters}
    ros.script += [lambda made: None] * stop_after
    ros.script.append(lambda made: setattr(made, "over", True))
    node.main()
    return ros.nodes[0]


def test_node_plays_the_clip_of_its_parameters_until_ros_ends(ros, tmp_path, caplog):
    caplog.set_level(logging.INFO)
    made = run_node(ros, tmp_path, 200, profile="viz", frame_id="world", loop=False, clock=True)
    assert len(made.publishers["points"].sent) == 5
    cloud = JAZZY.deserialize_cdr(made.publishers["points"].sent[0], "sensor_msgs/msg/PointCloud2")
    assert (cloud.header.frame_id, cloud.point_step) == ("world", 16)
    assert len(made.publishers["/clock"].sent) == 5
    assert "5 frames shown, 0 dropped because late" in caplog.text
    assert (ros.log, made.destroyed) == (["init", "shutdown"], True)


def test_every_option_is_a_parameter(ros, tmp_path):
    made = run_node(ros, tmp_path, 1)
    assert made.declared.keys() == {*node.PLAYBACK, *Options.model_fields}
    assert made.declared["max_points"] == 0
    assert made.declared["translation"] == [0.0, 0.0, 0.0]


def test_bad_parameters_end_the_node_with_a_sentence(ros, tmp_path):
    with pytest.raises(SystemExit):
        run_node(ros, tmp_path, 1, speed=-1.0)
    assert "The speed must lie between" in ros.nodes[0].log[0]
    assert ros.log == ["init", "shutdown"]


def test_missing_clip_ends_the_node_with_a_sentence(ros):
    with pytest.raises(SystemExit):
        node.main()
    assert "there is no such file" in ros.nodes[0].log[0]


def test_without_ros_it_says_what_to_do():
    with pytest.raises(InputError, match="Source your ROS 2 installation"):
        require_rclpy()


def test_the_sink_is_short_enough_to_be_read_whole():
    assert len(SOURCE.read_text().splitlines()) < 200
