"""The rclpy sink and the nodes against a recording double; it behaves as rclpy did on Jazzy."""

import os
from types import SimpleNamespace

import pytest

from bridge import delivery, live
from bridge.backends import open_sink
from bridge.options import Options
from bridge.player import Player
from bridge.reports import CLOCK_RATE
from bridge.ros_node import require_rclpy
from bridge.sinks.rclpy import RclpySink
from bridge.steering.loop import FLOOD, _Listening, controls
from bridge.topics import POINTS, PUSH, Controls, Message, Service, contact
from phy124.errors import InputError
from support import ros_double
from support.clips import random_clip
from support.ros_double import POLICIES, Node, clouds, decoded, statuses, values
from support.steered import OPTIONS, steered, transform, wrench

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
    profiles = {topic: publisher.qos_profile for topic, publisher in made.publishers.items()}
    qos = {
        topic: (q.history.name, q.depth, q.reliability.name, q.durability.name)
        for topic, q in profiles.items()
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
    monkeypatch.setattr(delivery, "IN_BUFFERS", 0)
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


class Clock:
    """Time that passes only while somebody sleeps [s]."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    perf_counter = time = monotonic

    def sleep(self, seconds):
        self.now += seconds


@pytest.fixture
def clock(monkeypatch):
    """The time of the double and of what waits for it."""
    clock = Clock()
    waiting = ("bridge.delivery", "bridge.steering.loop")
    for module in (*waiting, "support.ros_double", "support.ros_double.node"):
        monkeypatch.setattr(f"{module}.time", clock)
    return clock


def heard_by_one(ros, topic):
    """Let somebody subscribe as soon as the first callback runs."""
    ros.script.append(lambda made: setattr(made.publishers[topic], "subscriptions", 1))


STREAMS = {
    "splats": (30, 30, 2, "splats"),
    "4,096 points at 60 Hz": (90, 60, 4096, "viz"),
    "4,096 points at 120 Hz": (90, 120, 4096, "viz"),
}


@pytest.mark.parametrize("settings", ["", "<CycloneDDS/>"])
@pytest.mark.parametrize("case", STREAMS)
def test_acknowledgements_do_not_limit_the_rate(case, settings, ros, clock, monkeypatch):
    """Also with the settings of a user, which leave Cyclone's heartbeat at 100 ms."""
    frames, fps, count, profile = STREAMS[case]
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    if settings:
        monkeypatch.setenv("CYCLONEDDS_URI", settings)
    clip = random_clip(frames=frames, fps=fps, count=count)
    player = Player(clip.times)
    with RclpySink(Options(profile=profile)) as sink:
        assert ros.nodes[0].heartbeat == (0.1 if settings else 0.01)
        heard_by_one(ros, sink._encoder.main.name.removeprefix("/phy124/"))
        live.play(clip, sink, player, clock=clock.monotonic)
    assert (player.shown, player.dropped, sink._delivery.lost) == (frames, 0, 0)
    assert os.environ.get("CYCLONEDDS_URI", "") == settings


def test_frames_larger_than_the_buffers_wait_for_heartbeats(ros, clock, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "<CycloneDDS/>")
    clip = random_clip(frames=12, fps=1000, count=20_000)
    with RclpySink(Options(profile="viz")) as sink:
        ros.nodes[0].publishers["points"].subscriptions = 1
        start = clock.now
        for frame in clip.frames():
            sink.write(frame)
    assert clock.now - start > 0.2 and sink._delivery.lost == 0


def test_depth_of_the_overrides_is_the_depth_of_the_delivery(ros, clock):
    Node.parameters = {"qos_overrides./phy124/points.publisher.depth": 9}
    with RclpySink(Options(profile="viz")) as sink:
        ros.nodes[0].publishers["points"].acked = False
        waited = []
        for frame in random_clip(frames=11, count=20_000).frames():
            before = clock.now
            sink.write(frame)
            waited.append(clock.now > before)
    assert waited == [False] * 9 + [True, False]


def test_the_clock_ticks_while_a_frame_waits_for_acknowledgement(ros, monkeypatch):
    monkeypatch.setattr(delivery, "LONGEST_WAIT", 0.2)
    monkeypatch.setattr(delivery, "FAREWELL", 0.0)
    monkeypatch.setattr(delivery, "IN_BUFFERS", 0)
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
        lambda made: made.subscriptions["command"].callback(at(data="speed 100")),
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
    result = decoded(made.publishers["/diagnostics"], kind)
    first, last = (values(array.status[0]) for array in (result[0], result[-1]))
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
        lambda made: made.subscriptions["command"].callback(SimpleNamespace(data="dance")),
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
    """The controls of a steered run, without a run."""
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
        made.subscriptions["~/push"].callback("a wrench")
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


def test_the_end_waits_for_the_static_transform(ros):
    with RclpySink() as sink:
        static = ros.nodes[0].publishers["/tf_static"]
        static.subscriptions = 1
        sink.write(random_clip().frame(0))
        assert not static.waits
    assert static.waits == pytest.approx([delivery.FAREWELL], abs=0.1)
    assert ros.nodes[0].publishers["~/status"].waits


def test_time_stamps_count_from_the_start_of_the_node(ros, monkeypatch):
    monkeypatch.setattr("bridge.encoder.time.time", lambda: 100.0 if ros.nodes else 1.0)
    with RclpySink(OPTIONS.model_copy(update={"epoch": None})) as sink:
        sink.write(random_clip().frame(0))
    assert clouds(ros.nodes[0])[0].header.stamp.sec == 100


@pytest.fixture
def listening(ros, clock):
    """A run that is steered over rclpy, and what it reads before a frame."""
    run = steered()
    offered = controls(run, OPTIONS, "", action=False)
    with RclpySink(OPTIONS, controls=offered) as sink:
        yield run, _Listening(run, sink), ros.nodes[0], clock


def ages(listening, *, hz, frame, frames=60):
    """Age of the newest pose that is used in each frame, which takes `frame` seconds [s]."""
    run, reading, made, clock = listening
    results, sent = [], clock.now
    for _ in range(frames):
        clock.sleep(frame)
        while sent + 1 / hz <= clock.now:
            sent += 1 / hz
            made.hear("/tf", transform("map", "tool", (sent, 0, 0)))
        before = clock.now
        reading.briefly()
        assert clock.now - before < max(0.03, 0.5 * frame), "reading takes too long"
        _, place = run.inputs._transforms._links["tool"]
        results.append(clock.now - place[0, 3])
    return results


@pytest.mark.parametrize("frame", [1 / 12, 1.0])
def test_poses_are_fresh_when_the_run_is_slow(listening, frame):
    assert max(ages(listening, hz=100, frame=frame)) < 0.06
    assert not listening[0].remarks.count


def test_a_flood_of_poses_is_read_for_a_bounded_time(listening):
    assert max(ages(listening, hz=7000, frame=1 / 24)) < 0.06
    assert listening[0].remarks.last == FLOOD


def test_twenty_wrenches_at_once_all_act(listening):
    run, reading, made, _ = listening
    run.advance()
    frames = [f"f{number}" for number in range(20)]
    for name in frames:
        made.hear("/tf", transform("phy124", name, (0, 0, 0.5)))
        made.hear("~/push", wrench((1, 0, 0), frame=name))
    reading.briefly()
    run.advance()
    assert sum(force.kind == "wrench" for force in run.live.session().forces) == 20
    assert not run.remarks.count
    made.hear("~/push", *(wrench((1, 0, 0)) for _ in range(65)))
    reading.briefly()
    assert run.remarks.last == FLOOD


def test_live_frames_do_not_wait_for_subscribers(listening, ros):
    _, reading, made, clock = listening
    points = made.publishers["points"]
    points.acked, before = False, clock.now
    for frame in random_clip(frames=12, count=30_000).frames():
        reading._sink.write(frame)
    assert clock.now == before and reading._sink._delivery.lost == 7
