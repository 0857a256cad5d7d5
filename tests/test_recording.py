"""Computed frames remain, whatever ends a run (a kill, an error), and the run can be continued."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.accuracy.choose import Goal
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.io.clip import Clip
from phy124.io.ply import write_ply
from phy124.pipeline import recording, run_folder
from phy124.runtime.context import RunContext
from phy124.simulation import Simulation, prepare
from support.processes import until
from support.runs import RESULTS, SCENE, WITH, copied_at, names, same
from support.shapes import ball
from support.solids import coarse

pytestmark = [
    pytest.mark.usefixtures("coarse_solids"),
    pytest.mark.skipif(os.name == "nt", reason="no locks, so nothing is recorded"),
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """The folder of a run that nothing ended."""
    out = tmp_path_factory.mktemp("whole") / "run"
    with coarse():
        pipeline.simulate(ball(300), SCENE, out)
    return out


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


def test_a_folder_named_like_a_result_is_refused_before_going_on(tmp_path, every_frame):
    copy = copied_at(3, tmp_path / "whole", tmp_path / "killed")
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole", keep=True, each=copy)
    (tmp_path / "killed/front.mp4").mkdir()
    before = names(tmp_path / "killed")
    with pytest.raises(InputError, match=r"front\.mp4: it is a folder, but a result of the run"):
        pipeline.go_on(tmp_path / "killed", SCENE)
    assert names(tmp_path / "killed") == before


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

    filming = run_folder.film
    monkeypatch.setattr(run_folder, "film", killed)
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole", keep=True)
    monkeypatch.setattr(run_folder, "film", filming)
    assert len(Clip.load(tmp_path / "killed/clip.safetensors")) == 6
    pipeline.go_on(tmp_path / "killed", SCENE)
    same(tmp_path / "whole", tmp_path / "killed")


@pytest.mark.slow
def test_the_cut_out_is_there_after_a_kill(tmp_path, every_frame):
    duck = Path(__file__).parents[1] / "demo/examples/duck.png"
    seen = pipeline.make_gaussians(duck, SCENE, count=300)
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
            with pytest.raises(InputError, match="another process is still computing this run"):
                pipeline.go_on(tmp_path)

    assert pipeline.simulate(ball(300), SCENE, tmp_path, keep=True, each=each).report["complete"]
    assert names(tmp_path) == RESULTS


@pytest.mark.parametrize("error", [RuntimeError("a bug"), MemoryError(), OSError(5, "no disk")])
def test_an_error_leaves_the_frames_so_far(tmp_path, whole, error):
    def each(run, frame) -> None:
        if frame.index == 3:
            raise error

    with pytest.raises(Incomplete, match=r"4 frames are kept in .*--resume continues from there"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "cut", each=each)
    pipeline.go_on(tmp_path / "cut", SCENE)
    same(whole, tmp_path / "cut")


def test_a_frame_that_was_computed_last_is_kept(tmp_path, whole):
    """`progress` reports a frame before the frame is recorded."""

    def fail(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 4:
            raise MemoryError

    with pytest.raises(Incomplete, match=r"4 frames are kept in"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "cut", progress=fail)
    pipeline.go_on(tmp_path / "cut", SCENE)
    same(whole, tmp_path / "cut")


def test_a_run_with_a_goal_goes_on_from_the_chosen_grid(tmp_path, monkeypatch):
    """The chosen grid may not be the grid of the last run."""

    def fail(*arguments: object, **options: object) -> None:
        raise RuntimeError("a bug")

    goal = Goal.error("60%")
    with monkeypatch.context() as patch, pytest.raises(Incomplete, match="--resume makes"):
        patch.setattr(run_folder, "film", fail)
        pipeline.simulate(ball(300), SCENE, tmp_path, goal=goal, keep=True, error=False)
    before = Clip.load(tmp_path / "clip.safetensors")
    tried = before.report["goal"]["levels"]
    assert before.scene["accuracy"]["cells"] < tried[-1]
    pipeline.go_on(tmp_path, error=False)
    again = Clip.load(tmp_path / "clip.safetensors")
    assert again.scene == before.scene and np.array_equal(again.means, before.means)
    assert names(tmp_path) == RESULTS


def test_a_second_run_removes_the_state_of_the_first(tmp_path, monkeypatch):
    """The state refers to the first run's file of frames, which the second run removes."""
    written = recording.Recording(tmp_path, {})
    for cost, states in ((1e9, 1), (0.0, 0)):
        monkeypatch.setattr(recording, "COST", cost)
        run = Simulation(prepare(ball(300), SCENE))
        run.step()
        written.see(run)
        assert len(list(tmp_path.glob("pause.safetensors"))) == states
    written.leave()
    assert not names(tmp_path) - {".lock"}


def test_a_state_that_fails_to_load_is_not_locked(tmp_path, every_frame, monkeypatch):
    copy = copied_at(3, tmp_path / "whole", tmp_path / "killed")
    pipeline.simulate(ball(300), SCENE, tmp_path / "whole", each=copy)
    state = tmp_path / "killed/pause.safetensors"
    frames = recording.resume.load(state).frames
    assert len(recording.resume.load(state).frames) == len(frames) == 4

    def fail(*_: object, **options: object) -> None:
        raise MemoryError

    with monkeypatch.context() as patch, pytest.raises(MemoryError):
        patch.setattr(recording.resume, "load", fail)
        recording.take_up(state.parent, RunContext())
    run, taken = recording.take_up(state.parent, RunContext())
    assert run is not None
    taken.leave()
    whole = bytearray(state.read_bytes())
    whole[-1] ^= 1
    state.write_bytes(whole)
    for _ in range(2):
        with pytest.raises(InputError, match="it was changed or damaged"):
            pipeline.go_on(state.parent)


def test_a_run_of_the_page_that_fails_leaves_nothing(tmp_path, every_frame, temporary):
    """A visitor of the page has no command to continue, and must not see the server's folders."""

    def each(run, frame) -> None:
        if frame.index == 3:
            raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        pipeline.simulate(ball(300), SCENE, tmp_path / "out", each=each, rescues=False)
    assert not (tmp_path / "out").exists() and list(temporary.iterdir()) == []


def test_run_that_goes_on_leaves_no_frames_without_their_state(tmp_path, every_frame, monkeypatch):
    def stop(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 3:
            raise Cancelled

    pipeline.simulate(ball(300), SCENE, tmp_path, progress=stop, keep=True)
    before = names(tmp_path)

    def late(stage: str, done: int, total: int) -> None:
        if stage == "simulate" and done == 5:
            raise Cancelled

    def full(*_: object, **options: object) -> None:
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(recording.resume, "save", full)
    with pytest.warns(UserWarning, match="cannot be written"), pytest.raises(Cancelled):
        pipeline.go_on(tmp_path, progress=late)
    assert names(tmp_path) == before


def test_a_pause_stays_if_the_run_that_goes_on_fails(tmp_path, every_frame, whole):
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
    same(whole, tmp_path / "cut")


@pytest.mark.slow
def test_kill_9_leaves_the_frames_and_the_command_goes_on(tmp_path):
    write_ply(tmp_path / "ball.ply", ball(800))
    options = ["--set", "accuracy.cells=8", "--frames", "40", "--size", "32", "--views", "front"]
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


def test_frames_of_a_killed_run_without_a_state_are_removed(tmp_path):
    (tmp_path / "pause-1.frames").write_bytes(b"1")
    run, begun = recording.take_up(tmp_path, RunContext())
    assert run is None and not begun.saved
    assert not names(tmp_path) - {".lock"}
