import numpy as np
import pytest
import scipy

from phy124 import Scene, Simulation, prepare
from phy124.gaussians import Gaussians
from phy124.particles.grains import tint
from phy124.rendering.matte import Matte, blur, find_matte, illuminate
from phy124.rendering.shine import LAMP, add_gloss, make_shine
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

CELL = 0.05


def heaped(hollow: float):
    """A heap of grains with a hollow of a radius in its middle, in rows, half a cell apart."""
    x, y, z = np.mgrid[-1:1:81j, -1:1:81j, 0:0.6:25j].reshape(3, -1)
    away = np.hypot(x, y)
    high = np.where(away < hollow, 0.3, 0.6 - 0.5 * away)
    return np.stack([x, y, z], axis=1)[z <= high].astype(np.float32)


@pytest.fixture(scope="module")
def heap():
    return heaped(hollow=0)


def light_on(x):
    return Matte(np.arange(len(x)), np.full(len(x), (CELL / 2) ** 3), CELL).light(x, LAMP)


def surface(x, place):
    """The index of the highest point above a place."""
    near = np.hypot(*(x[:, :2] - place).T) < 0.03
    return np.flatnonzero(near)[x[near, 2].argmax()]


def test_a_heap_is_lit_on_the_side_of_the_lamp(heap):
    light, aside = light_on(heap), 0.6 * LAMP[:2] / np.hypot(*LAMP[:2])
    bright, dark = (light[surface(heap, place)] for place in (aside, -aside))
    assert (bright > dark + 0.08).all()
    assert light.max() < 1.1 and light.min() > 0.3
    assert bright[0] / bright[2] > 1.02 * dark[0] / dark[2], (
        "shadows are lit by the sky, which is blue"
    )


def test_a_hollow_is_darker_than_a_top(heap):
    hollow = heaped(hollow=0.12)
    top, bottom = (light_on(x)[surface(x, (0.0, 0.0)), 0] for x in (heap, hollow))
    assert bottom < 0.9 * top


def test_light_follows_the_material_not_the_lattice(heap):
    moved = light_on(heap + np.array([0.513, -0.27, 0.031], np.float32))
    top = [surface(heap, place) for place in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5))]
    np.testing.assert_allclose(moved[top], light_on(heap)[top], atol=0.04)
    apart = np.concatenate([heap, [[500, 500, 0]]]).astype(np.float32)
    np.testing.assert_allclose(light_on(apart)[top], light_on(heap)[top], atol=0.04)


@pytest.mark.parametrize("sigma", [1.4, 3.0])
def test_the_filter_equals_the_one_of_scipy(sigma):
    values = np.random.default_rng(0).random((13, 5, 9)) < 0.2
    wanted = scipy.ndimage.gaussian_filter(values.astype(np.float32), sigma, truncate=2.5)
    np.testing.assert_allclose(blur(values, sigma), wanted, atol=1e-6)


def test_light_has_no_blocks_of_cells(heap):
    """Otherwise snow looks like a pile of cubes: all grains of a cell would have one light."""
    x, y, z = heap.T
    side = (np.abs(y) < 0.01) & (np.abs(z - 0.3) < 0.01) & (x > 0)
    light = light_on(heap)[side, 0][np.argsort(x[side])]
    assert len(np.unique(light)) > 0.9 * len(light) > 10


def test_a_white_tint_keeps_the_contrast_of_bright_parts():
    """Otherwise the bright half of a white object would be a white spot without any shape."""
    body, rgb = ball(300), np.linspace([0.5] * 3, [1.0] * 3, 300)
    body = Gaussians.from_rgb(body.means, body.quats, body.scales, body.opacities, rgb)
    white = tint(body, np.ones(300, bool), (0.98, 0.99, 1.0), 0.3, fine=False).rgb.mean(axis=1)
    assert white[290] > white[220] + 0.02 and white[220] > white[150] + 0.02


def test_patches_of_several_colours_vanish_and_eyes_stay():
    """Otherwise a dark head would be a dark patch in the heap of sand."""
    grid = np.stack(np.mgrid[0:1:60j, 0:1:60j], axis=-1).reshape(-1, 2)
    means = np.column_stack([grid, np.zeros(len(grid))])
    dark, eye = means[:, 0] < 0.5, np.hypot(*(means[:, :2] - (0.75, 0.5)).T) < 0.03
    rgb = np.repeat(np.where(dark, 0.3, 0.9) * np.where(eye, 0.2, 1), 3).reshape(-1, 3)
    quats, scales = np.tile([1.0, 0, 0, 0], (len(grid), 1)), np.full(means.shape, 0.01)
    board = Gaussians.from_rgb(means, quats, scales, np.ones(len(grid)), rgb)
    plain, fine = (
        tint(board, np.ones(len(grid), bool), (0.5, 0.4, 0.3), 0.3, fine=which).rgb[:, 0]
        for which in (False, True)
    )
    left, right = (np.abs(means[:, 0] - place) < 0.1 for place in (0.2, 0.8))
    right &= ~eye
    assert plain[left].mean() < 0.85 * plain[right].mean()
    assert fine[left].mean() == pytest.approx(fine[right].mean(), rel=0.01)
    assert fine[eye].mean() < 0.88 * fine[right].mean()


@pytest.mark.parametrize("law", ["sand", pytest.param("snow", marks=pytest.mark.slow)])
def test_tinted_grains_are_lit_and_the_picture_of_others_stays(law):
    quick = Scene.named(law).replaced({"accuracy": {"cells": 8}, "time.frames": 2})
    clip = Simulation(prepare(ball(300), quick)).run()
    (matte,) = find_matte(clip.report["matte"], clip.report["grid"]["dx"])
    assert len(matte.which) == len(clip.opacities) > 300
    shine = make_shine(clip, quick.view)
    assert shine is not None
    frame = shine.shape(clip.frame(1))
    light = matte.light(clip.means[1], LAMP)
    np.testing.assert_allclose(frame.gaussians.sh, illuminate(clip.frame(1).gaussians.sh, light))
    assert np.ptp(light[:300, 0]) > 0.15
    _, gloss = add_gloss(clip, quick.view)
    assert gloss["laws"] == [] and gloss["hues"].shape == (2, len(clip.opacities), 4)
    np.testing.assert_allclose(gloss["hues"][1, :, :3] / 255, frame.gaussians.rgb, atol=0.003)
    for change in ({"material.tint": "none"}, {"grains": False}, {"view.shine": False}):
        other = quick.replaced(change)
        clip = Simulation(prepare(ball(300), other)).run()
        plain = make_shine(clip, other.view)
        if plain is not None:  # untinted snow breaks into fragments
            kept = plain.shape(clip.frame(1)).gaussians.sh
            np.testing.assert_array_equal(kept, clip.frame(1).gaussians.sh)
