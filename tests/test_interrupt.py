"""Ctrl-C and SIGTERM: what is good stays, what is half-made goes, and a run can go on."""

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.accuracy.choose import Goal
from phy124.budget import cost
from phy124.commands.bars import Bars
from phy124.errors import Cancelled, InputError
from phy124.io.clip import Clip
from phy124.io.files import staging
from phy124.io.ply import write_ply
from phy124.motion.blocks import THREADS
from phy124.mpm.threads import Barrier
from phy124.scene import Scene
from phy124.studies.validation import stress
from phy124.studies.validation.accuracy import verify as verifying
from phy124.studies.validation.accuracy.verify import Verdict
from support.processes import run_program
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
SCENE = Scene.named("press").replaced(
    {"accuracy": {"cells": 10}, "time.frames": 6, "view.size": 32, "view.views": ["front", "left"]}
)
OPTIONS = [
    *("--frames", "6", "--size", "32", "--set", "accuracy={cells=8}", "time.sleep=false"),
    *("--views", "front", "left", "--device", "cpu"),
]


def cancelling(when: Callable[[str, int], bool]):
    """A progress function that cancels whenever a stage and its step are those."""

    def progress(stage: str, done: int, total: int) -> None:
        if when(stage, done):
            raise Cancelled

    return progress


def test_a_cancelled_run_leaves_nothing_unless_asked(tmp_path):
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 3)
    with pytest.raises(Cancelled):
        pipeline.simulate(ball(500), SCENE, tmp_path / "a" / "out", progress=cancel)
    assert list(tmp_path.iterdir()) == []


def test_cancelled_run_resumes_bit_for_bit(tmp_path):
    whole = pipeline.simulate(ball(500), SCENE, tmp_path / "whole")
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 3)
    cut = pipeline.simulate(ball(500), SCENE, tmp_path / "cut", progress=cancel, keep=True)
    assert (cut.report["interrupted"], cut.report["complete"]) == (True, False)
    assert "--resume" in cut.report["stopped"]
    assert cut.report["error"]["why_not"] == "the run was interrupted"
    assert cut.report["promise"]["error"] is None
    assert cut.report["frames"] == len(Clip.load(tmp_path / "cut/clip.safetensors")) == 3
    names = {path.name for path in (tmp_path / "cut").iterdir()}
    assert names == {path.name for path in (tmp_path / "whole").iterdir()} | {pipeline.PAUSE}

    again = pipeline.go_on(tmp_path / "cut", SCENE)
    assert (again.report["interrupted"], again.report["complete"]) == (False, True)
    assert not (tmp_path / "cut" / pipeline.PAUSE).exists()
    first, other = (Clip.load(r.folder / "clip.safetensors") for r in (whole, again))
    for name in ("means", "quats", "scales", "times"):
        assert np.array_equal(getattr(first, name), getattr(other, name))
    for view in ("front.mp4", "left.mp4"):
        assert (whole.folder / view).read_bytes() == (again.folder / view).read_bytes()


def test_filming_that_is_cancelled_keeps_the_clip(tmp_path, monkeypatch):
    monkeypatch.setattr(cost, "HELD", 0)
    cancel = cancelling(lambda stage, done: stage == "render" and done == 8)
    cut = pipeline.simulate(ball(500), SCENE, tmp_path, progress=cancel, keep=True)
    assert (cut.report["interrupted"], cut.report["complete"]) == (True, True)
    names = {path.name for path in tmp_path.iterdir()}
    assert names >= {"clip.safetensors", "report.json", pipeline.PAUSE}
    assert not names & {"front.mp4", "left.mp4"}
    (shapes,) = json.loads((tmp_path / "report.json").read_bytes())["shapes"].values()
    assert shapes["needle"] > 1
    assert {path.name for path in pipeline.go_on(tmp_path).files} >= {"front.mp4", "left.mp4"}


def test_cancelled_estimate_of_the_error_interrupts_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("phy124.accuracy.companion.AFFORDABLE", 1e3)
    cancel = cancelling(lambda stage, done: stage == "companion")
    with pytest.raises(Cancelled):
        pipeline.simulate(ball(500), SCENE, tmp_path / "dropped", progress=cancel)
    cut = pipeline.simulate(ball(500), SCENE, tmp_path / "kept", progress=cancel, keep=True)
    assert (cut.report["interrupted"], cut.report["complete"]) == (True, True)
    assert cut.report["error"]["why_not"] == "the run was interrupted"
    again = pipeline.go_on(tmp_path / "kept")
    assert not again.report["interrupted"] and again.report["error"]["about"] > 0


