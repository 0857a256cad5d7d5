"""Parts of cubes between planes."""

import numpy as np
import pytest

from phy124.particles.cuts import between, moments_below

LINE = (np.arange(60) + 0.5) / 60 - 0.5
SAMPLES = np.stack(np.meshgrid(LINE, LINE, LINE), axis=-1).reshape(-1, 3)


def test_parts_between_planes_have_the_moments_of_their_samples(rng):
    normal = rng.normal(size=(6, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.concatenate([normal, [[0, 0, 1], [0, -1, 0]]])
    height, thick = rng.uniform(-0.3, 0.3, 8), rng.uniform(0.2, 0.9, 8)
    parts = [moments_below(normal, height + sign * thick / 2) for sign in (1, -1)]
    volume, first, second = (a - b for a, b in zip(*parts, strict=True))
    np.testing.assert_allclose(volume, between(normal, height, thick), atol=1e-9, rtol=1e-7)
    for k in range(8):
        inside = SAMPLES[np.abs(SAMPLES @ normal[k] - height[k]) < thick[k] / 2]
        share = 1 / len(SAMPLES)
        np.testing.assert_allclose(volume[k], len(inside) * share, atol=0.01)
        np.testing.assert_allclose(first[k], inside.sum(axis=0) * share, atol=0.01)
        np.testing.assert_allclose(second[k], inside.T @ inside * share, atol=0.003)


@pytest.mark.parametrize("height", [0.51, 3.0, 1e3])
def test_planes_beyond_the_cube_leave_it_empty_or_full(rng, height):
    normal = np.concatenate([np.eye(3), 1e-3 * rng.normal(size=(20, 3)) + [0, 0, 1]])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    for sign, share in ((-1, 0), (1, 1)):
        volume, first, second = moments_below(normal, np.full(len(normal), sign * height))
        np.testing.assert_allclose(volume, share, atol=1e-6)
        np.testing.assert_allclose(first, 0, atol=1e-6)
        np.testing.assert_allclose(second, np.tile(share * np.eye(3) / 12, (23, 1, 1)), atol=1e-6)
