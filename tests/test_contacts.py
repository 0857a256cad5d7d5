"""Contacts: the forces of the walls on particles and Gaussians add up to all that walls give."""

import numpy as np
import pytest

from phy124.boundaries import Box, Ground
from phy124.budget.effects import Effects
from phy124.forces import Gravity
from phy124.io.clip import Clip
from phy124.monitor.contacts import Contacts
from phy124.monitor.external_work import IMPULSES, WALL
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.runs import resumed
from support.shapes import ball, thrown_block

pytestmark = pytest.mark.usefixtures("coarse_solids")

PARTICLES = {"accuracy": {"cells": 8, "solver": "mpm"}}
SCENE = {**PARTICLES, "time.frames": 4, "time.fps": 60.0, "object.lift": 0.0}
LATTICE = {**SCENE, "accuracy": {"cells": 8, "solver": "lattice"}, "contacts": True}
SAND = {"name": "sand", "shape": "box", "sides": [0.3] * 3, "material": {"law": "sand"}}


def run(scene, count=300):
    """Return a run of a ball."""
    return Simulation(prepare(ball(count), scene, RunContext(threads=1)))


@pytest.mark.parametrize("threads", [1, 2])
def test_the_shares_of_all_particles_are_what_the_walls_give(threads):
    walls, contacts = [Ground(height=0.0), Box(upper=(0.4, 1, 0.4))], Contacts()
    options = {"v": (1.0, 0.0, -2.0), "threads": threads, "forces": [Gravity()]}
    solver, external = thrown_block(walls, contacts, **options)
    external.open(solver.clock)
    start = solver.state.x.numpy()
    before = np.zeros(3)
    for frame in range(3):
        contacts.before_attempt()
        solver.advance((frame + 1) / 20)
        total = external._sum(WALL)[IMPULSES]
        impulses = contacts.impulses(len(start))
        assert np.allclose(impulses.sum(axis=0), total - before, rtol=1e-9, atol=1e-12)
        assert not impulses[(start[:, 2] > 0.8)].any(), "only what is near"
        before = total
    assert before[2] > 0.1 and before[0] < 0, "it lands, and rubs"
    kept = contacts.snapshot()
    solver.advance(0.2)
    contacts.restore(kept)
    assert np.array_equal(contacts.impulses(len(start)), impulses)


@pytest.mark.parametrize(
    ("base", "damping", "error"),
    [pytest.param(SCENE, 400, 0.03, marks=pytest.mark.slow), (LATTICE, 1000, 0.01)],
)
def test_a_body_at_rest_weighs_on_the_ground(base, damping, error):
    scene = Scene.named("drop").replaced({**base, "material.damping": damping, "time.frames": 40})
    scene = scene.replaced({"contacts": True, "time.sleep": False, "object.size": 0.2})
    clip = Simulation(prepare(ball(400), scene)).run()
    weight = 9.81 * clip.report["mass"]
    forces = clip.contacts.sum(axis=1)
    assert not clip.contacts[0].any()
    assert forces[-12:, 2].mean() == pytest.approx(weight, rel=error)
    assert np.abs(forces[-12:, :2].mean(axis=0)).max() < 0.02 * weight


def test_the_impulse_of_a_bounce_is_the_change_of_momentum():
    scene = Scene.named("bounce").replaced({**LATTICE, "velocities": True, "object.lift": 0.2})
    clip = run(scene.replaced({"time.frames": 24})).run()
    forces, mass = clip.contacts.sum(axis=1)[:, 2], clip.report["mass"]
    touches = np.flatnonzero(forces)
    first, last = touches[0] - 1, touches[-1]
    assert last < 22, "it has left the ground"
    speed = clip.velocities[..., 2].mean(axis=1)
    gain = mass * (speed[last + 1] - speed[first] + 9.81 * (last + 1 - first) / 60)
    assert forces.sum() / 60 == pytest.approx(gain, rel=0.01)
    low = clip.means[touches, :, 2].min(axis=0)
    assert low[clip.contacts.any(axis=(0, 2))].max() < 1.5 * scene.dx, "only what is near"


def test_a_clamp_gives_the_gaussians_inside_what_it_gives():
    clip = run(Scene.named("sway").replaced(LATTICE)).run()
    forces = clip.contacts.sum(axis=1)
    assert np.allclose(forces, -clip.wrenches[:, 0, 0], rtol=1e-5, atol=1e-3)
    height, touched = clip.means[0, :, 2], clip.contacts.any(axis=(0, 2))
    assert np.abs(forces).max() > 1 and height[touched].max() < 0.5 * height.max()


@pytest.mark.slow
def test_lattices_and_sand_share_the_force_of_the_ground():
    place = {"objects": [{**SAND, "place": [1.0, 0.0]}], "velocities": True}
    scene = Scene.named("drop").replaced({**LATTICE, **place, "accuracy.cells": 6})
    clip = run(scene, 100).run()
    assert np.allclose(clip.contacts.sum(axis=1), -clip.wrenches[:, 0, 0], rtol=1e-4, atol=0.01)
    for index in range(2):
        assert clip.contacts[-1, clip.object_id == index, 2].sum() > 1


@pytest.mark.parametrize("base", [SCENE, {**SCENE, "binding": "particles"}, LATTICE])
def test_forces_are_kept_only_if_asked_for_and_change_nothing(base, tmp_path):
    scene = Scene.named("press").replaced({**base, "contacts": False})
    plain = run(scene).run()
    asked = scene.replaced({"view.outputs": ["force"]})
    clip = run(asked).run()
    assert plain.contacts is None and clip.contacts.shape == clip.means.shape
    assert np.array_equal(plain.means, clip.means) and np.array_equal(plain.scales, clip.scales)
    assert clip.contacts[-1, :, 2].min() < 0 < clip.contacts[-1, :, 2].max(), "plate and ground"
    clip.save(tmp_path / "clip.safetensors")
    assert np.array_equal(Clip.load(tmp_path / "clip.safetensors").contacts, clip.contacts)
    assert "contact forces" in Effects.of(asked).ran
    assert "contact forces" not in Effects.of(scene).ran


@pytest.mark.parametrize("base", [SCENE, LATTICE])
def test_a_paused_run_goes_on_with_its_forces(base, tmp_path):
    scene = Scene.named("press").replaced({**base, "contacts": True})
    whole, paused = run(scene).run(), run(scene)
    again = resumed(paused, 1, tmp_path / "pause.safetensors").run()
    assert np.array_equal(whole.contacts, again.contacts)
