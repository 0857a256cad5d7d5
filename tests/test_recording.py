"""What is computed stays, whatever ends a run: a kill, an error, a full disk, a missing encoder."""

import errno
import importlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.failures import failure
from phy124.io.clip import Clip
from phy124.io.growing import Growing
from phy124.io.ply import write_ply
from phy124.pipeline import making, recording
from phy124.scene import Scene
from support.disks import small
from support.shapes import ball
from support.waiting import until

pytestmark = pytest.mark.skipif(os.name == "nt", reason="no locks, so nothing is recorded")
CHANGES = {"accuracy": {"cells": 8}, "time.frames": 6, "view.size": 32, "view.views": ["front"]}
SCENE = Scene.named("press").replaced(CHANGES)
RESULTS = {"clip.safetensors", "front.mp4", "gaussians.ply", "report.json", "scene.toml"}


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


@pytest.fixture
def every_frame(monkeypatch):
    """The state is written after every frame."""
    monkeypatch.setattr(recording, "COST", 1e9)


@pytest.fixture
def temporary(tmp_path, monkeypatch) -> Path:
    """The folder for temporary files."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def copied_at(frame_number: int, out: Path, copy: Path):
    """A function that copies the folder of a run at a frame: what a kill would leave there."""

    def each(run, frame) -> None:
        if frame.index == frame_number:
            shutil.copytree(out, copy, ignore=lambda *_: [])

    return each


def same(one: Path, other: Path) -> None:
    """Assert that two runs left the same, apart from what they took."""
    assert names(one) == names(other)
    for name in names(one) - {"clip.safetensors", "report.json"}:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
    a, b = (Clip.load(folder / "clip.safetensors").tensors() for folder in (one, other))
    assert a.keys() == b.keys()
    for name in a:
        assert np.array_equal(a[name], b[name]), name


WITH = {
    "plain": {},
    "velocities and contacts": {"velocities": True, "contacts": True},
    "free solid": {
        "forces": [{"kind": "gravity"}],
        "boundaries": [{"kind": "ground"}],
        "objects": [
            {"name": "box", "shape": "box", "sides": [0.4, 0.4, 0.2], "on": "object",
             "motion": {"kind": "free", "density": 400}},
        ],
    },
    "at rest": {"boundaries": [{"kind": "ground"}], "time.frames": 9},
}  # fmt: skip


@pytest.mark.parametrize("changes", WITH.values(), ids=WITH)
def test_a_run_killed_at_a_frame_goes_on_bit_for_bit(tmp_path, every_frame, changes):
    scene = SCENE.replaced(changes)
    copy = copied_at(3, tmp_path / "whole", tmp_path / "killed")
    pipeline.simulate(ball(300), scene, tmp_path / "whole", keep=True, each=copy)
    left = names(tmp_path / "killed")
    assert "pause.safetensors" in left and any(name.startswith("pause-") for name in left)
    again = pipeline.go_on(tmp_path / "killed", scene)
    assert again.report["complete"]
    same(tmp_path / "whole", tmp_path / "killed")


def test_harmonics_that_turn_go_on_bit_for_bit(tmp_path, every_frame):
    still = ball(300)
    sh = np.random.default_rng(0).normal(size=(len(still), 4, 3)).astype(np.float32)
    gaussians = type(still)(still.means, still.quats, still.scales, still.opacities, sh)
    copy = copied_at(3, tmp_path / "whole", tmp_path / "killed")
    pipeline.simulate(gaussians, SCENE, tmp_path / "whole", keep=True, each=copy)
    pipeline.go_on(tmp_path / "killed")
    same(tmp_path / "whole", tmp_path / "killed")


def test_a_run_killed_while_it_is_filmed_goes_on(tmp_path, monkeypatch):
    def killed(*arguments, **options):
        shutil.copytree(tmp_path / "whole", tmp_path / "killed")
        return filming(*arguments, **options)

    filming = making.film
    monkeypatch.setattr(making, "film", killed)
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole", keep=True)
    monkeypatch.setattr(making, "film", filming)
    assert len(Clip.load(tmp_path / "killed/clip.safetensors")) == 6
    pipeline.go_on(tmp_path / "killed", SCENE)
    same(tmp_path / "whole", tmp_path / "killed")


def test_the_cut_out_is_there_after_a_kill(tmp_path, every_frame):
    duck = Path(__file__).parents[1] / "demo/examples/duck.png"
    seen = pipeline.static(duck, SCENE, count=300)
    copy = copied_at(2, tmp_path / "whole", tmp_path / "killed")
    assert seen.cutout is not None
    about = {"cutout": seen.cutout.data()}
    options = {"crop": seen.crop, "cutout": seen.cutout, "about": about, "keep": True}
    pipeline.simulate(seen.gaussians, SCENE, tmp_path / "whole", each=copy, **options)
    pipeline.go_on(tmp_path / "killed")
    assert "cutout.png" in names(tmp_path / "whole")
    same(tmp_path / "whole", tmp_path / "killed")


def test_a_new_run_removes_what_a_killed_one_left(tmp_path, every_frame):
    out = tmp_path / "out"
    copy = copied_at(3, tmp_path / "whole", out)
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole", keep=True, each=copy)
    assert len(names(out)) == 3  # state, frames, .making-
    pipeline.simulate(ball(300), SCENE, out)
    assert names(out) == RESULTS


def test_frames_in_use_are_neither_swept_nor_taken_over(tmp_path, every_frame):
    def each(run, frame) -> None:
        if frame.index == 3:
            assert any(name.startswith("pause-") for name in names(tmp_path))
            recording.sweep(tmp_path)
            (tmp_path / "pause.safetensors").rename(tmp_path / "away")
            recording.sweep(tmp_path)
            (tmp_path / "away").rename(tmp_path / "pause.safetensors")
            with pytest.raises(InputError, match="another process is computing this very run"):
                pipeline.go_on(tmp_path)

    assert pipeline.simulate(ball(300), SCENE, tmp_path, keep=True, each=each).report["complete"]
    assert names(tmp_path) == RESULTS


@pytest.mark.parametrize("error", [RuntimeError("a bug"), MemoryError(), OSError(5, "no disk")])
def test_an_error_leaves_the_frames_so_far(tmp_path, error):
    def each(run, frame) -> None:
        if frame.index == 3:
            raise error

    with pytest.raises(Incomplete, match=r"4 frames are kept in .*--resume goes on from there"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "cut", each=each)
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole")
    pipeline.go_on(tmp_path / "cut", SCENE)
    same(tmp_path / "whole", tmp_path / "cut")


def test_a_run_of_the_page_that_fails_leaves_nothing(tmp_path, every_frame, temporary):
    """Its visitor has no command to go on with, and must not see the server's folders."""

    def each(run, frame) -> None:
        if frame.index == 3:
            raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "out", each=each, rescues=False)
    assert not (tmp_path / "out").exists() and list(temporary.iterdir()) == []


