import numpy as np
import pytest
from shapes import ball

from phy124 import resume
from phy124.errors import InputError
from phy124.scene import Scene
from phy124.simulation import Simulation

SCENE = {"accuracy": {"cells": 10}, "time.frames": 6}


@pytest.mark.parametrize(
    "changes",
    [{"velocities": True}, {"binding": "field"}, {"material": {"law": "sand"}}],
    ids=["particles", "field", "plastic"],
)
def test_a_paused_run_goes_on_bit_for_bit(tmp_path, changes):
    scene = Scene.named("press").replaced({**SCENE, **changes})
    whole = Simulation(ball(800), scene).run()
    run = Simulation(ball(800), scene)
    for frame in run:
        if frame.index == 2:
            break
    resume.save(run, tmp_path / "pause.safetensors")
    clip = resume.load(tmp_path / "pause.safetensors").run()
    for name in ("means", "quats", "scales", "velocities", "times"):
        assert np.array_equal(getattr(clip, name), getattr(whole, name)), name
    assert clip.report["substeps"] == whole.report["substeps"]
    assert clip.report["limiters"] == whole.report["limiters"]


def test_leaving_the_loop_and_iterating_again_goes_on():
    run = Simulation(ball(800), Scene.named("press").replaced(SCENE))
    first = [next(iter(run)).index for _ in range(1)]
    rest = [frame.index for frame in run]
    assert first + rest == [0, 1, 2, 3, 4, 5]


def test_refusals(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        resume.load(tmp_path / "none")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(InputError, match="it cannot be read"):
        resume.load(tmp_path / "text")
    Simulation(ball(800), Scene.named("push_right").replaced(SCENE)).run().save(tmp_path / "clip")
    with pytest.raises(InputError, match="it is not a paused run"):
        resume.load(tmp_path / "clip")
