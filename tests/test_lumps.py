"""Lumps of snow: noise that belongs to the body, and the strength that follows from it."""

import numpy as np
import pytest

from phy124.materials import Snow
from phy124.materials.lumps import LENGTH, lumps


@pytest.fixture
def x(rng):
    """Points of a cube with sides of 1 m, whose corners are among them [N,3]."""
    return np.concatenate([rng.uniform(size=(20_000, 3)), np.zeros((1, 3)), np.ones((1, 3))])


def test_the_noise_has_mean_zero_and_deviation_one(x):
    noise = lumps(x)
    assert abs(noise.mean()) < 0.15
    assert noise.std() == pytest.approx(1, abs=0.15)


def test_the_noise_moves_and_grows_with_the_body(x):
    np.testing.assert_allclose(lumps(3 * x + 5), lumps(x), rtol=0, atol=1e-9)


def test_neighbours_are_alike_and_mirror_images_are_not(x):
    noise = lumps(x)
    near = lumps(np.concatenate([x[:-2] + LENGTH / 30, x[-2:]]))
    assert np.corrcoef(noise[:-2], near[:-2])[0, 1] > 0.9
    mirrored = lumps(x * [-1, 1, 1] + [1, 0, 0])
    assert abs(np.corrcoef(noise, mirrored)[0, 1]) < 0.3


def test_uneven_snow_differs_in_strength_only(x):
    rows = Snow(unevenness=0.7).histories(x)
    assert (rows[:, 0] == 0).all()
    np.testing.assert_allclose(np.log1p(rows[:, 1]), 0.7 * lumps(x))
    assert not Snow().histories(x).any()
