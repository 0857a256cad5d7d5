"""Contacts: the forces of the walls on particles and Gaussians add up to all that walls give."""

import numpy as np
import pytest

from phy124.boundaries import Box, Ground
from phy124.budget.effects import Effects
from phy124.forces import Gravity
from phy124.io.clip import Clip
from phy124.materials import NeoHookean
from phy124.monitor.contacts import Contacts
from phy124.monitor.external_work import IMPULSES, WALL, ExternalWork
from phy124.pipeline import resume
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import block, make_solver
from support.shapes import ball

PARTICLES = {"accuracy": {"cells": 8, "solver": "mpm"}}
SCENE = {**PARTICLES, "time.frames": 4, "time.fps": 60.0, "object.lift": 0.0}


@pytest.mark.parametrize("threads", [1, 2])
def test_the_shares_of_all_particles_are_what_the_walls_give(threads):
    walls, x = [Ground(height=0.0), Box(upper=(0.4, 1, 0.4))], block(middle=(0, 0, 0.5))
    external, contacts = ExternalWork(), Contacts()
    solver = make_solver(
        x,
        np.full(len(x), 1e-4),
        [NeoHookean(E=1e4)],
        dx=0.125,
        v=np.tile((1.0, 0.0, -2.0), (len(x), 1)),
        threads=threads,
        forces=external.wrap_forces([Gravity()]),
        boundaries=external.wrap_walls(walls, contacts.wrap_walls(walls)),
        accumulators=[external, contacts],
        precision="float64",
    )
    external.open(solver.clock)
    start = solver.state.x.numpy()
    before = np.zeros(3)
    for frame in range(3):
        contacts.before_attempt()
        solver.advance((frame + 1) / 20)
        total = external._sum(WALL)[IMPULSES]
        impulses = contacts.impulses(len(x))
        assert np.allclose(impulses.sum(axis=0), total - before, rtol=1e-9, atol=1e-12)
        assert not impulses[(start[:, 2] > 0.8)].any(), "only what is near"
        before = total
    assert before[2] > 0.1 and before[0] < 0, "it lands, and rubs"
    kept = contacts.snapshot()
    solver.advance(0.2)
    contacts.restore(kept)
    assert np.array_equal(contacts.impulses(len(x)), impulses)


def test_a_body_at_rest_weighs_on_the_ground():
    scene = Scene.named("drop").replaced({**SCENE, "material.damping": 400, "time.frames": 40})
    scene = scene.replaced({"contacts": True, "time.sleep": False, "object.size": 0.2})
    clip = Simulation(prepare(ball(400), scene)).run()
    weight = 9.81 * clip.report["mass"]
    forces = clip.contacts.sum(axis=1)
    assert not clip.contacts[0].any()
    assert forces[-12:, 2].mean() == pytest.approx(weight, rel=0.03)
    assert np.abs(forces[-12:, :2].mean(axis=0)).max() < 0.02 * weight


@pytest.mark.parametrize("binding", ["particles", "lattice"])
def test_forces_are_kept_only_if_asked_for_and_change_nothing(binding, tmp_path):
    scene = Scene.named("press").replaced({**SCENE, "binding": binding})
    plain = Simulation(prepare(ball(300), scene, RunContext(threads=1))).run()
    asked = scene.replaced({"view.outputs": ["force"]})
    run = Simulation(prepare(ball(300), asked, RunContext(threads=1)))
    clip = run.run()
    assert plain.contacts is None and clip.contacts.shape == clip.means.shape
    assert np.array_equal(plain.means, clip.means) and np.array_equal(plain.scales, clip.scales)
    assert clip.contacts[-1, :, 2].min() < 0 < clip.contacts[-1, :, 2].max(), "plate and ground"
    clip.save(tmp_path / "clip.safetensors")
    assert np.array_equal(Clip.load(tmp_path / "clip.safetensors").contacts, clip.contacts)
    assert "contact forces" in Effects.of(asked).ran
    assert "contact forces" not in Effects.of(scene).ran


def test_a_paused_run_goes_on_with_its_forces(tmp_path):
    scene = Scene.named("press").replaced({**SCENE, "contacts": True})
    whole = Simulation(prepare(ball(300), scene, RunContext(threads=1))).run()
    run = Simulation(prepare(ball(300), scene, RunContext(threads=1)))
    for frame in run:
        if frame.index == 1:
            break
    resume.save(run, tmp_path / "pause.safetensors")
    again = resume.load(tmp_path / "pause.safetensors").run()
    assert np.array_equal(whole.contacts, again.contacts)
