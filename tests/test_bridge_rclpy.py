"""The rclpy sink and the nodes against a recording double; none of this has run on ROS here."""

import logging
import signal
import time
from types import SimpleNamespace

import pytest
from rosbags.typesys import Stores, get_typestore

from bridge import delivery, live, node, parameters
from bridge.backends import open_sink
from bridge.options import LIVE_POINTS, Options
from bridge.player import Player
from bridge.reports import CLOCK_RATE
from bridge.sinks.rclpy import RclpySink, require_rclpy
from bridge.topics import POINTS, Message
from phy124.errors import InputError
from phy124.generators.ply_file import Reading
from support import ros_double
from support.clips import random_clip
from support.ros_double import POLICIES, Node

JAZZY = get_typestore(Stores.ROS2_JAZZY)
FOREVER = 1000
"""Spins after which a test's script gives up."""
TIMEOUT = 20.0
"""Seconds after which a test that waits gives up."""


@pytest.fixture
def ros(monkeypatch):
    """A double of rclpy; what it has seen."""
    sigterm = signal.getsignal(signal.SIGTERM)
    yield ros_double.install(monkeypatch)
    signal.signal(signal.SIGTERM, sigterm)


def decoded(publisher, kind):
    return [JAZZY.deserialize_cdr(data, kind) for data in publisher.sent]


def clouds(made):
    return decoded(made.publishers["points"], "sensor_msgs/msg/PointCloud2")


def statuses(made):
    return decoded(made.publishers["~/status"], "diagnostic_msgs/msg/DiagnosticStatus")


def values(status):
    return {pair.key: pair.value for pair in status.values}


def test_topics_qos_and_bytes(ros):
    clip = random_clip()
    options = Options(epoch=1_700_000_000, ellipsoids=2, profile="viz")
    with RclpySink(options, clock=True) as sink:
        for frame in clip.frames():
            sink.write(frame)
    (made,) = ros.nodes
    assert made.get_fully_qualified_name() == "/phy124/player"
    sent = {topic: len(publisher.sent) for topic, publisher in made.publishers.items()}
    assert sent == {
        "/tf_static": 1,
        "points": 4,
        "ellipsoids": 4,
        "/clock": 0,
        "/diagnostics": 0,
        "~/status": 0,
    }
    qos = {
        topic: (p.qos.history.name, p.qos.depth, p.qos.reliability.name, p.qos.durability.name)
        for topic, p in made.publishers.items()
    }
    assert qos["points"] == ("KEEP_LAST", 5, "RELIABLE", "TRANSIENT_LOCAL")
    assert qos["/tf_static"] == ("KEEP_LAST", 1, "RELIABLE", "TRANSIENT_LOCAL")
    assert qos["~/status"] == ("KEEP_LAST", 1, "RELIABLE", "TRANSIENT_LOCAL")
    assert qos["/clock"] == ("KEEP_LAST", 1, "BEST_EFFORT", "VOLATILE")
    for publisher in made.publishers.values():
        assert [kind.name for kind in publisher.overrides] == list(POLICIES[:4])
    cloud = clouds(made)[3]
    assert (cloud.width, cloud.point_step, cloud.header.stamp.nanosec) == (50, 16, 100_000_000)


def test_clean_shutdown_even_after_an_error(ros):
    with pytest.raises(KeyError), RclpySink():
        raise KeyError
    assert ros.log == ["init", "shutdown"]
    assert ros.nodes[0].destroyed


def test_publishing_while_ros_shuts_down_is_the_end_not_an_error(ros):
    with pytest.raises(KeyboardInterrupt), RclpySink() as sink:
        ros.nodes[0].context.over = True
        sink.write(random_clip().frame(0))
    assert ros.log == ["init", "shutdown"]


def test_other_errors_of_publishing_are_not_hidden(ros):
    with pytest.raises(TypeError), RclpySink() as sink:
        sink._send(Message(POINTS, 0, "no bytes"))


