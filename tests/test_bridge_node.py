"""The nodes, of a clip and of a running simulation, against a double of rclpy."""

import logging
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from bridge import node, parameters
from bridge.cameras import Cameras
from bridge.options import LIVE_POINTS, Options
from bridge.sinks.rclpy import RclpySink
from phy124.generators.extras import DepthMap
from phy124.generators.ply_file import Reading
from phy124.imaging.cutting import Cutting
from phy124.scene import Scene
from support.clips import random_clip
from support.ros_double import Node, clouds, decoded, statuses, values

FOREVER = 1000
"""Spins after which a test's script gives up."""
TIMEOUT = 300.0
"""Seconds after which a test that waits gives up."""


def run_node(ros, tmp_path, stop_after, script=(), **options):
    """The node `player` with these parameters, ended from outside after so many spins."""
    path = tmp_path / "clip.safetensors"
    random_clip(frames=5, fps=1000).save(path)
    Node.parameters = {"clip": str(path), **options}
    ros.script += [*script, *[lambda made: None] * stop_after]
    ros.script.append(lambda made: setattr(made.context, "over", True))
    node.main()
    return ros.nodes[0]


def refused(ros, tmp_path, **options):
    """The one line the node ends with."""
    with pytest.raises(SystemExit) as ended:
        run_node(ros, tmp_path, 1, **options)
    assert ended.value.code == 1
    assert ros.log == ["init", "shutdown"]
    (line,) = [text for severity, text in ros.nodes[0].logger.lines if severity == "FATAL"]
    assert "\n" not in line
    assert "http" not in line
    return line


def test_node_plays_the_clip_of_its_parameters_until_ros_ends(ros, tmp_path):
    made = run_node(ros, tmp_path, 200, profile="viz", frame_id="world", loop=False, clock=True)
    # A loaded machine may drop late frames.
    shown = len(made.publishers["points"].sent)
    cloud = clouds(made)[0]
    assert (cloud.header.frame_id, cloud.point_step) == ("world", 16)
    assert made.publishers["/clock"].sent
    report = f"{shown} frames shown, {5 - shown} dropped because late"
    assert ("INFO", report) in made.logger.lines
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
    """The value of `-p speed:=2`, which is an integer for ROS."""
    made = run_node(ros, tmp_path, 50, **{name: whole})
    assert made.publishers["points"].sent
    kept = made.declared[name].value
    numbers = kept if isinstance(kept, list) else [kept]
    assert kept == whole and {type(number) for number in numbers} == {float}
    assert not [line for line in made.logger.lines if line[0] == "FATAL"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"speed": -1.0}, "speed = -1.0: It must lie between 0.01 and 100."),
        ({"speed": 1000}, "speed = 1000: It must lie between"),
        ({"speed": "fast"}, "speed = fast: It takes a number. For example `-p speed:=1.0`."),
        ({"rate": -1.0}, "It must lie between 0 and 1000. The default is 0.0."),
        ({"clip": ""}, "clip = '': it is required. For example `-p clip:=/path/to/clip"),
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
        ({"qos_overrides./phy124/points.publisher.depth": "deep"}, "expecting type 'INTEGER'"),
    ],
)
def test_a_refusal_is_one_line_at_fatal(ros, tmp_path, arguments, sentence):
    assert sentence in refused(ros, tmp_path, **arguments)


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
    assert type(made.declared["speed"].value) is float, "2 is stored as 2.0"
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
            lambda made: made.subscriptions["command"].callback(SimpleNamespace(data="loop off")),
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
    (((program, *options), _),) = ros.init
    assert (program, options) == (
        "rclpy",
        ["--ros-args", "-r", "__ns:=/a", "-p", "speed:=50", "--"],
    )
    assert values(statuses(ros.nodes[0])[-1])["speed"] == "50"


def test_a_running_simulation_as_a_node(ros, monkeypatch):
    asked = []

    class Run:
        stopped, scene = None, Scene()

        def __init__(self, source, options):
            asked.append((source.name, options))

        def __len__(self):
            return 3

        def __iter__(self):
            yield from random_clip(frames=3, fps=1000).frames()

    monkeypatch.setattr(node, "LiveRun", Run)
    Node.parameters = {"source": "photo.png", "scene": "drop", "set": ["seed=1"], "profile": "viz"}
    Node.parameters |= {"floor": True, "crop": "-1,-1,-1,1,1,1"}
    Node.parameters |= {"pick": "0.2,0.7", "depth": "far.png", "near": "black", "steps": 10}
    node.simulation()
    ((name, options),) = asked
    assert (name, options.live, options.scene, options.set) == (
        "photo.png",
        True,
        "drop",
        ("seed=1",),
    )
    assert options.reading == Reading(floor=True, crop="-1,-1,-1,1,1,1")
    assert options.cutting == Cutting(pick="0.2,0.7") and options.effort.steps == 10
    assert options.depth == DepthMap(depth=Path("far.png"), near="black")
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
        stopped, scene = None, Scene()

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
    node.simulation()
    assert answers == [False, True, True, True, True, True] * 2
    (made,) = ros.nodes
    assert [cloud.width for cloud in clouds(made)] == [10, 10, 10]
    assert values(statuses(made)[-1])["speed"] == "2"


def test_cameras_of_a_simulation_use_the_scene_of_its_object(ros, monkeypatch):
    """The parts of an object are in the scene only when its file has been read."""
    read, clip = Scene().replaced({"view.distance": 8.0}), random_clip(frames=2, fps=1000)

    class Run:
        stopped, scene = None, Scene()

        def __init__(self, source, options):
            pass

        def __len__(self):
            return 2

        def __iter__(self):
            self.scene = read
            yield from clip.frames()

    monkeypatch.setattr(node, "LiveRun", Run)
    Node.parameters = {"source": "photo.png", "views": ["front"], "size": "32x24"}
    node.simulation()
    (made,) = ros.nodes
    *_, static = decoded(made.publishers["/tf_static"], "tf2_msgs/msg/TFMessage")
    place = static.transforms[-1].transform.translation
    with Cameras(Options(views=("front",)), read.data()) as cameras:
        (picture,) = cameras.look(clip.frame(0)).pictures
    assert picture.camera.eye == pytest.approx((place.x, place.y, place.z), rel=1e-3)
    assert len(made.publishers["~/camera/front/camera_info"].sent) == 2


def test_a_running_simulation_that_stops_early_says_so(ros, monkeypatch):
    class Run:
        stopped, scene = "The object left the grid.", Scene()

        def __init__(self, source, options):
            pass

        def __len__(self):
            return 3

        def __iter__(self):
            yield random_clip().frame(0)

    monkeypatch.setattr(node, "LiveRun", Run)
    Node.parameters = {"source": "photo.png"}
    with pytest.raises(SystemExit) as ended:
        node.simulation()
    assert ended.value.code == node.STOPPED_EARLY
    assert ros.nodes[0].logger.lines[-1][0] == "ERROR"
