"""Signed distances from walls, computed by the device functions of the walls."""

from functools import cache

import numpy as np
import warp as wp

from phy124.kernels import distance
from phy124.kernels.build import kernel


@cache
def make_distances(shape: str):
    measured = distance.SHAPES[shape]

    @kernel(f"phy124_test_distance_{shape}")
    def distances(geometry: wp.mat33d, x: wp.array(dtype=wp.vec3d), out: wp.array(dtype=wp.vec4d)):
        out[wp.tid()] = measured(x[wp.tid()], geometry)

    return distances


def distances(shape: str, geometry, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals [N,3] and signed distances [N] of points [N,3]."""
    out = wp.zeros(len(x), dtype=wp.vec4d)
    inputs = [wp.mat33d(*np.ravel(geometry)), wp.array(x, dtype=wp.vec3d)]
    wp.launch(make_distances(shape), len(x), inputs=inputs, outputs=[out])
    return out.numpy()[:, :3], out.numpy()[:, 3]
