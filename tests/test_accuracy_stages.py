"""The time of a substep on lattices, from the calls of a pilot run and the durations of a probe."""

import pytest

from phy124.accuracy.probe import run_pilot
from phy124.accuracy.stages import Stage, average_stages, predict_substep
from phy124.scene import Scene
from support.shapes import ball


def test_stages_are_averages_over_substeps():
    made = average_stages({"stress": [6.0, 12], "near": [0.0, 0]}, 4)
    assert made == {"stress": Stage(3.0, 0.5)}


def test_time_between_stages_stays():
    stages = {"stress": Stage(1.0, 2.0)}
    assert predict_substep(stages, stages, 1.0, 2.5) == pytest.approx(2.5)


def test_calls_are_those_of_the_pilot():
    pilot = {"stress": Stage(1.5, 0.1), "frequency": Stage(0.5, 0.2), "wait": Stage(4.0, 1.0)}
    probe = {"stress": Stage(1.0, 2.0), "frequency": Stage(0.05, 4.0), "wait": Stage(4.0, 0.1)}
    total = 2.0 + 0.05 * 4.0 + 4.0 * 0.1 + 0.3
    expected = 1.5 * 2.0 + 0.5 * 4.0 + 4.0 * 0.1 + 0.3
    assert predict_substep(pilot, probe, 2.0, total) == pytest.approx(expected)


def test_contact_takes_the_longer_of_both_durations():
    pilot = {"contact": Stage(3.0, 0.2), "meetings": Stage(0.1, 1.0)}
    probe = {"contact": Stage(3.0, 0.1)}
    assert predict_substep(pilot, probe, 2.0, 0.3) == pytest.approx(3 * 0.4 + 0.1 * 2.0)


def test_pilot_on_a_lattice_counts_the_calls_of_its_motion():
    scene = Scene.named("press").replaced({"accuracy": {"cells": 8}, "time.frames": 3})
    assert not run_pilot(ball(300), scene.replaced({"accuracy.solver": "mpm"})).stages
    stages = run_pilot(ball(300), scene.replaced({"accuracy.solver": "lattice"})).stages
    assert stages["nodes"].calls == 2
    assert 0 < stages["meetings"].calls < 1
