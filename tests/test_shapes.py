"""The ball for studies without a picture: closed, even, of the size it says."""

import numpy as np
import pytest

from phy124.gaussians import rotation_matrices
from phy124.generators.shapes import FLATNESS, ball


@pytest.mark.parametrize("diameter", [0.3, 2.0])
def test_a_shell_of_discs_that_face_outwards(diameter):
    made = ball(1000, diameter)
    radii = np.linalg.norm(made.means, axis=1)
    np.testing.assert_allclose(radii, diameter / 2, rtol=1e-5)
    np.testing.assert_allclose(made.means.mean(axis=0), 0, atol=1e-3 * diameter)
    flat = rotation_matrices(made.quats)[:, :, made.scales[0].argmin()]
    outwards = np.abs((flat * made.means).sum(axis=1) / radii)
    np.testing.assert_allclose(outwards, 1, atol=1e-4)
    assert made.scales.min() / made.scales.max() == pytest.approx(FLATNESS, rel=1e-5)


def test_discs_cover_the_sphere_whatever_their_number():
    for count in (500, 4000):
        areas = np.pi * (2 * ball(count).scales[:, 0]) ** 2
        assert 1.2 < areas.sum() / np.pi < 8, "two sigmas of each, against the area of the sphere"


def test_nearest_neighbours_are_evenly_far():
    means = ball(1000).means.astype(float)
    apart = np.linalg.norm(means[:, None] - means[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=1)
    assert nearest.max() / nearest.min() < 1.6
