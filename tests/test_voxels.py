"""The filled parts of voxels: the kernel and its definition."""

import numpy as np
import pytest
from numpy.typing import NDArray

from phy124.kernels.voxels import HALVINGS
from phy124.particles.voxels import _part_moments, _Surfaces, find_voxels

COUNT, SAMPLES = 83, 6


def fill(
    fraction: NDArray, surfaces: _Surfaces, samples: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres [V,3] and second moments [V,3,3] of the filled parts."""
    points = (np.array(list(np.ndindex(*3 * (samples,)))) + 0.5) / samples - 0.5
    arm = points - surfaces.middles[:, None]
    along = np.einsum("vsi,vi->vs", arm, surfaces.axes)
    height, out = along, np.broadcast_to(surfaces.axes[:, None], arm.shape)
    width = np.abs(surfaces.axes).sum(axis=1, keepdims=True) / samples
    if surfaces.rods:
        out = arm - along[:, :, None] * surfaces.axes[:, None]
        height = np.linalg.norm(out, axis=2)
        out /= height[:, :, None]
        width = np.full((len(fraction), 1), 1 / samples)
    low = height.min(axis=1, keepdims=True) - width
    high = height.max(axis=1, keepdims=True) + width
    share = moved = height
    for _ in range(HALVINGS):
        level = (low + high) / 2
        bottom = height - width / 2
        top = np.minimum(height + width / 2, level)
        share = np.maximum(top - bottom, 0) / width
        moved = ((bottom + top) / 2 - height) / (width * samples)
        more = share.mean(axis=1, keepdims=True) < fraction[:, None]
        low, high = np.where(more, level, low), np.where(more, high, level)
    thinner = (share**2 - 1) / (12 * samples**2)
    share /= share.sum(axis=1, keepdims=True)
    points = points + moved[:, :, None] * out
    centre = np.einsum("vs,vsi->vi", share, points)
    arm = points - centre[:, None]
    spread = np.einsum("vs,vsi,vsj->vij", share, arm, arm)
    spread += np.einsum("vs,vsi,vsj->vij", share * thinner, out, out)
    return centre, spread + np.eye(3) / (12 * samples**2)


@pytest.mark.parametrize("kind", ["planes", "rods"])
def test_kernel_fills_voxels_as_defined(kind):
    """The last thread fills only three voxels. Fractions are random, because a bisection that
    passes exactly through the surface ends at either side of it.
    """
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(COUNT, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    fraction = rng.uniform(0.01, 0.99, COUNT)
    middles = 0.2 * rng.normal(size=(COUNT, 3))
    surfaces = _Surfaces(middles, axes, rods=kind == "rods")
    for result, expected in zip(
        _part_moments(fraction, surfaces, SAMPLES), fill(fraction, surfaces, SAMPLES), strict=True
    ):
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-9)


def test_edges_and_corners_of_an_aligned_box_are_boxes():
    """The sides of the body are parallel to the faces of the voxels and cut the voxels."""
    lengths = [np.array(row) for row in ([0.3, 1, 1, 1, 0.6], [0.5, 1, 1, 0.8], [1, 1, 1, 1, 0.4])]
    x, y, z = lengths
    voxels = find_voxels(np.einsum("i,j,k->ijk", x, y, z))
    sides = np.stack([row[i] for row, i in zip(lengths, voxels.indices.T, strict=True)], axis=1)
    at_edge = (sides < 1).sum(axis=1) > 1
    inwards = np.where(voxels.indices > 1, -1, 1)
    assert at_edge.sum() == 30
    centres = inwards * (1 - sides) / 2
    np.testing.assert_allclose(voxels.shift[at_edge], centres[at_edge], rtol=0, atol=1e-9)
    moments = np.eye(3) * sides[:, None] ** 2 / 12
    np.testing.assert_allclose(voxels.spread[at_edge], moments[at_edge], rtol=0, atol=1e-9)
