"""Parts of voxels between planes, and the planes that are found for the voxels of sheets."""

import numpy as np
import pytest

from phy124.particles.cuts import below, between, fill_between
from phy124.particles.voxels import find_voxels

LINE = (np.arange(60) + 0.5) / 60 - 0.5
SAMPLES = np.stack(np.meshgrid(LINE, LINE, LINE), axis=-1).reshape(-1, 3)


def directions(rng, count):
    normal = rng.normal(size=(count, 3))
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def test_parts_between_planes_have_the_moments_of_their_samples(rng):
    normal = np.concatenate([directions(rng, 6), [[0, 0, 1], [0, -1, 0]]])
    height, thick = rng.uniform(-0.3, 0.3, 8), rng.uniform(0.2, 0.9, 8)
    fraction = between(normal, height, thick)
    centre, spread = fill_between(fraction, normal, height)
    for k in range(8):
        inside = SAMPLES[np.abs(SAMPLES @ normal[k] - height[k]) < thick[k] / 2]
        assert len(inside) / len(SAMPLES) == pytest.approx(fraction[k], abs=0.01)
        np.testing.assert_allclose(centre[k], inside.mean(axis=0), atol=0.01)
        np.testing.assert_allclose(spread[k], np.cov(inside.T), atol=0.003)


def test_derivatives_are_those_of_the_volume(rng):
    normal, height, step = directions(rng, 9), rng.uniform(-1, 1, 9), 1e-4
    for order in (0, 1):
        values = [below(normal, height + part * step, 3, order) for part in (1, -1)]
        slope = (values[0] - values[1]) / (2 * step)
        np.testing.assert_allclose(slope, below(normal, height, 3, order + 1), atol=1e-3)


@pytest.mark.parametrize("thick", [0.6, 1.0])
def test_curved_sheets_keep_their_moments(thick):
    """A shell with a radius of 16 voxels that fills at most a part of each voxel."""
    radius, middle, parts = 16.0, np.array([18.3, 18.1, 17.8]), 5
    line = (np.arange(36 * parts) + 0.5) / parts
    squares = [(line - at) ** 2 for at in middle]
    square = squares[0][:, None, None] + squares[1][:, None] + squares[2]
    depth = thick / 2 - np.abs(np.sqrt(square) - radius)
    filled = np.clip(0.5 + parts * depth, 0, 1).reshape((36, parts) * 3).mean(axis=(1, 3, 5))
    voxels = find_voxels(filled)
    arm = voxels.indices + 0.5 + voxels.shift - middle
    away = np.linalg.norm(arm, axis=1)
    out, share = arm / away[:, None], voxels.fraction / voxels.fraction.sum()
    second = share @ (away - share @ away) ** 2
    second += share @ np.einsum("vi,vij,vj->v", out, voxels.spread, out)
    assert second == pytest.approx(thick**2 / 12, rel=0.06)
