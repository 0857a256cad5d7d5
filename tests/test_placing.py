"""The object is brought to the scene's size and height, and its surroundings go with it."""

import numpy as np
import pytest

from phy124.gaussians import join
from phy124.particles import Particles
from phy124.scene import Scene
from phy124.simulation.placing import (
    find_placement,
    mask_object,
    number_among_all,
    place,
    renumber_parts,
)
from support.shapes import ball

SIGMA = 0.05
"""Distance by which the Gaussians of these balls extend beyond their centres, in sizes."""


@pytest.fixture
def captured():
    """A ball of 2 m off the origin, and 100 Gaussians of its floor."""
    away = np.array([3.0, -1.0, 5.0])
    return join([ball(300).transform(2.0, away), ball(100).transform(4.0, away)])


def scene(**changes) -> Scene:
    return Scene.named("drop").replaced({"object.size": 0.5, "object.lift": 0.2, **changes})


def test_the_object_stands_at_its_size_over_the_origin():
    placed = place(
        ball(300).transform(2.0, np.array([3.0, -1.0, 5.0])), scene(), np.ones(300, bool)
    )
    low, high = placed.means.min(axis=0), placed.means.max(axis=0)
    np.testing.assert_allclose((high - low).max(), 0.5, rtol=2 * SIGMA)
    np.testing.assert_allclose((low + high)[:2], 0, atol=5e-3)
    np.testing.assert_allclose(low[2], 0.2, atol=0.02)


def test_only_the_object_is_measured_and_lifted(captured):
    selected = np.arange(400) < 300
    lifted, standing = (place(captured, scene(**{"object.lift": h}), selected) for h in (0.2, 0.0))
    assert np.ptp(lifted.means[selected], axis=0).max() == pytest.approx(0.5, rel=2 * SIGMA)
    np.testing.assert_allclose(
        lifted.means[selected, 2] - standing.means[selected, 2], 0.2, atol=1e-6
    )
    np.testing.assert_array_equal(lifted.means[~selected], standing.means[~selected])


def test_scale_and_offset_are_those_of_the_object_alone(captured):
    selected = np.arange(400) < 300
    scale, offset = find_placement(captured, scene(), selected)
    alone = find_placement(captured.select(selected), scene(), np.ones(300, bool))
    assert (scale, offset.tolist()) == (alone[0], alone[1].tolist())


def test_parts_say_which_gaussians_are_surroundings():
    parts = [{"gaussians": (300, 400), "surroundings": True, "static": True}]
    selected = mask_object(Scene().replaced({"parts": parts}), 400)
    assert selected[:300].all() and not selected[300:].any()
    assert mask_object(Scene(), 400).all()


def test_particles_have_the_index_of_their_gaussian():
    selected = np.array([False, True, False, True, True])
    first = np.ones(4)
    particles = Particles(
        np.zeros((4, 3)), first, first, first.astype(np.int32), np.array([0, 2, -1, 1], np.int32)
    )
    assert number_among_all(particles, selected).gaussian.tolist() == [1, 4, -1, 3]
    assert number_among_all(particles, np.ones(5, bool)) is particles


def test_parts_follow_gaussians_that_were_dropped():
    parts = [{"gaussians": (2, 5), "surroundings": True, "static": True}]
    before = Scene().replaced({"parts": parts})
    survivors = np.array([True, False, True, True, False, True])
    assert renumber_parts(before, survivors).parts[0].gaussians == (1, 3)
    assert renumber_parts(before, None) is before
