"""Runs that are steered: states, steps and what peers do, without any middleware."""

import logging
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag2 import Reader

from bridge import info
from bridge.__main__ import main
from bridge.cameras import Cameras
from bridge.encoder import FrameEncoder
from bridge.recover import recover
from bridge.sinks.mcap import McapSink
from bridge.steering.inputs import Remarks
from bridge.steering.loop import contact_messages, controls, steer
from bridge.steering.run import State
from bridge.steering.standard import Code, Feature, Standard
from bridge.steering.transforms import Transforms
from bridge.topics import FACTOR
from phy124.errors import InputError
from phy124.generators.shapes import ball
from phy124.live import Live
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped, prepare
from support.ros_double import JAZZY
from support.steered import EPOCH, OPTIONS, WEIGHTLESS, point, scene, steered, transform, wrench

pytestmark = pytest.mark.usefixtures("coarse_solids")


def asked(**members):
    return SimpleNamespace(**members)


def state(number):
    return asked(state=asked(state=number))


def bytes_of(frame):
    return [message.data for message in FrameEncoder(OPTIONS).encode(frame)]


def test_steps_by_service_give_the_bytes_of_a_plain_run():
    run, seen = steered(), []
    run.show = lambda frame: seen.append(bytes_of(frame))
    run.advance()
    answers = [Standard(run, OPTIONS, action=False).step(asked(steps=steps)) for steps in (1, 4)]
    assert [answer["result"]["result"] for answer in answers] == [Code.OK, Code.OK]
    plain = Simulation(prepare(ball(400), scene(), RunContext(threads=1)))
    assert seen == [bytes_of(plain.step()) for _ in range(6)]


def test_states_and_resets():
    run, shown = steered(), []
    run.show = lambda frame: shown.append((frame.index, round(24 * frame.time)))
    standard = Standard(run, OPTIONS, action=True)

    def enter(number):
        return standard.set_state(state(number))["result"]["result"]

    run.advance()
    assert enter(State.PAUSED) == Code.ALREADY_IN_TARGET_STATE
    assert standard.step(asked(steps=2))["result"]["result"] == Code.OK
    assert enter(State.PLAYING) == Code.OK and not run.paused
    refused = standard.step(asked(steps=1))["result"]
    assert (
        refused["result"] == Code.OPERATION_FAILED and "Pause it first" in refused["error_message"]
    )
    assert enter(5) == Code.FEATURE_UNSUPPORTED
    # Time, the object, both.
    for scope in (1, 2, 255):
        assert standard.reset(asked(scope=scope))["result"]["result"] == Code.OK
        run.advance()
    for scope in (4, 5, 8):
        assert standard.reset(asked(scope=scope))["result"]["result"] == Code.FEATURE_UNSUPPORTED
    assert enter(State.STOPPED) == Code.OK and run.paused
    assert shown == [(0, 0), (1, 1), (2, 2), (3, 0), (0, 1), (1, 2), (0, 0), (1, 1), (0, 0)]
    assert standard.state(None)["state"] == {"state": State.STOPPED}
    assert enter(State.QUITTING) == Code.OK and run.finished
    features = standard.features(None)["features"]["features"]
    assert Feature.STEP_SIMULATION_ACTION in features
    assert len(Standard(run, OPTIONS, action=False).features(None)["features"]["features"]) == 13


def test_failed_simulation_ends_the_run(monkeypatch):
    run = steered()
    run.advance()

    def fail():
        raise Stopped("frame 1 is not valid.")

    monkeypatch.setattr(run.live, "step", fail)
    answer = Standard(run, OPTIONS, action=False).step(asked(steps=2))["result"]
    assert answer["result"] == Code.OPERATION_FAILED and "not valid" in answer["error_message"]
    run.enter(State.PLAYING)
    assert run.finished and run.stopped == "frame 1 is not valid." and run.shown == 1


def test_commands_are_those_of_the_services():
    run = steered()
    run.advance()
    for text in ("step 2", "next", "toggle", "speed 0.5", "pause"):
        run.command(text)
    assert (run.shown, run.paused, run.speed) == (4, True, 0.5)
    run.command("restart")
    assert run.position == 0 and run.live.count == 1
    for text in ("dance", "step", "step nan", "step -1", "step 1e400", "step 1.5", "seek 1"):
        with pytest.raises(InputError):
            run.command(text)
    with pytest.raises(InputError) as refused:
        run.command("x" * 5000)
    assert len(str(refused.value)) < 200


