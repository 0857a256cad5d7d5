"""The ball for studies without a picture: closed, even, of the size it says."""

import numpy as np
import pytest

from phy124.gaussians import rotation_matrices
from phy124.generators.relief.picture import WORK
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.shapes import FLATNESS, ball, make_shape
from phy124.particles import compute_bounds


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


@pytest.mark.parametrize("count", [8000, 600])
def test_gaussians_at_the_edges_of_a_box_do_not_extend_beyond_it(count):
    box = make_shape("box", (1.0, 0.5, 0.5), (1.0, 0.0, 0.0), count=count)
    thickness = box.scales.min()
    for end, face in zip(compute_bounds(box), (-1, 1), strict=True):
        np.testing.assert_allclose(end, face * np.array([0.5, 0.25, 0.25]), atol=1.01 * thickness)


def test_a_relief_of_few_gaussians_does_not_extend_beyond_its_surface():
    cube = make_shape("box", (1.0, 1.0, 1.0), (1.0, 0.0, 0.0), count=600)
    axes = rotation_matrices(cube.quats)
    normals = axes[np.arange(len(cube)), :, cube.scales.argmin(axis=1)]
    normals *= np.sign((normals * cube.means).sum(axis=1, keepdims=True))
    shell = Shell(WORK * cube.means, normals, np.full(len(cube), WORK / 5), cube.rgb)
    made = shell.gaussians()
    low, high = compute_bounds(made)
    thickness = max(made.scales.min(), DRAWN_IN / WORK)
    assert (high - low).max() == pytest.approx(1 + 2 * thickness, abs=1e-3)
