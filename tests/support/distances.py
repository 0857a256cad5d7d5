"""Signed distances from walls, computed by the device functions of the walls."""

import numpy as np
import warp as wp

from phy124.kernels.lattice.contact import make_distances


def distances(shape: str, geometry, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals [N,3] and signed distances [N] of points [N,3]."""
    out = wp.zeros(len(x), dtype=wp.vec4d)
    inputs = [wp.mat33d(*np.ravel(geometry)), wp.array(x, dtype=wp.vec3d)]
    wp.launch(make_distances(shape, wp.float64), len(x), inputs=inputs, outputs=[out])
    return out.numpy()[:, :3], out.numpy()[:, 3]