def test_a_wrench_acts_until_it_is_replaced_or_over():
    run = steered(changes=WEIGHTLESS)
    places = []
    run.show = lambda frame: places.append(run.live.centre)
    run.advance()
    for _ in range(3):
        run.inputs.push(wrench((0, 0, 60), frame="phy124_com"))
        run.advance()
    for _ in range(5):
        run.advance()
    speeds = np.diff(places, axis=0)[:, 2] * 24
    expected = 60 * (2 / 24 + 0.1) / run.live.limits.mass
    assert speeds[-1] == pytest.approx(expected, rel=2e-3)
    assert speeds[-2] == pytest.approx(speeds[-1], rel=1e-3)


def test_a_wrench_acts_at_its_frame_and_along_its_axes():
    run = steered(changes=WEIGHTLESS)
    run.advance()
    half = np.sqrt(0.5)
    run.inputs.transform(transform("phy124", "arm", (0, 0, 0.5), (0, 0, half, half)))
    run.inputs.transform(transform("arm", "tool", (0.45, 0, 0)))
    run.inputs.push(wrench((60, 0, 0), frame="tool"))
    run.advance()
    (force,) = run.live.session().forces
    # A quarter turn about z: the tool's x is the world's y.
    assert np.allclose(force.force, (0, 60, 0)) and force.point[1] == pytest.approx(0.45, abs=0.1)
    assert not run.remarks.count


def test_a_grab_holds_until_a_message_without_a_frame():
    run = steered(changes=WEIGHTLESS)
    run.advance()
    run.inputs.grab(point((0, 0, 0.9)))
    run.advance()
    assert run.live.holds
    for step in range(6):
        run.inputs.grab(point((0, 0.05 * step, 0.9), frame="map"))
        run.advance()
    assert run.live.holds and run.live.centre[1] > 0.01
    run.inputs.grab(point((0, 0, 0), frame=""))
    run.advance()
    assert not run.live.holds and not run.remarks.count
    assert len(run.live.session().forces[0].targets) == 8


def test_a_grab_ends_when_its_controller_is_silent():
    run = steered(changes=WEIGHTLESS, grab_seconds=0.2)
    run.advance()
    held = []
    for frame in range(9):
        if frame < 3:
            run.inputs.grab(point((0, 0, 0.9)))
        run.advance()
        held.append(run.live.holds)
    # The last message comes with frame 2, and 0.2 s are 4.8 frames.
    assert held == [True] * 7 + [False] * 2
    assert "no message came for 0.2 s" in run.remarks.last


def stamped(message, seconds):
    message.header.stamp = SimpleNamespace(sec=int(seconds), nanosec=0)
    return message


@pytest.mark.parametrize(
    ("stamp", "fresh"), [(0, 1), (EPOCH - 1, 1), (EPOCH - 3, 0), (EPOCH + 99, 1), (EPOCH + 90, 0)]
)
def test_old_stamps_are_refused(stamp, fresh, monkeypatch):
    """The run is at the epoch, 100 s behind the system's time: both are known to controllers."""
    monkeypatch.setattr("bridge.steering.inputs.time.time", lambda: EPOCH + 100)
    run = steered(changes=WEIGHTLESS)
    run.advance()
    run.inputs.push(stamped(wrench((60, 0, 0)), stamp))
    run.inputs.grab(stamped(point((0, 0, 0.9)), stamp))
    run.advance()
    assert (len(run.live.session().forces), run.live.holds) == (2 * fresh, bool(fresh))
    assert fresh or "it is ignored" in run.remarks.last
    run.inputs.grab(stamped(point((0, 0, 0), frame=""), stamp))
    run.advance()
    assert not run.live.holds, "a release is never too late"