def test_a_pause_stays_if_the_run_that_goes_on_fails(tmp_path, every_frame):
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 3:
            raise Cancelled

    pipeline.simulate(ball(300), SCENE, tmp_path / "cut", progress=stop, keep=True)

    def late(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 5:
            raise Cancelled

    with pytest.raises(Cancelled):
        pipeline.go_on(tmp_path / "cut", progress=late)
    with pytest.raises(InputError, match=r"time\.frames"):
        pipeline.go_on(tmp_path / "cut", SCENE.replaced({"time.frames": 7}))
    pipeline.go_on(tmp_path / "cut", SCENE)
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole")
    same(tmp_path / "whole", tmp_path / "cut")


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), ValueError("a plugin")])
def test_what_is_computed_stays_if_filming_fails(tmp_path, monkeypatch, error, capsys):
    def fail(clip, view, folder, **options):
        (folder / "front.mp4").touch()
        raise error

    write_ply(tmp_path / "ball.ply", ball(300))
    pipeline.simulate(ball(300), SCENE.replaced({"view.views": ["left"]}), tmp_path / "out")
    command = ["simulate", str(tmp_path / "ball.ply"), "--out", str(tmp_path / "out")]
    command += ["--frames", "2", "--accuracy", "draft", "--views", "front", "--size", "32"]
    with monkeypatch.context() as patch:
        patch.setattr(making, "film", fail)
        assert main(command) == 1
    said = capsys.readouterr().err
    assert f"phy124 render {tmp_path / 'out/clip.safetensors'}" in said and "front.mp4" in said
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report == Clip.load(tmp_path / "out/clip.safetensors").report
    assert set(report["files"]) == RESULTS
    assert {name for name in names(tmp_path / "out") if not name.startswith("pause")} == RESULTS
    assert main([*command, "--resume"]) == 0
    assert (tmp_path / "out/front.mp4").stat().st_size and names(tmp_path / "out") == RESULTS