def test_node_ends_if_opening_fails(ros, monkeypatch):
    monkeypatch.setattr(Node, "create_service", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        RclpySink().__enter__()
    assert ros.log == ["init", "shutdown"]


def test_the_last_frames_are_waited_for_on_every_way_out(ros):
    """Ctrl-C, too: ROS's own signal handlers would end the context, and the frames with it."""
    for way in (None, KeyboardInterrupt, ValueError):
        with pytest.raises(way or SystemExit), RclpySink() as sink:
            sink.write(random_clip().frame(0))
            raise way or SystemExit
        made = ros.nodes[-1]
        assert made.publishers["points"].waits[-1] > 0
    assert {options.name for _, options in ros.init} == {"NO"}


def test_frames_that_were_not_acknowledged_are_counted(ros, monkeypatch):
    monkeypatch.setattr(delivery, "PATIENCE", 0.3)
    monkeypatch.setattr(delivery, "FAREWELL", 0.2)
    waited = []
    with RclpySink() as sink:
        made = ros.nodes[0]
        points = made.publishers["points"]
        points.acked = False
        for frame in random_clip(frames=9).frames():
            sink.write(frame)
            waited.append(round(sum(points.waits), 2))
    # Five frames are kept, so the sixth waits; then nobody is there, and there is a last chance.
    assert waited == [0.0] * 5 + [waited[5]] * 4
    assert 0 < waited[5] < sum(points.waits)
    assert ("WARN", made.logger.lines[-1][1]) == made.logger.lines[-1]
    assert "it may lack 5 of them" in made.logger.lines[-1][1]
    assert sink._delivery.lost == 4 + 5


def test_the_clock_ticks_while_a_frame_waits_for_acknowledgement(ros, monkeypatch):
    monkeypatch.setattr(delivery, "PATIENCE", 0.2)
    monkeypatch.setattr(delivery, "FAREWELL", 0.0)
    clip = random_clip(frames=6)
    with RclpySink(clock=True) as sink:
        made = ros.nodes[0]
        made.publishers["points"].acked = False
        sink.show(Player(clip.times))
        for frame in clip.frames():
            sink.write(frame)
    assert len(made.publishers["/clock"].sent) > 2


def test_services_and_topic_command_playback(ros):
    clip, answers = random_clip(frames=30), []

    def call(service, **request):
        return lambda made: answers.append(made.call(service, **request))

    at = SimpleNamespace
    ros.script += [
        call("~/pause"),
        call("~/is_paused"),
        call("~/play_next"),
        call("~/seek", time=at(sec=0, nanosec=500_000_000)),
        call("~/seek", time=at(sec=99, nanosec=0)),
        call("~/toggle_paused"),
        call("~/is_paused"),
        call("~/play_next"),
        call("~/set_rate", rate=2.0),
        call("~/set_rate", rate=0.0),
        call("~/restart"),
        lambda made: made.subscriptions["command"][1](at(data="speed 100")),
        call("~/play"),
    ]
    player = Player(clip.times)
    with RclpySink() as sink:
        live.play(clip, sink, player)
    success = [answer.success for answer in answers if answer.paused is None]
    assert success == [True, True, True, False, None, False, True, False, True, True]
    assert [answer.paused for answer in answers if answer.paused is not None] == [True, False]
    assert player.finished
    assert player.speed == 100
    services = {name: kind.__name__ for name, (kind, _) in ros.nodes[0].services.items()}
    assert services == {
        "~/play": "Trigger",
        "~/pause": "Trigger",
        "~/restart": "Trigger",
        "~/seek": "Seek",
        "~/set_rate": "SetRate",
        "~/toggle_paused": "TogglePaused",
        "~/is_paused": "IsPaused",
        "~/play_next": "PlayNext",
    }


def test_without_rosbag2_interfaces_there_are_the_triggers(ros, monkeypatch):
    monkeypatch.setitem(ros_double.sys.modules, "rosbag2_interfaces.srv", None)
    with RclpySink():
        assert ros.nodes[0].services.keys() == {"~/play", "~/pause", "~/restart"}
    assert "there are no services ~/seek" in ros.nodes[0].logger.lines[0][1]


def test_status_is_sent_at_each_change(ros):
    clip = random_clip(frames=3)
    ros.script += [
        lambda made: made.call("~/pause"),
        lambda made: made.call("~/set_rate", rate=4.0),
        lambda made: made.call("~/play"),
    ]
    with RclpySink() as sink:
        live.play(clip, sink, Player(clip.times))
    seen = [(status.message, values(status)["speed"]) for status in statuses(ros.nodes[0])]
    changes = [("playing", "1"), ("paused", "1"), ("paused", "4"), ("playing", "4")]
    assert seen == [*changes, ("finished", "4")]


def test_diagnostics_count_what_was_shown_and_lost(ros, monkeypatch):
    monkeypatch.setattr("bridge.reports.DIAGNOSTICS_EVERY", 0.0)
    clip, (other,) = random_clip(frames=3), [("player", "/phy124")]
    Node.others = [other, ("player", "/elsewhere")]
    with RclpySink() as sink:
        made = ros.nodes[0]
        made.publishers["points"].subscriptions = 2
        live.play(clip, sink, Player(clip.times, speed=10))
    kind = "diagnostic_msgs/msg/DiagnosticArray"
    found = decoded(made.publishers["/diagnostics"], kind)
    first, last = (values(array.status[0]) for array in (found[0], found[-1]))
    assert (first["frames shown"], last["frames shown"]) == ("0", "3")
    assert (last["subscribers"], last["frames lost"]) == ("2", "0")
    assert {"real-time factor", "frames dropped", "position [s]"} <= last.keys()
    assert last["other nodes of this name"] == "1"
    warned = [text for severity, text in made.logger.lines if severity == "WARN"]
    assert len(warned) == 1
    assert "another node /phy124/player" in warned[0]


def test_the_clock_ticks_while_paused(ros):
    clip = random_clip(frames=3)
    player = Player(clip.times, paused=True)
    clock, spins = [], []

    def enough(made):
        clock[:] = decoded(made.publishers["/clock"], "rosgraph_msgs/msg/Clock")
        spins.append(made)
        if len(clock) < 5 and len(spins) < FOREVER:
            ros.script.append(enough)
        else:
            made.context.over = True

    ros.script.append(enough)
    with pytest.raises(KeyboardInterrupt), RclpySink(Options(epoch=100), clock=True) as sink:
        live.play(clip, sink, player)
    assert len(clock) >= 5
    assert {(tick.clock.sec, tick.clock.nanosec) for tick in clock} == {(100, 0)}
    assert CLOCK_RATE == 40


def test_refused_services_say_why(ros):
    clip = random_clip(frames=3)
    refused = []
    ros.script += [
        lambda made: made.call("~/pause"),
        lambda made: refused.append(made.call("~/play")),
        lambda made: made.subscriptions["command"][1](SimpleNamespace(data="dance")),
    ]
    with RclpySink() as sink:
        live.play(clip, sink, Player(clip.times))
    assert refused[0].success
    assert any("Known are: play, pause" in text for _, text in ros.nodes[0].logger.lines)


def run_node(ros, tmp_path, stop_after, script=(), **given):
    """The node `player` with these parameters, ended from outside after so many spins."""
    path = tmp_path / "clip.safetensors"
    random_clip(frames=5, fps=1000).save(path)
    Node.parameters = {"clip": str(path), **given}
    ros.script += [*script, *[lambda made: None] * stop_after]
    ros.script.append(lambda made: setattr(made.context, "over", True))
    node.main()
    return ros.nodes[0]


def refused(ros, tmp_path, **given):
    """The one line the node ends with."""
    with pytest.raises(SystemExit) as ended:
        run_node(ros, tmp_path, 1, **given)
    assert ended.value.code == 1
    assert ros.log == ["init", "shutdown"]
    (line,) = [text for severity, text in ros.nodes[0].logger.lines if severity == "FATAL"]
    assert "\n" not in line
    assert "http" not in line
    return line


def test_node_plays_the_clip_of_its_parameters_until_ros_ends(ros, tmp_path):
    made = run_node(ros, tmp_path, 200, profile="viz", frame_id="world", loop=False, clock=True)
    assert len(made.publishers["points"].sent) == 5
    cloud = clouds(made)[0]
    assert (cloud.header.frame_id, cloud.point_step) == ("world", 16)
    assert made.publishers["/clock"].sent
    assert ("INFO", "5 frames shown, 0 dropped because late") in made.logger.lines
    assert (ros.log, made.destroyed) == (["init", "shutdown"], True)


def test_every_option_is_a_parameter_with_a_description(ros, tmp_path):
    made = run_node(ros, tmp_path, 1)
    declared = {name for name in made.declared if not name.startswith("qos_overrides")}
    assert declared == {*parameters.CLIP, *parameters.RUNNING, *Options.model_fields}
    assert made.declared["max_points"].value == LIVE_POINTS
    assert made.declared["translation"].value == [0.0, 0.0, 0.0]
    assert all(made.descriptors[name].description for name in declared)
    writable = {name for name in declared if not made.descriptors[name].read_only}
    assert writable == {"speed", "rate", "loop", "max_points"}


@pytest.mark.parametrize(
    ("name", "whole"),
    [("speed", 2), ("rate", 10), ("epoch", 1_700_000_000), ("translation", [1, 0, 0])],
)
def test_whole_numbers_do_for_numbers(ros, tmp_path, name, whole):
    """What `-p speed:=2` gives: ROS makes an integer of it."""
    made = run_node(ros, tmp_path, 50, **{name: whole})
    assert made.publishers["points"].sent
    assert not [line for line in made.logger.lines if line[0] == "FATAL"]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"speed": -1.0}, "speed = -1.0: It must lie between 0.01 and 100."),
        ({"speed": 1000}, "speed = 1000: It must lie between"),
        ({"speed": "fast"}, "speed = fast: It takes a number. For example `-p speed:=1.0`."),
        ({"loop": 1}, "loop = 1: It takes true or false."),
        ({"max_points": 2.5}, "max_points = 2.5: It takes a whole number."),
        ({"translation": ["a"]}, "translation = ['a']: It takes a list of numbers."),
        ({"translation": [1, 2]}, "translation"),
        ({"clip": 3}, "clip = 3: It takes a text."),
        ({"clip": "none.safetensors"}, "there is no such file"),
        ({"frame_id": "/a"}, "frame_id = /a: tf2 refuses"),
        ({"rotation": [1, 0, 0, 0]}, "The order is x y z w"),
        (
            {"qos_overrides./phy124/points.publisher.reliability": "sure"},
            "ROS 2 refuses these overrides (Unexpected QoS override",
        ),
        (
            {"qos_overrides./phy124/points.publisher.depth": "deep"},
            "expecting type 'INTEGER'",
        ),
    ],
)
def test_a_refusal_is_one_line_at_fatal(ros, tmp_path, given, sentence):
    assert sentence in refused(ros, tmp_path, **given)


