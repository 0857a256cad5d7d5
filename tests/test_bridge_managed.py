"""The managed node in the states of its lifecycle, against a double of rclpy."""

import os
import sys

import pytest

from bridge import managed, node
from support.clips import random_clip
from support.ros_double import Node, statuses, values

FRAMES = 5
PLAYED = ("configure", "activate")


@pytest.fixture
def clip(tmp_path):
    random_clip(frames=FRAMES, fps=1000).save(tmp_path / "clip.safetensors")
    return str(tmp_path / "clip.safetensors")


def manage(ros, clip, *steps, spins=40, **options):
    """Run the node through transitions and functions of the node, with spins between them."""
    Node.parameters = {"clip": clip, "loop": False, **options}
    done = []

    def take(step):
        def act(made):
            done.append(step(made) if callable(step) else (step, made.change_state(step)))

        return act

    for step in steps:
        ros.script += [take(step), *[lambda made: None] * spins]
    ros.script.append(lambda made: setattr(made.context, "over", True))
    managed.main()
    return ros.nodes[0], done


def sent(made):
    return len(made.publishers["points"].sent) if "points" in made.publishers else None


def test_each_state_does_what_its_name_says(ros, clip):
    steps = [sent, "configure", sent, "activate", sent, "deactivate", "cleanup", sent, "shutdown"]
    made, done = manage(ros, clip, *steps)
    transitions = ["configure", "activate", "deactivate", "cleanup", "shutdown"]
    assert [each for each in done if isinstance(each, tuple)] == [(t, True) for t in transitions]
    assert [each for each in done if not isinstance(each, tuple)] == [None, 0, FRAMES, None]
    assert made.state == "finalized" and made.destroyed
    assert ros.log == ["init", "shutdown"]


def test_inactive_node_refuses_commands_and_plays_on_later(ros, clip):
    answers = []

    def pause(made):
        answers.append(made.call("~/pause").message)

    def restart(made):
        answers.append(made.call("~/restart").message)
        return sent(made)

    _, done = manage(
        ros, clip, "configure", restart, "activate", "deactivate", pause, "activate", restart, sent
    )
    assert answers == ["The node is inactive: activate it first."] * 2 + [""]
    assert done[1] == 0 and done[-1] > done[-2]


def test_parameters_are_read_by_each_configure(ros, clip, tmp_path):
    random_clip(frames=2, fps=1000, count=7).save(tmp_path / "other.safetensors")

    def change(made):
        results = [made.param_set("clip", str(tmp_path / "other.safetensors"))]
        results.append(made.param_set("speed", 2))
        return all(result.successful for result in results)

    def speed(made):
        return values(statuses(made)[-1])["speed"]

    made, done = manage(ros, clip, *PLAYED, "deactivate", "cleanup", change, *PLAYED, sent, speed)
    assert done[4] is True and done[-2:] == [2, "2"]
    assert made.declared["speed"].value == 2.0


def test_parameters_that_are_set_while_inactive_are_kept(ros, clip):
    def slow_down(made):
        return made.param_set("speed", 0.5).successful

    def speed(made):
        return values(statuses(made)[-1])["speed"], made.declared["speed"].value

    _, done = manage(ros, clip, "configure", slow_down, "activate", speed)
    assert done[-1] == ("0.5", 0.5)


def test_failed_configure_says_why_and_can_be_repeated(ros, clip):
    def correct(made):
        return made.param_set("clip", clip).successful

    made, done = manage(ros, "none.safetensors", "configure", sent, correct, *PLAYED, sent)
    assert done == [("configure", False), None, True, *((t, True) for t in PLAYED), FRAMES]
    (line,) = [text for severity, text in made.logger.lines if severity == "ERROR"]
    assert "there is no such file" in line
    assert not made.declared["clip"].value.startswith("none")


def test_shutdown_of_the_active_node_ends_it(ros, clip):
    """The next frame is due before the subscriber has acknowledged the last one."""

    def subscribe(made):
        made.publishers["points"].subscriptions = 1

    made, done = manage(ros, clip, *PLAYED, subscribe, "shutdown", loop=True)
    assert done[-1] == ("shutdown", True)
    assert not [text for severity, text in made.logger.lines if severity in ("ERROR", "FATAL")]
    assert made.destroyed and list(made.services) == [(object, made.services["~/change_state"][1])]


@pytest.mark.skipif(os.name == "nt", reason="Windows protects a file that is mapped")
def test_a_clip_that_is_overwritten_ends_the_node(ros, clip):
    """Frames are read from the file; the end of a shorter file would be a bus error."""
    with pytest.raises(SystemExit) as ended:
        manage(ros, clip, *PLAYED, lambda made: os.truncate(clip, 100), loop=True)
    assert ended.value.code == 1
    (line,) = [text for severity, text in ros.nodes[0].logger.lines if severity == "FATAL"]
    assert "Another program wrote into this file" in line


def test_wrong_parameter_ends_the_node_with_a_sentence(ros, clip, capsys):
    with pytest.raises(SystemExit) as ended:
        manage(ros, clip, speed=-1.0)
    assert ended.value.code == 1
    assert "speed = -1.0: It must lie between 0.01 and 100." in capsys.readouterr().err


@pytest.mark.parametrize("main", [node.main, managed.main])
def test_without_rclpy_a_node_says_where_it_comes_from(monkeypatch, capsys, main):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(SystemExit):
        main()
    assert "it comes with ROS 2, not from PyPI" in capsys.readouterr().err
