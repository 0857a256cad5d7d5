"""Depth inside a solid, on the host, against the device's signed distance."""

import numpy as np
import pytest

from phy124.mpm.depth import measure_depth
from support.device_functions import distances

VECTORS = {
    "half_space": [(0.1, 0, 0.2), (0.6, 0, 0.8), (0, 0, 0)],
    "sphere": [(0.1, 0.2, 0.3), (0.4, 0, 0), (0, 0, 0)],
    "box": [(0.1, 0.2, 0.3), (0.4, 0.3, 0.5), (0, 0, 0)],
    "capsule": [(-0.3, 0, 0), (0.4, 0.2, 0.1), (0.3, 0, 0)],
}


@pytest.mark.parametrize("shape", VECTORS)
def test_depth_is_the_negative_distance(shape, rng):
    x = rng.uniform(-1, 1, (200, 3))
    _, distance = distances(shape, VECTORS[shape], x)
    assert distance.min() < 0 < distance.max()
    np.testing.assert_allclose(
        measure_depth(shape, VECTORS[shape], x), -distance, rtol=0, atol=1e-12
    )