def test_second_interrupt_while_filming_loses_no_frame(tmp_path):
    cancel = cancelling(
        lambda stage, done: (stage == "simulate" and done == 3) or "render" in stage
    )
    pipeline.simulate(ball(500), SCENE, tmp_path, progress=cancel, keep=True)
    assert {path.name for path in tmp_path.iterdir()} == {
        "clip.safetensors",
        "gaussians.ply",
        "report.json",
        "scene.toml",
        pipeline.PAUSE,
    }
    assert len(Clip.load(tmp_path / "clip.safetensors")) == 3


def test_another_scene_is_not_gone_on_with(tmp_path):
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 3)
    pipeline.simulate(ball(500), SCENE, tmp_path, progress=cancel, keep=True)
    for changes, said in (
        ({"time.frames": 9}, r"time.frames = 6, not 9"),
        ({"material.E": 5e4}, r"material.E = "),
        ({"forces": []}, r"different forces"),
    ):
        with pytest.raises(InputError, match=said):
            pipeline.go_on(tmp_path, SCENE.replaced(changes))


def test_a_run_with_a_goal_goes_on_at_the_accuracy_in_hand(tmp_path):
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 3)
    goal = Goal.error("5%")
    cut = pipeline.simulate(ball(500), SCENE, tmp_path, progress=cancel, keep=True, goal=goal)
    assert cut.report["interrupted"]
    with pytest.raises(InputError, match=r"accuracy"):
        pipeline.go_on(tmp_path, SCENE)
    again = pipeline.go_on(tmp_path, SCENE, any_accuracy=True)
    assert again.report["complete"]


def test_there_must_be_something_to_go_on_with(tmp_path, capsys):
    assert main(["generate", str(DUCK), "--out", str(tmp_path / "none"), "--resume"]) == 2
    assert "this folder has no interrupted run" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@contextmanager
def started(*arguments: object) -> Iterator[subprocess.Popen]:
    """A command that runs beside the test, and is ended with it at the latest."""
    command = [sys.executable, "-u", "-m", "phy124", *map(str, arguments)]
    pipes = {"stderr": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:
        guard = threading.Timer(600, process.kill)
        guard.start()
        try:
            yield process
        finally:
            guard.cancel()
            process.kill()


def wait_for(process: subprocess.Popen, beginning: str) -> None:
    """Read what it says until a line begins so; fails with all it said if none does."""
    assert process.stderr
    lines = []
    for line in process.stderr:
        lines.append(line)
        if line.startswith(beginning):
            return
    pytest.fail("".join(lines))


@pytest.mark.parametrize(
    ("program", "module", "said"),
    [("phy124", "phy124.runtime.failures", "phy124: stopped\n"), ("demo", "pydantic", "")],
)
def test_ctrl_c_during_the_first_imports_shows_no_traceback(program, module, said):
    code = f"""
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupting:
    def find_spec(self, name, *_):
        if name == {module!r}:
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
import {program}.__main__
"""
    run = run_program([sys.executable, "-c", code])
    assert (run.returncode, run.stderr) == (130, said)


@pytest.mark.slow
def test_ctrl_c_while_nothing_moves_yet_leaves_nothing(tmp_path):
    command = ["generate", DUCK, *OPTIONS, "--out", tmp_path / "new" / "out"]
    with started(*command) as run:
        while not list(tmp_path.rglob(".making-*")):
            assert run.poll() is None
            time.sleep(0.01)
        run.send_signal(signal.SIGINT)
        _, errors = run.communicate()
    assert run.returncode == 130
    assert "stopped; no incomplete file was left behind" in errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_sigterm_keeps_the_good_frames(tmp_path):
    write_ply(tmp_path / "ball.ply", ball(800))
    command = ["simulate", tmp_path / "ball.ply", *OPTIONS, "--out", tmp_path / "out"]
    command[command.index("6")] = "3000"
    with started(*command) as run:
        wait_for(run, "simulate: ")
        run.send_signal(signal.SIGTERM)
        _, errors = run.communicate()
    assert run.returncode == 130, errors
    assert "results so far will be kept" in errors
    assert "stopped early: it was interrupted" in errors
    assert 0 < json.loads((tmp_path / "out/report.json").read_text())["frames"] < 3000
    assert (tmp_path / "out" / pipeline.PAUSE).exists()
    assert not list(tmp_path.rglob(".making-*"))


def test_the_same_command_with_resume_goes_on(tmp_path, capsys):
    write_ply(tmp_path / "ball.ply", ball(800))
    changes = {
        "accuracy": {"cells": 8},
        "time.frames": 6,
        "time.sleep": False,
        "view.size": 32,
        "view.views": ["front", "left"],
        "view.stage": "studio",
    }
    scene = Scene.named("press").replaced(changes)
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 3)
    pipeline.simulate(ball(800), scene, tmp_path / "out", progress=cancel, keep=True)
    command = ["simulate", str(tmp_path / "ball.ply"), *OPTIONS, "--out", str(tmp_path / "out")]
    assert main([*command, "--resume", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["complete"]


def test_object_from_a_picture_is_resumed(tmp_path):
    """`crop` of a further object is found in its picture, so the scene of a command lacks it."""
    changes = {"accuracy": {"cells": 8}, "time.frames": 3, "view.size": 32, "view.views": ["front"]}
    asked = Scene.named("collide").replaced(changes)
    made = asked.replaced({"objects.0.crop": [0.1, 0.1, 0.9, 0.9]})
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 2)
    pipeline.simulate(ball(300), made, tmp_path / "cut", progress=cancel, keep=True)
    with pytest.raises(InputError, match=r"has objects\.0\.size = 1\.0, not 0\.9"):
        pipeline.go_on(tmp_path / "cut", asked.replaced({"objects.0.size": 0.9}))
    assert pipeline.go_on(tmp_path / "cut", asked).report["complete"]


@pytest.mark.slow
def test_a_run_of_two_pictures_goes_on_with_both_bit_for_bit(tmp_path):
    changes = {"accuracy": {"cells": 8}, "time.frames": 4, "view.size": 32, "view.views": ["front"]}
    scene = Scene.named("collide").replaced(changes)
    inputs = ([DUCK, DUCK.with_name("teddy.png")], scene)
    whole = pipeline.generate(*inputs, tmp_path / "whole", count=1000, threads=1)
    cancel = cancelling(lambda stage, done: stage == "simulate" and done == 2)
    pipeline.generate(*inputs, tmp_path / "cut", count=1000, threads=1, progress=cancel, keep=True)
    again = pipeline.go_on(tmp_path / "cut", scene)
    first, other = (Clip.load(r.folder / "clip.safetensors") for r in (whole, again))
    assert np.array_equal(first.means, other.means) and first.objects == other.objects
    assert np.array_equal(first.object_id, other.object_id)
    assert again.report["sources"] == whole.report["sources"]


def test_one_interrupt_is_reported_and_two_end_at_once(capsys):
    with Bars(quiet=True, keeps=True) as bars:
        bars("simulate", 0, 3)
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Cancelled):
            bars("simulate", 1, 3)
        bars("render front", 1, 3)
        signal.raise_signal(signal.SIGTERM)
        with pytest.raises(Cancelled):
            bars("render front", 2, 3)
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert capsys.readouterr().err.count("Ctrl-C again quits at once") == 2


