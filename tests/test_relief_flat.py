"""relief: flat objects, such as pages, signs, coins and keys."""

import numpy as np
import pytest

from phy124.gaussians import rotation_matrices
from phy124.generators.relief import relief
from phy124.generators.relief.flat import stands_on_feet
from phy124.rendering.render import Renderer
from support.drawings import X, Y, extents, outlines, picture, shaded


@pytest.fixture(scope="module")
def renderer():
    return Renderer(device="cpu")


@pytest.fixture(scope="module")
def cube():
    return relief(picture((abs(X - 96) < 60) & (abs(Y - 96) < 60)), count=10_000)


@pytest.fixture(scope="module")
def tower():
    return relief(picture((abs(X - 96) < 22) & (abs(Y - 96) < 80)), count=10_000)


@pytest.mark.slow
def test_straight_edges_without_shading_make_a_slab(cube):
    """A square is a cube, a page is thin; with shading the page is a column."""
    page = (abs(X - 96) < 40) & (abs(Y - 96) < 80)
    depth, width = extents(cube, -0.2, 0.2)
    assert depth == pytest.approx(width, rel=0.1)
    thin, width = extents(relief(picture(page), count=5000), -0.2, 0.2)
    round_, _ = extents(relief(shaded(page, (X - 96) / 40), count=5000), -0.2, 0.2)
    assert thin < 0.4 * width < 0.9 * width < round_


def test_print_is_not_taken_for_shading():
    """A sign with a frame, letters and rounded corners is flat; a can with a label is round."""
    inside = 20 - np.hypot(np.maximum(abs(X - 96) - 60, 0), np.maximum(abs(Y - 96) - 20, 0))
    letters = (abs(Y - 96) < 15) & (abs(X - 96) < 60) & (X % 20 < 10)
    sign = np.where((letters | (inside < 5))[..., None], (160, 30, 30), (245, 240, 225))
    means = relief(picture(inside > 0, sign.astype(np.uint8)), count=5000).means
    assert np.ptp(means[:, 0]) < 0.2 * np.ptp(means[:, 1])
    label = np.where((abs(Y - 96) < 40)[..., None], (240, 235, 220), (200, 60, 40))
    turned = np.clip((X - 96) / 45, -1, 1)
    light = 0.75 + 0.25 * (0.85 * np.sqrt(1 - turned**2) - 0.45 * turned)
    can = (light[..., None] * label).astype(np.uint8)
    means = relief(picture((abs(X - 96) < 45) & (abs(Y - 96) < 80), can), count=5000).means
    assert np.ptp(means[:, 0]) == pytest.approx(np.ptp(means[:, 1]), rel=0.1)


def test_framed_gradient_is_not_taken_for_shading(renderer):
    """A phone is flat, and its rounded corners stay."""
    inside = 18 - np.hypot(np.maximum(abs(X - 96) - 27, 0), np.maximum(abs(Y - 96) - 62, 0))
    screen = np.stack([40 + 0.3 * Y, 50 + 0.8 * X, 180 - 0.3 * Y], axis=2)
    inputs = picture(inside > 0, np.where((inside < 5)[..., None], 15, screen).astype(np.uint8))
    phone = relief(inputs, count=20_000)
    assert np.ptp(phone.means[:, 0]) < 0.3 * np.ptp(phone.means[:, 1])
    wanted, seen = outlines(renderer, phone, inputs)
    assert (wanted & seen).sum() > 0.98 * (wanted | seen).sum()


def printed(mask, light=1.0):
    """Fine print on a material of one colour, under a light [H,W] or a number."""
    print_ = 1 + 0.15 * np.sin(1.1 * X + 0.7 * Y) * np.sin(0.5 * X - 1.3 * Y)
    return picture(mask, ((light * print_)[..., None] * [180, 150, 60]).astype(np.uint8))


def test_objects_without_shading_are_flat():
    """A coin and a key are; the ball and the rod with the same outlines are round."""
    distance = np.hypot(X - 96, Y - 96) / 80
    coin = relief(printed(distance < 1), count=3000).means
    assert np.ptp(coin[:, 0]) < 0.2 * np.ptp(coin[:, 1])
    towards = np.sqrt(np.clip(1 - distance**2, 0, 1))
    ball = relief(printed(distance < 1, 0.5 + 0.4 * towards), count=3000).means
    assert np.ptp(ball[:, 0]) == pytest.approx(np.ptp(ball[:, 1]), rel=0.05)
    bow = np.hypot(X - 50, Y - 96)
    key = ((bow < 34) & (bow > 12)) | ((abs(X - 120) < 50) & (abs(Y - 96) < 8))
    means = relief(printed(key | ((abs(X - 150) < 6) & (abs(Y - 108) < 10))), count=3000).means
    assert np.ptp(means[:, 0]) < 0.35 * np.ptp(means[:, 2])


def test_objects_on_feet_are_not_flat():
    """Thin bodies show little shading; a dog is as deep as its body is high."""
    body = (abs(X - 90) < 70) & (abs(Y - 90) < 16) | (np.hypot(X - 160, Y - 76) < 22)
    legs = np.minimum(abs(X - 40), abs(X - 130)) < 8
    dog = relief(printed(body | (legs & (Y > 90) & (Y < 150))), count=3000).means
    assert 0.2 < np.ptp(dog[:, 0]) < 0.3
    trousers = (np.minimum(abs(X - 60), abs(X - 132)) < 30) | (Y < 70)
    assert not stands_on_feet(trousers & (abs(X - 96) < 66))


def test_walls_of_slabs_have_no_holes(cube):
    """The camera does not see the walls of a cube, but they have as many points as its front."""
    normals = rotation_matrices(cube.quats)[:, :, 2]
    reach = np.abs(cube.means).max(axis=0)
    inner = (np.abs(cube.means) < 0.7 * reach).sum(axis=1) == 2
    wall, front = abs(normals[:, 1]) > 0.95, normals[:, 0] > 0.95
    scales = [np.median(cube.scales[inner & part, 0]) for part in (wall, front)]
    assert scales[0] < 1.25 * scales[1]


def test_an_upright_bar_is_as_deep_as_wide(tower):
    """And a lying bar, such as a plank, is no paper."""
    depth, width = extents(tower, -0.2, 0.2)
    assert depth == pytest.approx(width, rel=0.1)
    plank = relief(picture((abs(X - 96) < 80) & (abs(Y - 96) < 20)), count=3000).means
    assert 0.2 * np.ptp(plank[:, 2]) < np.ptp(plank[:, 0]) < 0.4 * np.ptp(plank[:, 2])


def test_the_back_of_a_tall_slab_has_straight_edges(tower):
    """Its corners do not stick out."""
    back = tower.means[tower.means[:, 0] < -0.1]
    away, up = abs(back[:, 1]), back[:, 2]
    assert up[away > 0.08].max() == pytest.approx(up[away < 0.04].max(), abs=0.01)


def test_a_tent_is_no_paper():
    """A polygon that is no rectangle is at least a quarter as deep as the largest disc inside."""
    tent = (Y < 140) & (Y > 60) & (X > 20 + (140 - Y) * 0.6) & (X < 172 - (140 - Y) * 0.3)
    tent &= Y < 140 - 0.8 * (X - 140)
    assert np.ptp(relief(picture(tent), count=3000).means[:, 0]) > 0.11
