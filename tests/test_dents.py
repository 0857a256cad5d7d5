from dataclasses import replace

import numpy as np
import pytest

from phy124 import Scene, Simulation, prepare
from phy124.rendering.dents import Dents
from phy124.rendering.shine import LAMP, add_gloss, make_shine
from support.clips import flight
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

CELL = 0.1


@pytest.fixture(scope="module")
def balls():
    x = ball(3000).means
    return x, Dents(np.arange(len(x)), x, CELL, LAMP)


def test_normals_point_outwards_and_follow_the_material(balls):
    x, dents = balls
    centres = dents.centres(x)
    away = centres / np.linalg.norm(centres, axis=1, keepdims=True)
    assert (dents.normals(x) * away).sum(axis=1).min() > 0.95
    flat = x * (1.4, 1, 0.5)
    slant = away / (1.4, 1, 0.5)
    slant /= np.linalg.norm(slant, axis=1, keepdims=True)
    assert np.percentile((dents.normals(flat.astype(np.float32)) * slant).sum(axis=1), 2) > 0.95


def test_sides_of_a_thin_wedge_have_their_normals():
    """Near the edge the sides are closer together than patches."""
    flat = np.stack(np.mgrid[0:0.5:60j, -0.5:0.5:60j], axis=-1).reshape(-1, 2)
    low, high = np.zeros(len(flat)), 0.4 * CELL + 0.8 * flat[:, 0]
    x = np.concatenate([np.insert(flat, 2, z, axis=1) for z in (low, high)])
    x = np.append(x, [[0, 5, 0]], axis=0)  # makes the solid large, compared with the patches
    dents = Dents(np.arange(len(x)), x, CELL, LAMP)
    at, downwards = dents.centres(x), -dents.normals(x)[:, 2]
    near = (np.abs(at[:, 1]) < 0.4) & (at[:, 0] > 0.05) & (at[:, 0] < 0.2)
    low = near & (at[:, 2] < 0.1 * CELL)
    assert low.sum() > 10 and downwards[low].min() > 0.93
    assert (near & ~low).sum() > 10 and downwards[near & ~low].max() < -0.7


def test_light_follows_the_shape_and_the_picture_stays_at_rest(balls):
    x, dents = balls
    rgb = np.full((len(x), 3), 0.5, np.float32)
    np.testing.assert_array_equal(dents.illuminate(rgb, x), rgb)
    np.testing.assert_allclose(dents.illuminate(rgb, x + np.float32(0.3)), rgb, atol=1e-4)
    # A dent in the top: the side that now faces away from the lamp becomes darker.
    dent = x.copy()
    inside = (np.hypot(x[:, 0], x[:, 1]) < 0.25) & (x[:, 2] > 0)
    dent[inside, 2] -= 1.6 * (x[inside, 2] - x[inside, 2].min())
    lit = dents.illuminate(rgb, dent)[:, 0]
    towards = x[:, :2] @ LAMP[:2] / np.hypot(*LAMP[:2])
    near, far = (inside & (sign * towards > 0.1) for sign in (1, -1))
    assert lit[near].mean() < 0.95 * lit[far].mean()
    assert np.abs(lit[x[:, 2] < -0.1] - 0.5).max() < 1e-6


def test_clips_of_plasticine_are_lit_and_others_are_not():
    quick = Scene.named("press").replaced({"accuracy": {"cells": 8}, "time.frames": 3})
    clay = quick.replaced({"material.law": "plasticine"})
    clip = Simulation(prepare(ball(300), clay)).run()
    shine = make_shine(clip, clay.view)
    assert shine is not None and clip.report["dents"] == [[[0, 300]]]
    first, last = (shine.shape(clip.frame(k)).gaussians.rgb for k in (0, 2))
    np.testing.assert_array_equal(first, clip.frame(0).gaussians.rgb)
    assert np.abs(last - first).max() > 0.01
    _, gloss = add_gloss(clip, clay.view)
    np.testing.assert_allclose(gloss["hues"][2, :, :3] / 255, last, atol=0.003)
    for other in (quick, clay.replaced({"view.shine": False})):
        clip = Simulation(prepare(ball(300), other)).run()
        assert make_shine(clip, other.view) is None


def test_a_single_gaussian_of_plasticine_keeps_its_colour():
    """A solid without extent has no surface whose light could change."""
    clip = flight([(0, 0, 0)], count=50)
    clip = replace(clip, report={"grid": {"dx": CELL}, "dents": [[[0, 1]], [[1, 50]]]})
    shine, frame = make_shine(clip), clip.frame(0)
    np.testing.assert_array_equal(shine.shape(frame).gaussians.rgb, frame.gaussians.rgb)