BAD = {
    "NaN": (lambda i: i.push(wrench((np.nan, 0, 0))), "finite"),
    "infinite": (
        lambda i: [
            i.transform(transform("phy124", "t", (0, 0, 0.6), (0, 0, 0.6, 0.8))),
            i.push(wrench((0, -np.inf, 0), frame="t")),
        ],
        "finite",
    ),
    "NaN grab": (lambda i: i.grab(point((0, np.nan, 0))), "finite"),
    "too strong": (lambda i: i.push(wrench((1e30, 0, 0))), "was reduced"),
    "no frame": (lambda i: i.push(wrench((1, 0, 0), frame="nowhere")), "no transform leads"),
    "empty space": (lambda i: i.grab(point((0, 0, 3))), "away from this point"),
    "no rotation": (lambda i: i.transform(transform("phy124", "a", (0, 0, 0), (0,) * 4)), "unit"),
    "a ring": (
        lambda i: [
            i.transform(transform("a", "b", (0, 0, 0))),
            i.transform(transform("b", "a", (0, 0, 0))),
            i.push(wrench((1, 0, 0), frame="a")),
        ],
        "its own parent",
    ),
    "many frames": (
        lambda i: [i.push(wrench((1, 0, 0), frame=f"f{n}")) for n in range(33)],
        "at once",
    ),
}


@pytest.fixture(scope="module")
def resting():
    run = steered()
    run.advance()
    return run


@pytest.mark.parametrize("case", BAD)
def test_impossible_orders_are_reported_and_the_run_continues(case, resting, caplog):
    send, said = BAD[case]
    resting.remarks.__init__()
    with caplog.at_level(logging.WARNING):
        send(resting.inputs)
        resting.advance()
    assert resting.remarks.count and said in caplog.text
    assert np.isfinite(resting.live.centre).all()


def test_grabbed_object_cannot_be_pulled_arbitrarily_far():
    run = steered()
    run.advance()
    for place in ((0, 0, 0.6), (0, 0, 2.3e11), (0, 0, 2.3e11)):
        run.inputs.grab(point(place))
        run.advance()
    assert "move_to = 2.3e+11 m was reduced" in run.remarks.last and run.remarks.count == 1
    assert np.linalg.norm(run.live.centre) < 2


def test_newest_of_ten_thousand_messages_counts(monkeypatch):
    run = steered(changes=WEIGHTLESS)
    run.advance()
    for strength in range(10_000):
        run.inputs.push(wrench((strength, 0, 0)))
        run.inputs.grab(point((0, 0, 0.6)))
    run.advance()
    pushes = [force for force in run.live.session().forces if force.kind == "wrench"]
    assert [push.force[0] for push in pushes] == [9999]


@pytest.mark.slow
def test_a_thousand_random_messages_never_break_it():
    rng, run = np.random.default_rng(3), steered(paused=False)
    extremes = [0.0, -1.0, 1e-30, 1e9, 1e30, -1e30, np.nan, np.inf]
    frames = ["", "phy124", "phy124_com", "map", "tool", "nowhere"]

    def three():
        half = rng.random() < 0.5
        return [float(rng.choice(extremes) if half else rng.normal()) for _ in range(3)]

    run.advance()
    for _ in range(1000):
        frame = str(rng.choice(frames))
        send = rng.integers(4)
        if send == 0:
            run.inputs.push(wrench(three(), three(), frame))
        elif send == 1:
            run.inputs.grab(point(three(), frame))
        elif send == 2:
            run.inputs.grab(point(run.live.centre, "phy124"))
        else:
            run.inputs.transform(transform("phy124", "tool", three(), rng.normal(size=4)))
        if rng.random() < 0.3:
            run.advance()
            assert np.isfinite(run.live.centre).all() and run.stopped is None
    assert run.remarks.count


def test_a_flood_of_remarks_is_a_line_a_second(caplog):
    now = [0.0]
    remarks = Remarks(clock=lambda: now[0])
    for index in range(1000):
        now[0] += 0.01
        remarks.add(f"Number {index}.")
    assert remarks.count == 1000 and remarks.last == "Number 999."
    assert 9 <= len(caplog.records) <= 11


def test_transforms_lead_from_any_frame_of_the_tree():
    tree = Transforms("phy124")
    tree.hear(transform("map", "phy124", (1, 0, 0)))
    tree.hear(transform("map", "robot", (1, 2, 0)))
    assert np.allclose(tree.pose("robot")[:3, 3], (0, 2, 0))
    assert np.allclose(tree.pose("map")[:3, 3], (-1, 0, 0))
    for number in range(998):
        tree.hear(transform("map", f"f{number}", (0, 0, 0)))
    with pytest.raises(InputError, match="Publish fewer"):
        tree.hear(transform("map", "one more", (0, 0, 0)))


