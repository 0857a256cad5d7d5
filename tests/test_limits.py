"""Runs beyond hours or memory are refused before they start, with the setting that would fit."""

import re

import pytest
from shapes import ball

from phy124.errors import InputError
from phy124.limits import forecast
from phy124.particles import make_particles
from phy124.scene import Scene
from phy124.simulation import Simulation

QUICK = {"accuracy": {"cells": 8}, "time.frames": 5}


def run(**changes) -> Simulation:
    return Simulation(ball(300), Scene.named("push_right").replaced({**QUICK, **changes}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"material.E": 1e13, "time.frames": 10_000},
            r"forecast to take .* days .* material.E = .* would fit",
        ),
        (
            {"time.substep": 1e-9, "time.frames": 1000},
            r"forecast to take .* Leave time.substep out",
        ),
    ],
)
def test_runs_of_hours_are_refused_before_they_start(changes, message):
    with pytest.raises(InputError, match=message):
        run(**changes)


def test_the_setting_that_would_fit_fits():
    hard = {"material.E": 1e12, "time.frames": 200, "time.patience": 60.0}
    with pytest.raises(InputError) as refusal:
        run(**hard)
    found = re.search(r"material.E = ([0-9.e+]+) would fit", str(refusal.value))
    assert found
    scene = Scene.named("push_right").replaced({**QUICK, **hard, "material.E": float(found[1])})
    gaussians = run().gaussians
    particles = make_particles(gaussians, density=1000, spacing=scene.dx / 2)
    assert forecast(gaussians, particles, scene, "cpu").seconds <= 1.05 * 60


def test_clips_beyond_the_memory_are_refused(monkeypatch):
    monkeypatch.setattr("phy124.limits.free_memory", lambda: 2e6)
    with pytest.raises(InputError, match=r"GB of memory, .* Use at most \d+ frames"):
        run(**{"time.frames": 500})