@pytest.mark.parametrize("resumes", [False, True])
def test_a_missing_encoder_is_refused_before_work(tmp_path, monkeypatch, capsys, resumes):
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 3:
            raise Cancelled

    if resumes:
        pipeline.simulate(ball(300), SCENE, tmp_path, progress=stop, keep=True)
    else:
        write_ply(tmp_path / "ball.ply", ball(300))
    before = names(tmp_path)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", "/nonexistent")
    with pytest.raises(InputError, match="the video encoder, ffmpeg, does not work here"):
        if resumes:
            pipeline.go_on(tmp_path)
        else:
            pipeline.simulate(ball(300), SCENE, tmp_path / "out")
    assert names(tmp_path) == before
    assert main(["doctor"]) == 1
    assert "ffmpeg, does not work here" in capsys.readouterr().out


def test_an_encoder_whose_program_is_gone_is_refused(tmp_path, monkeypatch):
    """As imageio-ffmpeg says it where its wheel holds no program."""

    def missing() -> str:
        raise RuntimeError("No ffmpeg exe could be found. Install ffmpeg on your system.\nOr so.")

    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_exe", missing)
    with pytest.raises(InputError, match=r"does not work here \(No ffmpeg exe could be found"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "out")
    assert names(tmp_path) == set()


def test_a_missing_package_is_refused_before_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    scene = SCENE.replaced({"view.formats": ["mp4", "usd"]})
    with pytest.raises(InputError, match="this needs the package usd-core"):
        pipeline.simulate(ball(300), scene, tmp_path / "out")
    assert names(tmp_path) == set()


@pytest.mark.parametrize("command", ["render", "compare"])
def test_finished_sides_stay_if_a_later_one_fails(tmp_path, monkeypatch, capsys, command):
    def write(path, frames, *, fps):
        if path.name == "left.mp4":
            raise OSError(errno.EIO, "no disk")
        return written(path, frames, fps=fps)

    pipeline.simulate(ball(300), SCENE, tmp_path / "a", films=False)
    module = importlib.import_module(
        {"render": "phy124.rendering.film", "compare": "phy124.commands.compare"}[command]
    )
    written = module.write_mp4
    monkeypatch.setattr(module, "write_mp4", write)
    clip, out = str(tmp_path / "a/clip.safetensors"), tmp_path / "out"
    given = [clip] if command == "render" else [clip, clip]
    options = ["--views", "front", "left", "--size", "32", "--device", "cpu", "--out", str(out)]
    assert main([command, *given, *options]) == 1
    assert f"kept in {out}: front.mp4" in capsys.readouterr().err
    assert names(out) == {"front.mp4"}


@contextmanager
def full(monkeypatch, *folders: Path):
    """Within this context no clip can be written below some folders."""

    def refuse(path) -> None:
        if any(Path(path).is_relative_to(folder) for folder in folders):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def like(path, *arguments, **options):
        refuse(path)
        return begin(path, *arguments, **options)

    def save(clip, path) -> None:
        refuse(path)
        saved(clip, path)

    begin, saved = Growing.like, Clip.save
    with monkeypatch.context() as patch:
        patch.setattr(Growing, "like", like)
        patch.setattr(Clip, "save", save)
        yield


