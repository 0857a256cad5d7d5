"""Lumps of snow: noise that belongs to the body, and the strength that follows from it."""

import numpy as np
import pytest

from phy124.materials import Snow
from phy124.materials.lumps import LENGTH, lumps
from phy124.mpm import Model


@pytest.fixture
def x(rng):
    """Points of a cube with sides of 1 m, whose corners are among them [N,3]."""
    return np.concatenate([rng.uniform(size=(20_000, 3)), np.zeros((1, 3)), np.ones((1, 3))])


def noise_in(x):
    """Return the noise at points x [P,3] that fill a body."""
    return lumps(x, x.min(axis=0), x.max(axis=0))


def test_the_noise_has_mean_zero_and_deviation_one(x):
    noise = noise_in(x)
    assert abs(noise.mean()) < 0.15
    assert noise.std() == pytest.approx(1, abs=0.15)


def test_the_noise_moves_and_grows_with_the_body(x):
    np.testing.assert_allclose(noise_in(3 * x + 5), noise_in(x), rtol=0, atol=1e-9)


def test_neighbours_are_alike_and_mirror_images_are_not(x):
    noise = noise_in(x)
    near = noise_in(np.concatenate([x[:-2] + LENGTH / 30, x[-2:]]))
    assert np.corrcoef(noise[:-2], near[:-2])[0, 1] > 0.9
    mirrored = noise_in(x * [-1, 1, 1] + [1, 0, 0])
    assert abs(np.corrcoef(noise, mirrored)[0, 1]) < 0.3


def test_uneven_snow_differs_in_strength_only(x):
    box = x.min(axis=0), x.max(axis=0)
    rows = Snow(unevenness=0.7).histories(x, *box)
    assert (rows[:, 0] == 0).all()
    np.testing.assert_allclose(np.log1p(rows[:, 1]), 0.7 * lumps(x, *box))
    assert not Snow().histories(x, *box).any()


def test_lumps_are_the_same_whether_stiffness_varies_or_not(x):
    stiffness = np.linspace(1e5, 2e5, 500)
    materials = [Snow(unevenness=0.7, E=E) for E in stiffness]
    material = np.arange(len(x)) % len(materials)
    volume = np.full(len(x), 1e-4)
    uniform = Model.of(x, volume, materials[:1], dx=0.1)
    varied = Model.of(x, volume, materials, dx=0.1, material=material)
    np.testing.assert_allclose(varied.history, uniform.history, rtol=0, atol=1e-9)
