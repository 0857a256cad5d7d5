"""Interior: what is torn shows its inside, in the colours above it, and only where it is torn."""

import numpy as np
import pytest
import warp as wp
from scipy.spatial import KDTree

from phy124.materials import NeoHookean
from phy124.monitor.interior import Interior
from phy124.monitor.tearing import APART
from phy124.particles import make_particles
from phy124.particles.grains import SIZE
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.runs import TORN, resumed
from support.shapes import ball
from support.solids import coarse

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.fixture(scope="module")
def torn():
    scene = Scene.named("drop").replaced(TORN)
    with coarse():
        run = Simulation(prepare(ball(400), scene, RunContext(threads=1)))
    return run, run.run()


def test_exposed_interior_has_the_colour_above_it(torn):
    run, clip = torn
    added = clip.report["grains"]
    assert added == len(clip.opacities) - len(run.setup.gaussians) > 20
    assert clip.report["gaussians"] == len(clip.opacities)
    scales, means = clip.scales[:, -added:], clip.means[:, -added:]
    spacing = run.scene.spacing
    assert scales[-1].max() == pytest.approx(SIZE * spacing)
    assert scales[0].max() < 0.01 * spacing, "nothing is torn at the start"
    open_now = scales[-1, :, 0] > 0.1 * scales[-1, :, 0].max()
    x = run.solver.state.x.numpy()
    assert KDTree(x).query(means[-1][open_now])[0].max() < 1e-6, "where a particle is"
    above = KDTree(clip.means[0, :-added]).query(means[0])
    assert above[0].max() < 1e-6, "until then it hides in the Gaussian above it"
    colours = clip.sh[-added:, 0]
    assert (np.abs(colours[:, None] - clip.sh[None, :-added, 0]).max(axis=2).min(axis=1) == 0).all()


def test_the_motion_and_the_surface_are_the_same_without_it(torn):
    run, clip = torn
    off = run.scene.replaced({"grains": False})
    plain = Simulation(prepare(ball(400), off, RunContext(threads=1))).run()
    assert len(plain.opacities) == len(run.setup.gaussians) and plain.report["grains"] == 0
    for name in ("means", "quats", "scales"):
        assert np.array_equal(getattr(plain, name), getattr(clip.surface, name))


def test_nothing_is_added_where_nothing_tears():
    scene = Scene.named("press").replaced({"accuracy": {"cells": 8}, "time.frames": 4})
    clip = Simulation(prepare(ball(400), scene, RunContext(threads=1))).run()
    assert clip.means.shape[1] == clip.report["gaussians"] and clip.report["grains"] == 0


def test_torn_material_may_have_no_interior():
    """Two needles that are torn apart: every particle is of a Gaussian, so nothing lies open."""
    needles = ball(400).select(np.array([0, 399]))
    particles = make_particles(needles, density=1e3, spacing=1.0, binding="particles")
    inside = Interior(needles, particles, [NeoHookean()], spacing=1.0, dx=1.0)
    inside.look(1, wp.array(9 * particles.x, dtype=wp.vec3, device="cpu"))
    assert not len(inside.snapshot()["1"]["ids"])


def test_a_paused_run_goes_on_with_what_lay_open(torn, tmp_path):
    run, whole = torn
    again = Simulation(prepare(ball(400), run.scene, RunContext(threads=1)))
    clip = resumed(again, 4, tmp_path / "pause.safetensors").run()
    assert np.array_equal(clip.means, whole.means) and np.array_equal(clip.scales, whole.scales)


def test_the_largest_shapes_of_each_law_are_reported(torn):
    _, clip = torn
    shapes = clip.report["shapes"]["neo_hookean"]
    axes = np.sort(clip.surface.scales, axis=2)
    assert shapes["needle"] == pytest.approx((axes[..., 2] / axes[..., 1]).max(), rel=1e-5)
    assert shapes["axis_ratio"] == pytest.approx((axes[..., 2] / axes[..., 0]).max(), rel=1e-5)
    assert shapes["opacity"] == clip.opacities[:400].max()
    longest = clip.surface.scales.max(axis=2) / clip.surface.scales[0].max(axis=1)
    assert clip.report["balance"]["tearing"]["stretch"] > 3
    assert longest.max() < 1.001 * APART * 2, "no needles, though it is torn"
