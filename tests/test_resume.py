import json

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save_file

from phy124.errors import Cancelled, InputError
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Interrupted, Simulation, prepare
from support.runs import resumed
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SCENE = {"accuracy": {"cells": 10}, "time.frames": 6}


@pytest.mark.parametrize(
    "changes",
    [
        {"binding": "particles"},
        {"velocities": True},
        {"material": {"law": "sand"}},
        {"accuracy.solver": "lattice"},
    ],
    ids=["particles", "lattice", "plastic", "lattice solver"],
)
def test_a_paused_run_goes_on_bit_for_bit(tmp_path, changes):
    scene = Scene.named("press").replaced({**SCENE, **changes})
    whole = Simulation(prepare(ball(800), scene)).run()
    run = Simulation(prepare(ball(800), scene))
    clip = resumed(run, 4, tmp_path / "pause.safetensors").run()
    for name in ("means", "quats", "scales", "velocities", "times"):
        assert np.array_equal(getattr(clip, name), getattr(whole, name)), name
    assert clip.report["substeps"] == whole.report["substeps"]
    assert clip.report["limiters"] == whole.report["limiters"]


class CancelAfter:
    """A progress function that cancels at a report of a frame, once."""

    def __init__(self, reports: int) -> None:
        self.left = reports

    def __call__(self, stage: str, done: int, total: int) -> None:
        self.left -= stage == "simulate"
        if self.left == 0:
            raise Cancelled


def cut_short(gaussians, scene, reports, path, **options):
    """A run cancelled after so many reports, saved and taken up again: the clip."""
    with pytest.raises(Interrupted) as cut:
        context = RunContext(progress=CancelAfter(reports), **options)
        Simulation(prepare(gaussians, scene, context)).run()
    resume.save(cut.value.run, path)
    return resume.load(path).run()


def without_times(report):
    report = {name: value for name, value in report.items() if name != "substep_stages"}
    balance = report.pop("balance")
    return json.loads(json.dumps(report)), {k: v for k, v in balance.items() if k != "tearing"}


FLYING = {"object.velocity": [0, 0, -30], "material": {"law": "sand"}}


@pytest.mark.parametrize(
    ("preset", "changes", "options"),
    [
        pytest.param("press", {}, {}, marks=pytest.mark.slow),
        ("press", {}, {"threads": 2}),
        pytest.param("bounce", {"time.frames": 4}, {}, marks=pytest.mark.slow),
        ("drop", FLYING, {}),
        pytest.param("drop", {"material": {"law": "snow"}}, {}, marks=pytest.mark.slow),
    ],
    ids=["press", "two threads", "bounce", "flying sand", "snow"],
)
def test_cancelled_within_a_frame_it_goes_on_bit_for_bit(tmp_path, preset, changes, options):
    """The half-made frame is taken back, and the books, the windows and the limits with it."""
    scene = Scene.named(preset).replaced({**SCENE, **changes})
    whole = Simulation(prepare(ball(800), scene, RunContext(**options))).run()
    wanted, wanted_balance = without_times(whole.report)
    for fraction in (0.3, 0.8):
        reports = int(fraction * whole.report["substeps"])
        clip = cut_short(ball(800), scene, reports, tmp_path / "pause", **options)
        for name in ("means", "quats", "scales", "times"):
            assert np.array_equal(getattr(clip, name), getattr(whole, name)), (name, fraction)
        report, balance = without_times(clip.report)
        assert report == wanted, fraction
        assert balance == pytest.approx(wanted_balance, rel=1e-6), fraction


def test_cancelled_retry_restores_the_substep(tmp_path):
    run = Simulation(prepare(ball(800), Scene.named("press").replaced(SCENE)))
    run._failed = run.solver.clock.list_failed(1.0)
    usual = run.solver.clock.cfl, run.solver.clock.ceiling
    with pytest.raises(Cancelled), run._half_substep():
        raise Cancelled
    assert (run.solver.clock.cfl, run.solver.clock.ceiling) == usual


def test_notes_and_seconds_of_a_paused_run_are_kept(tmp_path):
    run = Simulation(prepare(ball(800), Scene.named("press").replaced(SCENE)))
    next(iter(run))
    run.setup.context.watch.seconds["generate"] = 7.0
    resume.save(run, tmp_path / "pause", about={"generator": "relief"})
    assert resume.read_about(tmp_path / "pause")["generator"] == "relief"
    assert resume.read_about(tmp_path / "pause")["frames"] == 1
    watch = Stopwatch()
    resume.load(tmp_path / "pause", RunContext(watch=watch))
    assert watch.seconds["generate"] == 7.0
    assert watch.total >= run.setup.context.watch.seconds["particles"]


def test_pauses_of_other_versions_are_refused(tmp_path):
    """Their content differs from the present state, so a continued run would be another run."""
    run = Simulation(prepare(ball(200), Scene.named("press").replaced(SCENE)))
    resume.save(run, tmp_path / "run")
    with safe_open(tmp_path / "run", framework="np") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        metadata = dict(file.metadata())
    save_file(tensors, tmp_path / "earlier", {**metadata, "format": "phy124-pause"})
    with pytest.raises(InputError, match="it was written by another version of phy124"):
        resume.load(tmp_path / "earlier")


def test_leaving_the_loop_and_iterating_again_goes_on():
    run = Simulation(prepare(ball(800), Scene.named("press").replaced(SCENE)))
    first = [next(iter(run)).index for _ in range(1)]
    rest = [frame.index for frame in run]
    assert first + rest == [0, 1, 2, 3, 4, 5]


def test_refusals(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        resume.load(tmp_path / "none")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(InputError, match="it cannot be read"):
        resume.load(tmp_path / "text")
    Simulation(prepare(ball(800), Scene.named("push_right").replaced(SCENE))).run().save(
        tmp_path / "clip"
    )
    with pytest.raises(InputError, match="it is not a paused run"):
        resume.load(tmp_path / "clip")


def test_a_damaged_pause_is_refused(tmp_path):
    """One byte of an array is another."""
    path = tmp_path / "run"
    resume.save(Simulation(prepare(ball(200), Scene.named("press").replaced(SCENE))), path)
    whole = bytearray(path.read_bytes())
    whole[-1] ^= 1
    path.write_bytes(whole)
    with pytest.raises(InputError, match=r"it was changed or damaged.*without --resume"):
        resume.load(path)


def test_a_pause_without_checksum_is_refused(tmp_path):
    path = tmp_path / "run"
    resume.save(Simulation(prepare(ball(200), Scene.named("press").replaced(SCENE))), path)
    with safe_open(path, framework="numpy") as file:
        metadata = {key: text for key, text in file.metadata().items() if key != "checksum"}
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    save_file(arrays, path, metadata)
    with pytest.raises(InputError, match="it was changed or damaged"):
        resume.load(path)
