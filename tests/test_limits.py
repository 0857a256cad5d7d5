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


@pytest.mark.parametrize(
    "hard",
    [
        {"material.E": 1e12},
        {"material.damping": 1e7},
        {"material.law": "fluid", "material.density": 1.0, "material.viscosity": 1e5},
    ],
)
def test_the_setting_that_would_fit_fits(hard):
    """What is named is what makes the substeps short, and the value given runs in time."""
    hard = {**hard, "time.frames": 200, "time.patience": 60.0}
    with pytest.raises(InputError) as refusal:
        run(**hard)
    found = re.search(r"(material\.\w+) = ([0-9.e+]+) would fit", str(refusal.value))
    assert found and found[1] == list(hard)[-3]
    scene = Scene.named("push_right").replaced({**QUICK, **hard, found[1]: float(found[2])})
    gaussians = run().gaussians
    particles = make_particles(gaussians, density=1000, spacing=scene.dx / 2)
    assert forecast(gaussians, particles, scene, "cpu").seconds <= 1.05 * 60


def test_clips_beyond_the_memory_are_refused(monkeypatch):
    monkeypatch.setattr("phy124.limits.free_memory", lambda: 2e6)
    with pytest.raises(InputError, match=r"GB of memory, .* Use at most \d+ frames"):
        run(**{"time.frames": 500})
