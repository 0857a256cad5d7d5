"""Pauses, forecasts, sleep and failures of runs on a GPU."""

import numpy as np
import pytest

from phy124.accuracy.probe import run_pilot
from phy124.errors import Cancelled
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Interrupted, Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.gpu
FEW = {"accuracy": {"cells": 8, "solver": "mpm"}, "time.frames": 6}
ROUNDING = 1e-3
"""Largest distance between two runs of one scene on a GPU [m]: atomic sums come in any order."""


def scene(preset: str = "press", **changes) -> Scene:
    return Scene.named(preset).replaced({**FEW, **changes})


@pytest.mark.parametrize("law", ["neo_hookean", "sand"])
def test_a_paused_run_goes_on(law, gpu, tmp_path):
    declared = scene(material={"law": law})
    whole = Simulation(prepare(ball(800), declared, RunContext(device=gpu))).run()
    run = Simulation(prepare(ball(800), declared, RunContext(device=gpu)))
    for frame in run:
        if frame.index == 2:
            break
    resume.save(run, tmp_path / "pause.safetensors")
    clip = resume.load(tmp_path / "pause.safetensors", RunContext(device=gpu)).run()
    np.testing.assert_allclose(clip.means, whole.means, atol=ROUNDING)
    assert clip.report["substeps"] == pytest.approx(whole.report["substeps"], abs=2)


def test_a_run_can_be_cancelled_and_goes_on(gpu, tmp_path):
    messages = []

    def progress(stage: str, done: int, total: int) -> None:
        messages.append(done)
        if done == 3:
            raise Cancelled

    with pytest.raises(Interrupted) as cut:
        Simulation(prepare(ball(500), scene(), RunContext(device=gpu, progress=progress))).run()
    resume.save(cut.value.run, tmp_path / "pause.safetensors")
    assert len(resume.load(tmp_path / "pause.safetensors", RunContext(device=gpu)).run()) == 6


@pytest.mark.parametrize("preset", ["push_right", "sway", "press"])
def test_a_forecast_counts_the_substeps_that_are_taken(preset, gpu):
    declared = scene(preset)
    foretold, _ = run_pilot(ball(500), declared, RunContext(device=gpu)).substeps(8)
    taken = (
        Simulation(prepare(ball(500), declared, RunContext(device=gpu))).run().report["substeps"]
    )
    assert foretold == pytest.approx(taken, rel=0.25)


def test_a_body_at_rest_sleeps(gpu):
    declared = scene("drop", **{"object.lift": 0.0, "time.frames": 30, "forces": []})
    run = Simulation(prepare(ball(500), declared, RunContext(device=gpu)))
    run.run()
    assert run.report()["sleep"]["frames"] > 0


def test_a_violent_blow_is_tried_in_small_steps(gpu):
    declared = scene("drop", **{"object.velocity": [0, 0, -60.0], "time.fps": 400.0})
    run = Simulation(prepare(ball(500), declared, RunContext(device=gpu)))
    clip = run.run()
    assert clip.report["complete"] and np.isfinite(clip.means).all()


def test_non_finite_particle_is_named(gpu):
    run = Simulation(prepare(ball(300), scene("drop"), RunContext(device=gpu)))
    frames = iter(run)
    next(frames)
    x = run.solver.state.x.numpy()
    x[7] = np.nan
    run.solver.state.x.assign(x)
    with pytest.raises(Exception, match="NaN or infinite"):
        for _ in frames:
            pass


def test_the_same_run_twice_is_the_same_within_rounding(gpu):
    first, other = (
        Simulation(prepare(ball(800), scene(), RunContext(device=gpu))).run() for _ in range(2)
    )
    np.testing.assert_allclose(first.means, other.means, atol=ROUNDING)
