"""Material that is moved to voxels of another size."""

import numpy as np
import pytest

from phy124.particles.resampling import average
from phy124.particles.solid import find_interior
from support.shapes import ball
from support.solids import box_of_discs, frame


def bodies():
    bar = box_of_discs(np.array([0.9, 0.3, 0.04]), frame((20, 25)), np.zeros(3), 0.013)
    board = box_of_discs(np.array([1, 0.7, 0.02]), np.eye(3), np.array([0, 0, 0.01]), 0.013)
    made = {"ball": ball(1000), "bar": bar, "board": board}
    return {name: find_interior(gaussians) for name, gaussians in made.items()}


def moments(solid, material):
    """Return the volume [m^3], the centre [3], m, and the second moments [3,3], m^2."""
    index = np.stack(np.unravel_index(material.voxel, solid.fraction.shape), axis=1)
    x = (index + solid.first + 0.5 + material.shift) * solid.voxel
    share = material.fraction / material.fraction.sum()
    centre = share @ x
    spread = np.einsum("k,kij->ij", share, material.spread) * solid.voxel**2
    arm = x - centre
    volume = material.fraction.sum() * solid.voxel**3
    return volume, centre, spread + np.einsum("k,ki,kj->ij", share, arm, arm)


@pytest.mark.parametrize("name", ["ball", "bar"])
@pytest.mark.parametrize("factor", [0.6, pytest.param(1.7, marks=pytest.mark.slow), 3.1])
def test_volume_centre_and_moments_stay_the_same(name, factor):
    solid = bodies()[name]
    same = solid._move_to(solid.voxel)
    volume, centre, second = moments(solid, same)
    assert volume == pytest.approx(solid.volume, rel=1e-5)
    other = solid.resample(factor * solid.voxel)
    moved = moments(other, solid._move_to(other.voxel))
    assert moved[0] == pytest.approx(volume, rel=1e-4)
    assert np.allclose(moved[1], centre, atol=1e-5)
    assert np.allclose(moved[2], second, atol=1e-6)


@pytest.mark.parametrize("factor", [1.00003, 1.3])
@pytest.mark.parametrize("name", ["ball", "bar", "board"])
def test_material_lies_within_its_voxel(name, factor):
    """If the voxels are almost the same, cubes are divided into very thin slices."""
    solid = bodies()[name]
    material = solid._move_to(factor * solid.voxel)
    assert np.abs(material.shift).max() < 0.5
    assert material.fraction.min() > 0 and material.fraction.max() < 1 + 1e-9
    # The largest spread is that of material at two opposite sides.
    least, *_, most = np.linalg.eigvalsh(material.spread).T
    assert least.min() > -1e-9 and most.max() < 0.25


def test_average_of_coarser_and_finer_voxels_keeps_the_sum():
    values = np.random.default_rng(0).random((4, 5, 6))
    start = np.array([3, -2, 0])
    for step in (0.03, 0.05, 0.17):
        _, mean = average(values, start, 0.05, step)
        assert mean.sum() * step**3 == pytest.approx(values.sum() * 0.05**3)
    first, mean = average(values, start, 0.5, 1.0)
    assert list(first) == [1, -1, 0]
    assert mean[1, 1, 0] == pytest.approx(values[1:3, 2:4, :2].mean())