@pytest.mark.filterwarnings("ignore:frames are kept in memory only")
@pytest.mark.parametrize("done", [3, None], ids=["interrupted", "whole"])
def test_results_go_where_there_is_room(tmp_path, monkeypatch, temporary, done):
    def stop(stage: str, now: int, total: int) -> None:
        if (stage, now) == ("simulate", done):
            raise Cancelled

    with full(monkeypatch, tmp_path / "out"), pytest.raises(Incomplete) as told:
        pipeline.simulate(ball(300), SCENE, tmp_path / "out", progress=stop, keep=True)
    (kept,) = temporary.iterdir()
    assert failure(told.value).status == (130 if done else 1)
    assert f"phy124 render {kept / 'clip.safetensors'}" in str(told.value)
    assert len(Clip.load(kept / "clip.safetensors")) == (done or 6)
    assert not (tmp_path / "out").exists()
    if done:
        assert f"--out {kept} --resume" in str(told.value)
        assert pipeline.go_on(kept, SCENE).report["complete"]
        assert names(kept) == RESULTS


@pytest.mark.filterwarnings("ignore:frames are kept in memory only")
def test_it_is_said_if_nothing_can_be_kept(tmp_path, monkeypatch, temporary):
    with (
        full(monkeypatch, tmp_path),
        pytest.raises(Incomplete, match="nothing could be kept"),
    ):
        pipeline.simulate(ball(300), SCENE, tmp_path / "out", keep=True)
    assert list(temporary.iterdir()) == [] and not (tmp_path / "out").exists()


@pytest.mark.filterwarnings("ignore:the results are forecast to take")
@pytest.mark.filterwarnings("ignore:the state of the run cannot be written")
def test_a_disk_too_small_for_everything_gets_the_clip(tmp_path, temporary, every_frame):
    with small(tmp_path / "disk", "300k") as disk:
        with pytest.raises(Incomplete, match=r"kept in .*: clip\.safetensors"):
            pipeline.simulate(ball(900), SCENE, disk / "out", keep=True)
        kept = {name for name in names(disk / "out") if not name.startswith("pause")}
        assert {"clip.safetensors", "report.json", "scene.toml"} <= kept < RESULTS
        assert len(Clip.load(disk / "out/clip.safetensors")) == 6
        assert set(json.loads((disk / "out/report.json").read_text())["files"]) == kept


def test_too_little_room_is_said_before_work(tmp_path, monkeypatch):
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate":
            raise Cancelled

    usage = shutil.disk_usage(tmp_path)._replace(free=307_000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with (
        pytest.warns(UserWarning, match=r"forecast to take .*, and .* has room for 307.0 kB"),
        pytest.raises(Cancelled),
    ):
        pipeline.simulate(ball(900), SCENE, tmp_path / "out", progress=stop)


@pytest.mark.filterwarnings("ignore:the results are forecast to take")
@pytest.mark.filterwarnings("ignore:frames are kept in memory only")
def test_an_interruption_while_the_disk_is_full_keeps_the_frames(tmp_path, temporary):
    def stop(stage: str, done: int, total: int) -> None:
        if (stage, done) == ("simulate", 5):
            raise Cancelled

    with small(tmp_path / "disk", "100k") as disk:
        with pytest.raises(Incomplete) as told:
            pipeline.simulate(ball(900), SCENE, disk / "out", progress=stop, keep=True)
        assert names(disk) == set()
    (kept,) = temporary.iterdir()
    assert failure(told.value).status == 130 and str(kept) in str(told.value)
    assert len(Clip.load(kept / "clip.safetensors")) == 5


def test_kill_9_leaves_the_frames_and_the_command_goes_on(tmp_path):
    write_ply(tmp_path / "ball.ply", ball(800))
    options = ["--accuracy", "draft", "--frames", "40", "--size", "32", "--views", "front"]
    options += ["--set", "time.sleep=false", "--device", "cpu", "--threads", "1"]
    command = [sys.executable, "-m", "phy124", "simulate", str(tmp_path / "ball.ply"), *options]
    out = tmp_path / "out"
    with subprocess.Popen([*command, "--out", str(out)], stderr=subprocess.DEVNULL) as process:
        until(lambda: (out / "pause.safetensors").exists() or process.poll() is not None)
        process.send_signal(signal.SIGKILL)
    assert not (out / "front.mp4").exists()
    assert main([*command[3:], "--out", str(out), "--resume"]) == 0
    assert main([*command[3:], "--out", str(tmp_path / "whole")]) == 0
    same(tmp_path / "whole", out)