def test_a_log_gets_lines_and_no_carriage_returns(capsys):
    with Bars() as bars:
        for done in range(1, 4):
            bars("simulate", done, 3)
            bars("simulate", done, 3)
        bars("render front", 1, 1)
    assert capsys.readouterr().err == ("simulate: 1 of 3\nsimulate: 3 of 3\nrender front: 1 of 1\n")


def test_ctrl_c_in_a_threaded_substep_does_not_hang():
    """The second thread waits for a barrier that the first, interrupted, never comes to."""
    barrier = Barrier(2)
    waiting = threading.Thread(target=lambda: results.append(barrier.wait(1)), daemon=True)
    results: list[bool] = []
    waiting.start()
    barrier.abandoned = True
    waiting.join(timeout=300)
    assert results == [False]


@pytest.mark.parametrize(("reports", "threads"), [(1, 2), (5, 4)])
def test_exception_between_barriers_ends_all_threads(reports, threads):
    from phy124.runtime.context import RunContext
    from phy124.simulation import Simulation, prepare

    run = Simulation(prepare(ball(800), SCENE, RunContext(threads=threads)))
    before = len(solving())
    team = run.solver.runner.team
    hand_over, calls = team._hand_over, 0

    def interrupted(task):
        nonlocal calls
        calls += 1
        if calls == reports:
            team._tasks[team._started % 2] = task
            raise KeyboardInterrupt
        hand_over(task)

    team._hand_over = interrupted
    with pytest.raises(KeyboardInterrupt):
        run.run()
    assert len(solving()) == before


def solving():
    """All threads but those that wait for the next frame's shapes."""
    return [item for item in threading.enumerate() if not item.name.startswith(THREADS)]


def test_only_empty_folders_of_the_run_are_removed(tmp_path):
    with pytest.raises(ZeroDivisionError), staging(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ZeroDivisionError), staging(tmp_path / "a" / "b"):
        (tmp_path / "a" / "other").touch()
        raise ZeroDivisionError
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["other"]