def test_parameters_can_be_set_while_it_runs(ros, tmp_path):
    asked = [("speed", 2), ("rate", 7.5), ("loop", False), ("max_points", 10)]
    bad = [("speed", 0.0), ("speed", "x"), ("max_points", -1), ("frame_id", "a")]
    done, refusals = [], []
    made = run_node(
        ros,
        tmp_path,
        300,
        [
            lambda made: done.extend(made.param_set(*each).successful for each in asked),
            lambda made: refusals.extend(made.param_set(*each) for each in bad),
            lambda made: made.call("~/restart"),
        ],
        rate=1000,
    )
    assert done == [True] * 4
    assert [result.successful for result in refusals] == [False] * 4
    assert "It takes a number" in refusals[1].reason
    last = values(statuses(made)[-1])
    assert (last["speed"], last["rate [Hz]"], last["loop"]) == ("2", "7.5", "False")
    assert clouds(made)[-1].width == 10


def test_the_parameters_follow_what_services_do(ros, tmp_path):
    made = run_node(
        ros,
        tmp_path,
        5,
        [
            lambda made: made.call("~/set_rate", rate=3.0),
            lambda made: made.subscriptions["command"][1](SimpleNamespace(data="loop off")),
        ],
    )
    assert made.get_parameter("speed").value == 3.0
    assert made.get_parameter("loop").value is False


