"""Setups: everything that determines a run, checked before anything is compiled."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.mpm.workers import layers
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

QUICK = {"accuracy": {"cells": 8}, "time.frames": 4}


def scene(**changes) -> Scene:
    return Scene.named("drop").replaced({**QUICK, **changes})


def test_setup_is_frozen_and_runs_many_times():
    setup = prepare(ball(200), scene(stiffness_profile={"kind": "sine", "offset": 2.0}))
    with pytest.raises(FrozenInstanceError):
        setup.keep = False
    first, second = Simulation(setup).run(), Simulation(setup).run()
    assert np.array_equal(first.means, second.means)
    assert np.ptp(first.means[:, 0, 2]) > 0


def test_setup_orders_particles_for_its_threads():
    bar, particles = ball(400), scene(**{"accuracy.solver": "mpm"})
    long = Gaussians(bar.means * (1, 1, 4), bar.quats, bar.scales, bar.opacities, bar.sh)
    single, double = (prepare(long, particles, RunContext(threads=n)) for n in (1, 2))
    assert (single.along, double.along, double.threads) == (0, 2, 2)
    cells = layers(double.particles.x, 2, double.scene.dx)
    assert (np.diff(cells) >= 0).all() and len(np.unique(cells)) > 4
    assert {*map(tuple, single.particles.x)} == {*map(tuple, double.particles.x)}


@pytest.mark.parametrize(
    "changes",
    [
        {"time.budget": 1e-6},
        {"object.lift": 1e6},
        {"parts": [{"region": {"lower": [9, 9, 9]}, "material": {"law": "sand"}}]},
        {"objects": [{"name": "box", "shape": "box", "motion": {"kind": "free"}}]},
    ],
    ids=["budget", "far away", "empty part", "overlap"],
)
def test_setup_refuses_before_anything_is_compiled(monkeypatch, changes):
    def fail(*_: object) -> None:
        raise AssertionError("compiled")

    monkeypatch.setattr("phy124.simulation.run.compile_missing", fail)
    with pytest.raises(InputError):
        prepare(ball(200), scene(**changes))
