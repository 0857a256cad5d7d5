"""relief: fronts whose shape is determined by a depth map."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import rotation_matrices
from phy124.generators.relief import relief
from support.drawings import X, Y, face


def ramp():
    """A depth map of a disc whose left side is nearer than its right one, on a far background."""
    return np.where(np.hypot(X - 96, Y - 96) < 84, 300.0 - X, 0.0)


def test_a_depth_map_gives_the_front_its_shape():
    gaussians = relief(face(), count=5000, depth=ramp())
    front = gaussians.select(rotation_matrices(gaussians.quats)[:, 0, 2] > 0.3)
    left, right = (abs(front.means[:, 1] - side) < 0.05 for side in (-0.3, 0.3))
    assert front.means[left, 0].mean() > front.means[right, 0].mean() + 0.15
    # Its unit does not matter, nor does its resolution.
    doubled = relief(face(), count=5000, depth=np.kron(1000 + 3 * ramp(), np.ones((2, 2))))
    np.testing.assert_allclose(np.ptp(doubled.means, axis=0), np.ptp(gaussians.means, axis=0), 0.02)


def test_a_plane_depth_map_gives_a_plane_front():
    """Noise of rounding is not taken for shape."""
    noise = np.random.default_rng(0).integers(0, 2, (192, 192))
    gaussians = relief(face(), count=5000, depth=np.where(ramp() > 0, 200 + noise, 0))
    middle = np.hypot(gaussians.means[:, 1], gaussians.means[:, 2]) < 0.35
    front = gaussians.means[middle & (gaussians.means[:, 0] > 0), 0]
    assert np.ptp(front) < 0.05


@pytest.mark.parametrize(
    ("depth", "why"),
    [
        (-ramp(), "farther away than its surroundings.*--near black"),
        (ramp()[:, :100], "has 100 x 192 pixels, but the picture has 192 x 192"),
        (np.ones((192, 192)), "are equal"),
    ],
)
def test_depth_maps_that_cannot_be_meant_are_refused(depth, why):
    with pytest.raises(InputError, match=why):
        relief(face(), count=1000, depth=depth)