def test_stress_tells_of_the_cases_it_has_run(monkeypatch, capsys):
    def rows(settings, cases):
        for _ in range(3):
            yield stress.Row("a case", "-", "-", "pass")
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(stress, "run", rows)
    assert main(["stress"]) == 130
    said = capsys.readouterr()
    assert said.out.count("a case") == 2
    assert "stopped; 2 of" in said.err


def test_checks_that_were_made_are_shown_if_a_later_one_fails(monkeypatch, capsys):
    def rows(settings, cases):
        yield stress.Row("a case", "-", "-", "pass")
        raise MemoryError

    def verdicts(**options):
        yield Verdict("ball", "speed", 0.0, 1.0)
        raise MemoryError

    monkeypatch.setattr(stress, "run", rows)
    monkeypatch.setattr(verifying, "verify", verdicts)
    for command, seen in ((["stress"], "a case"), (["accuracy", "--verify"], "ball")):
        assert main(command) == 1
        said = capsys.readouterr()
        assert seen in said.out and "all as expected" not in said.out
        assert "there is not enough memory" in said.err and "; 1 " in said.err


def test_render_and_compare_keep_only_finished_films(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("phy124.rendering.film.MOST_PIXELS", 2 * 32**2)
    pipeline.simulate(ball(300), SCENE, tmp_path / "a")
    clip, quick = str(tmp_path / "a"), ["--size", "32", "--views", "front", "left"]
    commands = {
        "render": ["render", f"{clip}/clip.safetensors", *quick, "--format", "png", "mp4"],
        "compare": ["compare", clip, clip, *quick],
    }
    for stage, first, command in (("render", 7, "render"), ("compare left", 1, "compare")):
        press = pressing_ctrl_c(stage, first)
        monkeypatch.setattr(Bars, "_report", press)
        assert (
            main([*commands[command], "--device", "cpu", "--out", str(tmp_path / command)]) == 130
        )
        assert "stopped; " in capsys.readouterr().err
    made = {path.name for path in (tmp_path / "render").iterdir()}
    assert made == {"front-png", "front.mp4"}
    assert len(list((tmp_path / "render/front-png").iterdir())) == SCENE.time.frames
    made = {path.name for path in (tmp_path / "compare").iterdir()}
    assert made == {"front.mp4", "comparison.json"}


def test_stopped_sweep_says_how_many_clips_are_finished(tmp_path, monkeypatch, capsys):
    def report(bars: Bars, stage: str, done: int, total: int) -> None:
        if done == 1:
            signal.raise_signal(signal.SIGINT)

    write_ply(tmp_path / "ball.ply", ball(60))
    (tmp_path / "sweep.toml").write_text(f"""
pictures = "{(tmp_path / "ball.ply").as_posix()}"
scene = "drop"
[set]
"accuracy.cells" = 8
"time.frames" = 3
"material.E" = [1e4, 1e5]
""")
    monkeypatch.setattr(Bars, "_report", report)
    command = ["sweep", str(tmp_path / "sweep.toml"), "--workers", "0", "--device", "cpu"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 130
    assert "stopped; finished clips: 1; the same command" in capsys.readouterr().err


def pressing_ctrl_c(where: str, after: int = 1):
    """A `Bars._report` that interrupts a stage at its report number `after`."""
    reports = itertools.count(1)

    def report(bars: Bars, stage: str, done: int, total: int) -> None:
        if stage == where and not bars.cancelled and next(reports) == after:
            signal.raise_signal(signal.SIGINT)

    return report


HOLD = """
import sys, time
from phy124.io.files import staging
with staging(sys.argv[1]) as folder:
    (folder / "clip").touch()
    print(folder, flush=True)
    time.sleep(600)
"""


@pytest.mark.skipif(os.name == "nt", reason="no locks on folders")
def test_leftovers_of_killed_processes_are_removed(tmp_path):
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        theirs = Path(process.stdout.readline().strip())
        with staging(tmp_path) as mine, staging(tmp_path) as nested:
            stay = [path.is_dir() for path in (theirs, mine, nested)]
        process.kill()
    assert all(stay)
    assert (theirs / "clip").exists()
    with staging(tmp_path) as mine:
        assert list(tmp_path.iterdir()) == [mine]
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_folder_and_is_refused_before_any_work(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("mine")
    monkeypatch.setattr(
        pipeline, "make_gaussians", lambda *_, **__: pytest.fail("it began to work")
    )
    for out in (tmp_path / "file", tmp_path / "file" / "deeper"):
        assert main(["generate", str(DUCK), *OPTIONS, "--out", str(out)]) == 2
        assert f"out = {out}: it " in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"