def test_ctrl_c_at_any_moment_of_the_start_leaves_no_traceback(ros, tmp_path, capfd):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    ros.at_init = interrupt
    node.main()
    ros.at_init = lambda: None
    Node.start = staticmethod(interrupt)
    node.main()
    Node.start = staticmethod(lambda: None)
    run_node(ros, tmp_path, 0, [interrupt])
    assert ros.log == ["init", "shutdown"] * 3
    assert capfd.readouterr().err == ""


def test_arguments_that_ros_refuses_are_one_line(ros, capfd):
    def refuse():
        raise RuntimeError("Failed to parse global arguments\n, at ./src/rcl/arguments.c:415")

    ros.at_init = refuse
    with pytest.raises(SystemExit):
        node.main(["player", "--ros-args", "-p", "x"])
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("[FATAL] [player]: --ros-args = ")
    assert "Failed to parse global arguments" in line


def test_log_lines_go_to_the_node_at_their_level(ros):
    with RclpySink():
        for level in (logging.DEBUG, logging.INFO, logging.WARNING, logging.ERROR):
            logging.getLogger("phy124.anything").log(level, "%d things", level)
        logging.getLogger("bridge").critical("over")
    expected = [("INFO", "20 things"), ("WARN", "30 things"), ("ERROR", "40 things")]
    assert ros.nodes[0].logger.lines == [*expected, ("FATAL", "over")]