def test_wall_wrench_is_about_the_centre_of_mass():
    run = steered(changes={"object.lift": 0.0})
    for _ in range(4):
        run.advance()
    messages = contact_messages(run.live, OPTIONS, run.position)
    results = {m.topic.name: JAZZY.deserialize_cdr(m.data, m.topic.type) for m in messages}
    (link,) = results["/tf"].transforms
    assert (link.header.frame_id, link.child_frame_id) == ("phy124", "phy124_com")
    assert link.transform.translation.z == pytest.approx(run.live.centre[2])
    ground = results["~/contact/ground"]
    assert ground.header.frame_id == "phy124_com"
    assert (ground.header.stamp.sec, ground.header.stamp.nanosec) == (EPOCH, 125_000_000)
    wanted = run.live.contacts()["ground"]
    force, torque = ground.wrench.force, ground.wrench.torque
    assert (force.x, force.y, force.z) == tuple(wanted.force) and force.z < 0
    assert (torque.x, torque.y, torque.z) == tuple(wanted.torque)


BOX = {"name": "box", "shape": "box", "size": 1.2, "sides": [1, 1, 0.4]}
TWO = {"object.on": "box", "object.lift": 0.0, "objects": [BOX]}


def test_topics_and_frames_name_the_object(tmp_path, monkeypatch):
    monkeypatch.setattr("phy124.generators.shapes.COUNT", 1000)
    run = steered(changes=TWO)
    published = [
        topic for topic in controls(run, OPTIONS, "", action=False).published if topic != FACTOR
    ]
    assert "~/contact/object_on_box" in {topic.name for topic in published}
    wanted = []
    with McapSink(tmp_path / "bag", OPTIONS, topics=published, node="live") as sink:

        def show(frame):
            sink.write(frame)
            for message in contact_messages(run.live, OPTIONS, frame.time):
                sink.send(message)
            wanted.append((run.live.contacts()["object_on_box"], run.live.centre, run.live.centres))

        run.show = show
        run.advance()
        run.inputs.push(wrench((0, 0, -500), frame="phy124_object_com"))
        run.inputs.grab(point((0, 0, 0), frame="phy124_box_com"))
        run.advance()
        run.advance()
    forces = {force.kind: force.object for force in run.live.session().forces}
    assert forces == {"gravity": None, "wrench": "object", "grab": "box"}
    with Reader(tmp_path / "bag") as recorded:
        options = [
            (channel.topic, JAZZY.deserialize_cdr(data, channel.msgtype))
            for channel, _, data in recorded.messages()
        ]
    pressed = [m for topic, m in options if topic == "/phy124/live/contact/object_on_box"]
    assert [first.header.frame_id for first in pressed] == 3 * ["phy124_box_com"]
    for first, (exerted, centre, centres) in zip(pressed, wanted, strict=True):
        force, torque = (
            [getattr(v, a) for a in "xyz"] for v in (first.wrench.force, first.wrench.torque)
        )
        assert np.allclose(force, exerted.force)
        about_all = np.add(torque, np.cross(centres["box"] - centre, force))
        assert np.allclose(about_all, exerted.torque, rtol=0, atol=1e-9)
    assert pressed[-1].wrench.force.z < -1  # the object stands on the box
    (links, *_) = (message.transforms for topic, message in options if topic == "/tf")
    frames = [link.child_frame_id for link in links]
    assert frames == ["phy124_com", "phy124_object_com", "phy124_box_com"]
    clouds = [message for topic, message in options if topic == "/phy124/points"]
    assert all(cloud.fields[-1].name == "object_id" for cloud in clouds)


def test_frames_that_the_bridge_publishes_are_known():
    """Only rclpy returns to a node the transforms that the node itself publishes."""
    run = steered(changes=WEIGHTLESS)
    run.advance()
    run.inputs.transform(transform("phy124_com", "tool", (0, 0, 0.3)))
    wanted = {"phy124_com": run.live.centre, "tool": run.live.centre + (0, 0, 0.3)}
    chosen = OPTIONS.model_copy(update={"views": ("front",), "images": ("mask",)})
    with Cameras(chosen, run.live.scene.data()) as cameras:
        sink = SimpleNamespace(show=lambda *_: None, write=lambda *_: None, send=lambda *_: None)
        steer(run, sink, chosen, look=cameras.look, frames=2)
        (picture,) = cameras.look(run.live.step()).pictures
    run.show = lambda frame: None
    for frame, place in wanted.items():
        assert np.allclose(run.inputs.pose(frame)[:3, 3], place, atol=1e-6)
    seen = run.inputs.pose("phy124_camera_front_optical")
    assert np.allclose(picture.camera.view @ seen, np.eye(4))
    run.inputs.grab(point((0, 0, 0), frame="phy124_com"))
    run.advance()
    assert run.live.holds and not run.remarks.count


