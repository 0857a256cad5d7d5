"""The rclpy sink and the nodes against a recording double; none of this has run on ROS here."""

from types import SimpleNamespace

import pytest

from bridge import delivery, live
from bridge.backends import open_sink
from bridge.options import Options
from bridge.player import Player
from bridge.reports import CLOCK_RATE
from bridge.sinks.rclpy import RclpySink, require_rclpy
from bridge.topics import POINTS, PUSH, Controls, Message, Service, contact
from phy124.errors import InputError
from support import ros_double
from support.clips import random_clip
from support.ros_double import POLICIES, Node
from support.ros_messages import clouds, decoded, statuses, values

FOREVER = 1000
"""Spins after which a test's script gives up."""
TIMEOUT = 20.0
"""Seconds after which a test that waits gives up."""


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
        sink.send(Message(POINTS, 0, "no bytes"))


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
    monkeypatch.setattr(delivery, "LONGEST_WAIT", 0.3)
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
    assert "it may have missed 5 of them" in made.logger.lines[-1][1]
    assert sink._delivery.lost == 4 + 5


def test_the_clock_ticks_while_a_frame_waits_for_acknowledgement(ros, monkeypatch):
    monkeypatch.setattr(delivery, "LONGEST_WAIT", 0.2)
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
    assert any("The commands are: play, pause" in text for _, text in ros.nodes[0].logger.lines)


def test_rclpy_does_not_pretend_to_know_networks(ros):
    with pytest.raises(InputError, match="ROS_AUTOMATIC_DISCOVERY_RANGE"):
        open_sink("rclpy", Options(), network=True)


def test_without_ros_it_says_what_to_do():
    with pytest.raises(InputError, match="Source your ROS 2 installation"):
        require_rclpy()


def standing():
    """What a steered run offers, without a run."""
    log = []

    def steps(count):
        for done in range(count):
            if "playing" in log:
                raise InputError("steps", count, "it is playing.", "Pause it first.")
            log.append(done)
            yield done + 1

    def step(request):
        return {"result": {"result": 1, "error_message": f"{request.steps} asked"}}

    heard = {PUSH: log.append}
    service = Service("~/step_simulation", "simulation_interfaces/srv/StepSimulation", step)
    published = (contact("ground"),)
    return log, Controls("live", published, heard, (service,), steps, clock=True)


def test_a_steered_run_has_its_topics_and_the_standard_services(ros):
    log, offered = standing()
    with RclpySink(Options(epoch=1.0), controls=offered) as sink:
        (made,) = ros.nodes
        sink.send(Message(contact("ground"), 0, b"bytes"))
        made.subscriptions["~/push"][1]("a wrench")
        response = SimpleNamespace(result=ros_double.simulation_result())
        kind, serve = made.services["~/step_simulation"]
        serve(SimpleNamespace(steps=3), response)
    assert made.get_fully_qualified_name() == "/phy124/live" and log == ["a wrench"]
    assert made.publishers["~/contact/ground"].sent == [b"bytes"] and "/clock" in made.publishers
    assert (kind.__name__, response.result.result) == ("StepSimulation", 1)
    assert response.result.error_message == "3 asked"


def driven(coroutine, each=lambda: None):
    """The result of a coroutine, with other callbacks in between."""
    while True:
        try:
            coroutine.send(None)
        except StopIteration as end:
            return end.value
        each()


def test_steps_as_an_action_can_be_cancelled_and_refused(ros):
    log, offered = standing()
    with RclpySink(Options(), controls=offered):
        _, execute, _ = ros.nodes[0].actions["~/simulate_steps"]
        goal = ros_double.GoalHandle(3)
        answer = driven(execute(goal))
        assert (goal.ended, answer.result.result) == ("succeeded", 1)
        assert goal.feedback == [(1, 2), (2, 1), (3, 0)]
        goal = ros_double.GoalHandle(9)
        answer = driven(execute(goal), lambda: setattr(goal, "is_cancel_requested", True))
        assert goal.ended == "canceled" and "after 2 of 9" in answer.result.error_message
        log.append("playing")
        goal = ros_double.GoalHandle(9)
        answer = driven(execute(goal))
    assert goal.ended == "aborted" and "Pause it first" in answer.result.error_message


def test_without_simulation_interfaces_there_are_triggers(ros, monkeypatch):
    monkeypatch.setitem(ros_double.sys.modules, "simulation_interfaces.srv", None)
    asked = []
    ros.script.append(lambda made: made.call("~/step"))
    ros.script.append(lambda made: made.call("~/reset"))
    with RclpySink(controls=standing()[1]) as sink:
        sink.listen(0.0, asked.append)
        sink.listen(0.0, asked.append)
        assert {"~/play", "~/pause", "~/step", "~/reset"} <= ros.nodes[0].services.keys()
    assert asked == ["next", "restart"]
    assert "apt install" in "".join(text for _, text in ros.nodes[0].logger.lines)