def test_the_command_line_takes_arguments_for_ros(ros, tmp_path):
    random_clip(frames=3, fps=1000).save(tmp_path / "clip.safetensors")
    Node.parameters = {"speed": 50, "loop": False}
    from bridge.__main__ import main

    arguments = ["play", str(tmp_path / "clip.safetensors"), "--backend", "rclpy"]
    assert main([*arguments, "--ros-args", "-r", "__ns:=/a", "-p", "speed:=50", "--"]) == 0
    (((program, *given), _),) = ros.init
    assert (program, given) == ("rclpy", ["--ros-args", "-r", "__ns:=/a", "-p", "speed:=50", "--"])
    assert values(statuses(ros.nodes[0])[-1])["speed"] == "50"


def test_rclpy_does_not_pretend_to_know_networks(ros):
    with pytest.raises(InputError, match="ROS_AUTOMATIC_DISCOVERY_RANGE"):
        open_sink("rclpy", Options(), network=True)


def test_a_running_simulation_as_a_node(ros, monkeypatch):
    asked = []

    class Run:
        stopped = None

        def __init__(self, source, options):
            asked.append((source.name, options))

        def __len__(self):
            return 3

        def __iter__(self):
            yield from random_clip(frames=3, fps=1000).frames()

    monkeypatch.setattr(node, "LiveRun", Run)
    Node.parameters = {"source": "photo.png", "scene": "drop", "set": ["seed=1"], "profile": "viz"}
    Node.parameters |= {"floor": True, "crop": "-1,-1,-1,1,1,1"}
    node.live()
    ((name, options),) = asked
    assert (name, options.live, options.scene, options.set) == (
        "photo.png",
        True,
        "drop",
        ("seed=1",),
    )
    assert options.reading == Reading(floor=True, crop="-1,-1,-1,1,1,1")
    (made,) = ros.nodes
    assert len(made.publishers["points"].sent) == 3
    assert made.get_parameter("generator").value == "relief"
    assert statuses(made)[-1].message == "finished"
    assert ("INFO", "All 3 frames were shown.") in made.logger.lines


def test_a_running_simulation_answers_while_it_computes(ros, monkeypatch):
    """Frame 1 is not there before services, parameters and the clock have been served."""
    answers = []

    def wait_until(condition):
        deadline = time.monotonic() + TIMEOUT
        while not condition():
            assert time.monotonic() < deadline, "nobody answers while a frame is computed"
            time.sleep(0.001)

    def in_the_meantime():
        (made,) = ros.nodes
        clock = made.publishers["/clock"]
        ticks = len(clock.sent)
        ros.script += [
            lambda made: answers.append(made.call("~/is_paused").paused),
            lambda made: made.call("~/toggle_paused"),
            lambda made: answers.append(made.call("~/is_paused").paused),
            lambda made: answers.append(made.call("~/set_rate", rate=3.0).success),
            lambda made: answers.append(made.param_set("speed", 2).successful),
            lambda made: answers.append(made.param_set("max_points", 10).successful),
            lambda made: answers.append(made.call("~/play").success),
        ]
        wait_until(lambda: not ros.script and len(clock.sent) >= ticks + 5)

    class Run:
        stopped = None

        def __init__(self, source, options):
            pass

        def __len__(self):
            return 3

        def __iter__(self):
            in_the_meantime()
            for frame in random_clip(frames=3, fps=1000).frames():
                if frame.index == 1:
                    in_the_meantime()
                yield frame

    monkeypatch.setattr(node, "LiveRun", Run)
    Node.parameters = {"source": "photo.png", "clock": True}
    node.live()
    assert answers == [False, True, True, True, True, True] * 2
    (made,) = ros.nodes
    assert [cloud.width for cloud in clouds(made)] == [10, 10, 10]
    assert values(statuses(made)[-1])["speed"] == "2"


def test_a_running_simulation_that_stops_early_says_so(ros, monkeypatch):
    class Run:
        stopped = "The object left the grid."

        def __init__(self, source, options):
            pass

        def __len__(self):
            return 3

        def __iter__(self):
            yield random_clip().frame(0)

    monkeypatch.setattr(node, "LiveRun", Run)
    with pytest.raises(SystemExit) as ended:
        node.live()
    assert ended.value.code == node.STOPPED_EARLY
    assert ros.nodes[0].logger.lines[-1][0] == "ERROR"


def test_without_ros_it_says_what_to_do():
    with pytest.raises(InputError, match="Source your ROS 2 installation"):
        require_rclpy()
