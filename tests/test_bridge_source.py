"""A running simulation as a source: the same frames as the finished clip, seen while it runs."""

import json
import os
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader
from PIL import Image

from bridge import live
from bridge.layout import points
from bridge.options import Options
from bridge.sinks.dds import DdsSink
from bridge.sinks.mcap import McapSink
from bridge.source import FileWatch, LiveOptions, LiveRun, make_object
from phy124.errors import InputError
from phy124.generators.ply_file import PlyFile, Reading
from phy124.imaging.cutting import Cutting
from phy124.io.ply import write_ply
from phy124.pipeline.capture import capture
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped, prepare
from support.captures import captured
from support.clips import random_clip
from support.processes import until

pytestmark = pytest.mark.usefixtures("coarse_solids")

SUBSCRIBER = Path(__file__).parent / "support/bridge_subscriber.py"
CHANGES = ("accuracy=draft", "time.frames=6")


@pytest.fixture
def ply(tmp_path):
    """A small ball of Gaussians."""
    rng = np.random.default_rng(0)
    gaussians = random_clip(count=300).frame(0).gaussians
    inside = rng.normal(size=(300, 3))
    gaussians.means[:] = 0.5 * inside / np.linalg.norm(inside, axis=1, keepdims=True)
    gaussians.opacities[:] = 0.9
    write_ply(tmp_path / "ball.ply", gaussians)
    return tmp_path / "ball.ply"


@pytest.mark.parametrize("change", [Path.touch, Path.unlink, lambda path: path.rename("other")])
def test_only_writing_into_a_clip_ends_its_playing(tmp_path, monkeypatch, change):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "clip.safetensors"
    path.write_bytes(b"clip")
    watch = FileWatch(path)
    watch.check()
    (tmp_path / "new").write_bytes(b"another clip")
    os.replace(tmp_path / "new", path)
    watch.check()
    watch = FileWatch(path)
    change(path)
    with pytest.raises(InputError, match="wrote") if path.exists() else nullcontext():
        watch.check()


def test_recorded_while_simulated_is_the_finished_clip(ply, tmp_path):
    options = LiveOptions(live=True, set=CHANGES)
    run = LiveRun(ply, options)
    with McapSink(tmp_path / "one.mcap", scene=run.scene.data(), report=run.report) as sink:
        for frame in run:
            sink.write(frame)
            # Nothing piles up: a run may be longer than memory.
            assert run._simulation.frames == [frame]
    clip = Simulation(prepare(PlyFile(str(ply))(), options.resolve())).run()
    with open(tmp_path / "one.mcap", "rb") as stream:
        reader = make_reader(stream)
        payloads = [message.data for *_, message in reader.iter_messages("/phy124/points")]
        *_, record = reader.iter_metadata()
    assert len(payloads) == len(run) == 6
    for frame, payload in zip(clip.frames(), payloads, strict=True):
        assert frame.velocities is not None
        assert points(frame, "full").tobytes() in payload
    report = json.loads(record.metadata["report"])
    assert (report["frames"], report["complete"]) == (6, True)
    assert Scene.from_data(json.loads(record.metadata["scene"])) == options.resolve()


def test_a_subscriber_sees_it_move_while_it_is_computed(ply, domain):
    pytest.importorskip("cyclonedds")
    lines = []

    def watched(run):
        """The last frame is computed only when the subscriber has the first."""
        for frame in run:
            if frame.index == 5:
                lines.append(process.stdout.readline())
            yield frame

    run = LiveRun(ply, LiveOptions(live=True, set=CHANGES))
    command = [sys.executable, SUBSCRIBER, "--domain", str(domain), "--count", "6"]
    with (
        DdsSink(Options()) as sink,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process,
    ):
        assert process.stdout is not None
        assert "ready" in process.stdout.readline()
        until(sink.subscribers)
        assert "matched" in process.stdout.readline()
        live.follow(watched(run), sink)
        lines += process.stdout.readlines()
    assert len(lines) == 6
    assert len({json.loads(line)["crc"] for line in lines}) == 6


def test_the_listener_has_its_turns_while_a_frame_is_computed(ply):
    turns, computed = [], []

    class Sink:
        def listen(self, seconds, obey):
            time.sleep(0.001)
            turns.append(obey("speed 100"))

        def write(self, frame):
            pass

        def show(self, playback):
            pass

    def watched(run):
        frames = iter(run)
        for _ in range(len(run)):
            before = len(turns)
            frame = next(frames)
            computed.append(len(turns) - before)
            yield frame

    live.follow(watched(LiveRun(ply, LiveOptions(live=True, set=CHANGES))), Sink())
    assert max(computed) > 0


def test_doubtful_cutout_is_noted(tmp_path, monkeypatch, caplog):
    picture = Image.new("RGBA", (2, 2))
    doubtful = SimpleNamespace(
        picture=picture,
        warnings=("It is in 9 pieces.",),
        method="u2net",
        data=dict,
        notes=("Its profile is damaged.",),
    )
    asked = []
    monkeypatch.setattr(
        "phy124.pipeline.gaussians.cut_out",
        lambda *_, **gaussians: asked.append(gaussians) or doubtful,
    )
    monkeypatch.setattr("phy124.generators.GENERATORS", {"relief": lambda: lambda *_, **__: "made"})
    options = LiveOptions(cutting=Cutting(pick="0.2,0.7"))
    made = make_object(tmp_path / "photo.png", options, Scene(), "cpu")
    assert asked[0]["pick"] == (0.2, 0.7)
    assert made.gaussians == "made"
    note, first, second = caplog.messages
    assert (note, first) == ("Its profile is damaged.", "It is in 9 pieces.")
    assert f"`phy124 cutout {tmp_path / 'photo.png'}`" in second


def test_a_capture_stands_on_its_floor(tmp_path):
    """As `phy124 simulate --floor` does it; the recorded scene has the floor."""
    write_ply(tmp_path / "place.ply", captured(8, floor=1500).gaussians)
    options = LiveOptions(True, set=CHANGES, reading=Reading(floor=True))
    expected = capture(PlyFile(str(tmp_path / "place.ply"), options.reading), options.resolve())
    run = LiveRun(tmp_path / "place.ply", options)
    simulation = run.prepare()
    assert run.scene == expected.scene and run.scene.parts[-1].static
    assert (simulation.setup.source.means == expected.gaussians.means).all()


def test_a_region_in_the_units_of_a_live_file(ply):
    part = 'parts=[{static=true,region={upper=[9,0,9],units="file"}}]'
    run = LiveRun(ply, LiveOptions(True, set=(*CHANGES, part)))
    run.prepare()
    assert run.scene.parts[0].region.units == "metres"


def test_a_run_that_stops_early_keeps_its_good_frames(ply, monkeypatch):
    def advance(self, index, until):
        if index == 2:
            raise Stopped("frame 2 is not stable")

    monkeypatch.setattr(Simulation, "_advance", advance)
    run = LiveRun(ply, LiveOptions(live=True, set=CHANGES))
    assert [frame.index for frame in run] == [0, 1]
    report = run.report()
    assert run.stopped == "frame 2 is not stable"
    assert (report["frames"], report["complete"], report["stopped"]) == (2, False, run.stopped)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (LiveOptions(scene="pres"), "Did you mean press"),
        (LiveOptions(set=("time.frame=3",)), "Did you mean frames"),
        (LiveOptions(), "There is no such file"),
    ],
)
def test_refusals(tmp_path, options, sentence):
    with pytest.raises(InputError, match=sentence):
        LiveRun(tmp_path / "none.png", options)
