import numpy as np
import pytest

from phy124.gaussians import Particles
from phy124.motion.smoothing import LARGEST, Smoothing

CELL = 0.1


@pytest.fixture(scope="module")
def block():
    x = np.stack(np.mgrid[0:10, 0:10, 0:6], axis=-1).reshape(-1, 3) * CELL / 2
    kind = np.zeros(len(x), np.int32)
    kind[x[:, 0] > 0.4] = 1
    each = np.ones(len(x))
    return Particles(x.astype(np.float32), each, each, kind, kind - 9)


def identities(count):
    return np.tile(np.eye(3, dtype=np.float32), (count, 1, 1))


def test_affine_motion_and_rest_stay(block):
    smoothing = Smoothing(block, np.ones(len(block), bool), CELL)
    x, F = smoothing(block.x, identities(len(block)))
    np.testing.assert_array_equal(x, block.x)
    A = np.array([[1.3, 0.4, 0], [-0.2, 0.7, 0.1], [0, 0.3, 1.1]], np.float32)
    moved = block.x @ A.T + np.float32(0.3)
    x, F = smoothing(moved, np.tile(A, (len(block), 1, 1)))
    np.testing.assert_allclose(x, moved, atol=1e-6)
    np.testing.assert_allclose(F, np.tile(A, (len(block), 1, 1)), atol=1e-6)


@pytest.mark.parametrize(("cells", "left"), [(1, 0.5), (2, 0.75)])
def test_waves_that_the_grid_does_not_resolve_become_smaller(block, cells, left):
    """A rim would be wavy otherwise."""
    chosen = block.material == 0
    smoothing = Smoothing(block, chosen, CELL)
    k, height = 2 * np.pi / (cells * CELL), 0.1 * CELL
    phase, F = k * block.x[:, 1] + 0.7, identities(len(block))
    x = block.x.copy()
    x[:, 2] += height * np.sin(phase)
    F[:, 2, 1] = height * k * np.cos(phase)
    smooth, bent = smoothing(x, F)
    inside = chosen & (np.abs(block.x[:, 1] - 0.22) < 0.1)
    assert np.ptp((smooth - block.x)[inside, 2]) < left * np.ptp((x - block.x)[inside, 2])
    assert np.abs(bent[inside, 2, 1]).max() < left * np.abs(F[inside, 2, 1]).max()
    np.testing.assert_array_equal(smooth[~chosen], x[~chosen])


def test_a_gap_stays_open(block):
    """Each half moves by three cells; averages alone would pull its edge into the gap."""
    smoothing = Smoothing(block, np.ones(len(block), bool), CELL)
    x = block.x + np.where(block.x[:, 1:2] > 0.22, 3 * CELL, 0).astype(np.float32)
    smooth, _ = smoothing(x, identities(len(block)))
    assert np.abs(smooth - x).max() < 1.01 * LARGEST * CELL


def test_materials_do_not_drag_each_other(block):
    smoothing = Smoothing(block, np.ones(len(block), bool), CELL)
    x = block.x + 0.2 * CELL * block.material[:, None].astype(np.float32)
    smooth, _ = smoothing(x, identities(len(block)))
    np.testing.assert_allclose(smooth, x, atol=1e-6)