def test_every_contact_has_a_topic():
    """A container consists of several walls; the name of a free solid may contain `_on_`."""
    walls = [{"kind": "container", "inside": {"lower": [-1, -1, 0], "upper": [3, 1, 9]}}]
    mat = {**BOX, "name": "cat_on_mat", "place": [1.6, 0], "motion": {"kind": "free"}}
    run = steered(changes={"boundaries": walls, "objects": [mat]})
    published = controls(run, OPTIONS, "", action=False).published
    run.advance()
    sent = {message.topic for message in contact_messages(run.live, OPTIONS, 0.0)}
    assert sent == {*published} - {FACTOR} and len(sent) == 1 + 6 + 1
    assert run.live.pairs == {"object_on_cat_on_mat": "cat_on_mat"}


def test_command_steers_an_object_and_keeps_the_session(tmp_path, capsys, monkeypatch):
    clip, session = tmp_path / "clip.safetensors", tmp_path / "session.toml"
    declared = scene(**{"time.frames": 2})
    Simulation(prepare(ball(400), declared, RunContext(threads=1))).run().save(clip)
    arguments = ["--backend", "foxglove", "--port", "0", "--frames", "3", "--threads", "1"]
    coarse = ["--set", "accuracy={cells=8}", "--session", str(session)]
    bag = tmp_path / "bag"
    assert main(["live", str(clip), *arguments, *coarse, "--record", str(bag)]) == 0
    assert "8 cells across" in capsys.readouterr().out
    (bag / "metadata.yaml").unlink()
    assert recover(bag).frames == 3, "as if it had been killed"
    with Reader(bag) as recorded:
        wrenches = [
            JAZZY.deserialize_cdr(data, channel.msgtype)
            for channel, _, data in recorded.messages()
            if channel.topic == "/phy124/live/contact/ground"
        ]
        assert {channel.topic for channel in recorded.connections} >= {"/tf", "/phy124/points"}
        vx = [
            np.frombuffer(JAZZY.deserialize_cdr(data, channel.msgtype).data, "<f4")
            for channel, _, data in recorded.messages()
            if channel.topic == "/phy124/points"
        ]
    assert len(vx) == 3 and np.isfinite(vx).all(), "the profile `full` has velocities"
    assert [item.header.frame_id for item in wrenches] == 3 * ["phy124_com"]
    kept = Scene.named(str(session))
    assert kept.time.frames == 3 and kept.object == declared.object
    assert main(["live", str(clip), *arguments, *coarse, "--record", str(bag)]) == 2
    sound = Live.step

    def step(live):
        if live.count == 2:
            raise Stopped("frame 2 is not valid.")
        return sound(live)

    monkeypatch.setattr(Live, "step", step)
    again = ["--record", str(bag), "--overwrite"]
    assert main(["live", str(clip), *arguments, *coarse, *again]) == 3
    assert "its valid frames are kept. frame 2 is not valid." in capsys.readouterr().err
    assert Scene.named(str(session)).time.frames == 2 and recover(bag).frames == 2
    assert main(["live", str(clip), *arguments]) == 3, "while the grid is chosen"
    for wrong in (["--speed", "nan"], ["--push-seconds", "-1"]):
        assert main(["live", str(clip), *wrong]) == 2
    assert main(["live", str(tmp_path / "nothing.png")]) == 2


def test_doctor_names_missing_standard_interfaces(monkeypatch):
    monkeypatch.setattr(info, "missing", lambda outlet: None)
    monkeypatch.setenv("ROS_DISTRO", "kilted")
    (line,) = [line for line in info.diagnose() if line.startswith("simulation_interfaces: ")]
    assert "~/step and ~/reset (std_srvs)" in line
    assert "apt install ros-kilted-simulation-interfaces" in line
