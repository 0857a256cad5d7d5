"""Grains: where they are, what they look like, and that nothing of the motion depends on them."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.gaussians import Gaussians, join
from phy124.materials import Fluid, NeoHookean, Sand
from phy124.motion.deform import Deformer
from phy124.particles.grains import CLEARANCE, COARSEST, SIZE, add_grains, vary_brightness
from phy124.particles.seeding import make_particles
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SPACING = 0.08
SAND = {"material.law": "sand", "accuracy": {"cells": 8}, "time.frames": 3, "object.lift": 0.1}


@pytest.fixture(scope="module")
def body() -> Gaussians:
    return ball(3000)


@pytest.fixture(scope="module")
def fine(body) -> Gaussians:
    """The body with Gaussians so small that each shows a single grain."""
    return replace(body, scales=body.scales / 10)


def grained(body, material, binding="particles"):
    made = make_particles(body, density=1000, spacing=SPACING, binding=binding)
    return made, *add_grains(body, made, np.ones(len(body), bool), [material], SPACING)


def test_inner_particles_get_balls_in_the_colour_above(body):
    made, shown, particles = grained(body, Sand())
    grains = shown.select(np.arange(len(shown)) >= len(body))
    assert len(grains) == (made.gaussian < 0).sum() > 300
    owner = particles.gaussian - len(body)
    inside = np.flatnonzero(owner >= 0)
    np.testing.assert_array_equal(grains.means[owner[inside]], particles.x[inside])
    for name in ("x", "volume", "density", "material"):
        assert getattr(particles, name) is getattr(made, name), "nothing of the motion"
    depth = 0.5 - np.linalg.norm(grains.means, axis=1)
    assert (grains.scales == grains.scales[:, :1]).all()
    assert grains.scales.max() == pytest.approx(SIZE * SPACING)
    assert (CLEARANCE * grains.scales[:, 0] < depth + 0.02).all(), "none is seen at rest"
    # The colour of a ball is its direction: that of a grain is the direction it lies in.
    way = grains.means / np.linalg.norm(grains.means, axis=1, keepdims=True)
    nearest = np.argmax(way @ body.means.T, axis=1)
    far = np.linalg.norm(grains.means, axis=1) > 0.2
    np.testing.assert_allclose(grains.rgb[far], body.rgb[nearest[far]], atol=0.15)


def test_intact_material_has_no_grains(body):
    made, shown, particles = grained(body, NeoHookean())
    assert shown is body and particles is made
    assert len(grained(body, Fluid())[1]) > len(body)


def test_on_a_lattice_the_particles_carry_them_like_all_others(body):
    made, shown, particles = grained(body, Sand(), "lattice")
    assert len(shown) > len(body) + 300 and particles is made


def test_shades_differ_by_grain_and_are_those_of_the_seed(fine):
    amounts = np.where(np.arange(len(fine)) < 1000, 0.15, 0.0)
    sandy = vary_brightness(fine, amounts, seed=3)
    same = (fine.rgb > 0.1).all(axis=1) & (fine.rgb < 0.7).all(axis=1)
    ratio = (sandy.rgb / fine.rgb)[same]
    np.testing.assert_allclose(ratio[:, 0], ratio[:, 2], rtol=1e-3, err_msg="only the brightness")
    assert 0.1 < ratio[amounts[same] > 0].std() < 0.2
    np.testing.assert_allclose(ratio[amounts[same] == 0], 1, rtol=1e-5)
    np.testing.assert_array_equal(vary_brightness(fine, amounts, seed=3).sh, sandy.sh)
    assert (vary_brightness(fine, amounts, seed=4).sh != sandy.sh).any()


def test_large_gaussians_differ_less(body, fine):
    amounts = np.full(len(body), 0.2)
    spreads = [
        (vary_brightness(each, amounts, seed=3).rgb / each.rgb).std()
        for each in (fine, body, replace(body, scales=2 * body.scales))
    ]
    assert spreads[0] > 1.5 * spreads[1] and spreads[1] == pytest.approx(2 * spreads[2], rel=0.05)


def test_a_shape_of_sand_has_small_gaussians():
    box = {"name": "box", "shape": "box", "on": "object"}
    sizes = []
    for law in ("sand", "fluid"):
        data = {**Scene.named("drop").data(), "objects": [{**box, "material": {"law": law}}]}
        made = prepare(ball(600), Scene.from_data(data).replaced({**SAND, "grains": False}))
        sizes.append(made.appearance.gaussians.of_object(1).scales.max())
    assert sizes[0] < 0.65 * sizes[1]


def test_surface_of_sand_is_rough_and_specked_and_its_inside_is_not():
    """The same surface at every accuracy: results of different accuracies are compared."""
    body = ball(20_000)
    count, shifts = len(body), []
    for cells in (8, 12):
        scene = Scene.named("sand").replaced({"accuracy": {"cells": cells}})
        setup = prepare(body, scene)
        shown = setup.appearance.gaussians
        shifts.append(shown.means[:count] - setup.gaussians.means)
        bright = shown.rgb[:, 0]
        assert len(shown) > count and bright[:count].std() > 0.1 * bright.mean()
        assert bright[count:].std() < 0.05 * bright.mean(), "no blotches behind gaps"
    np.testing.assert_allclose(*shifts, atol=1e-6)
    size = setup.gaussians.scales.max(axis=1, keepdims=True)
    size = np.minimum(size, COARSEST * np.ptp(setup.gaussians.means, axis=0).max())
    assert (shifts[0] / size).std() == pytest.approx(Sand.rough, rel=0.1)


def test_grains_are_in_every_frame_and_change_no_motion(body):
    scene = Scene.named("drop").replaced({**SAND, "contacts": True, "velocities": True})
    grainy = Simulation(prepare(body, scene)).run()
    plain = Simulation(prepare(body, scene.replaced({"grains": False}))).run()
    count = grainy.report["grains"]
    assert plain.report["grains"] == 0 < count
    assert grainy.means.shape[1] == len(plain.opacities) + count == len(grainy.opacities)
    np.testing.assert_array_equal(grainy.surface.means, plain.means)
    np.testing.assert_array_equal(grainy.surface.scales, plain.scales)
    assert len(grainy.surface.opacities) == len(plain.opacities)
    for name in ("velocities", "contacts"):
        assert getattr(grainy, name).shape == grainy.means.shape
        np.testing.assert_array_equal(getattr(grainy.surface, name), getattr(plain, name))
    fall = 9.81 * grainy.times[1] ** 2 / 2
    assert grainy.means[0, -count:, 2].mean() - grainy.means[1, -count:, 2].mean() == pytest.approx(
        fall, rel=0.05
    )


def drawn_out(stretch: float, rounds: bool) -> np.ndarray:
    """Scales of a disc that is drawn out along x, at constant volume."""
    disc = Gaussians.from_rgb(
        np.zeros((1, 3)),
        np.array([[1.0, 0, 0, 0]]),
        np.array([[0.04, 0.04, 0.01]]),
        np.ones(1),
        np.ones((1, 3)),
    )
    F = np.diag([stretch, stretch**-0.5, stretch**-0.5])[None]
    deformer = Deformer(disc, rounds=np.array([rounds]))
    return deformer(np.zeros((1, 3)), F, index=0, time=0.0).gaussians.scales[0]


def test_fluid_gaussians_become_balls_not_needles():
    np.testing.assert_allclose(drawn_out(1.2, True), drawn_out(1.2, False), rtol=1e-6)
    needle, round_ = drawn_out(9.0, False), drawn_out(9.0, True)
    assert needle.max() / needle.min() > 50
    assert round_.max() / round_.min() == pytest.approx(1)
    longest = np.sort(needle)[1:]
    assert round_[0] == pytest.approx(np.sqrt(longest.prod()), rel=1e-6)
    ratios = [np.divide(*drawn_out(s, True)[[0, 2]]) for s in np.linspace(1, 6, 40)]
    assert max(ratios) < 8, "and on the way it never becomes one"


def test_tint_gives_the_substance_its_colour():
    """Snow and its grains are white, without the picture's patches; none keeps the colours."""
    body, rgb = ball(300), np.linspace([0.2, 0, 0], [0.9, 0.6, 0], 300)
    body = Gaussians.from_rgb(body.means, body.quats, body.scales, body.opacities, rgb)
    scene = Scene.named("snow").replaced({"accuracy": {"cells": 8}, "time.frames": 1})
    rgb = Simulation(prepare(body, scene)).run().frame(0).gaussians.rgb
    assert len(rgb) > 300
    assert (np.ptp(rgb, axis=1) < 0.1).all() and rgb.mean() > 0.85
    brightness = rgb[:300].mean(axis=1)
    assert brightness[-20:].mean() == pytest.approx(brightness[:20].mean(), abs=0.03)
    plain = scene.replaced({"material.tint": "none"})
    kept = Simulation(prepare(body, plain)).run().frame(0).gaussians.rgb
    assert np.corrcoef(kept[:300, 0], body.rgb[:, 0])[0, 1] > 0.9 and kept[:, 2].max() < 0.1
    assert Scene.from_data(plain.data()).material.tint is None
    moved = [Simulation(prepare(body, s)).run().means for s in (scene, plain)]
    assert (moved[0] == moved[1]).all()


def test_tint_is_of_one_material_of_several():
    two = Scene.named("collide").replaced({"accuracy": {"cells": 8}, "time.frames": 1})
    two = two.replaced({"objects.0.material.tint": [0, 0, 1]})
    body = ball(200)
    both = replace(join([body, body]), object_id=np.repeat([0, 1], 200).astype(np.int32))
    clip = Simulation(prepare(both, two)).run()
    rgb = clip.frame(0).gaussians.rgb
    assert (rgb[clip.object_id == 1][:, :2] < 0.01).all()
    assert rgb[clip.object_id == 0][:, :2].max() > 0.1
