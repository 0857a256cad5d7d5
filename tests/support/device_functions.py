"""Calls device functions: sorted glass solids of a picture, and signed distances from walls."""

from typing import NamedTuple

import numpy as np
import warp as wp

from phy124.camera import Camera
from phy124.kernels.lattice.contact import make_distances
from phy124.kernels.splat import glass
from phy124.kernels.splat.arrange import arrange
from phy124.rendering.projection import FILTERS, make_view
from phy124.rendering.stage.draw import Uploaded
from phy124.rendering.stage.frame import Backdrop, Box, Solid, StageFrame

BLACK = Backdrop((0, 0, 0), (0, 0, 0))


class Arranged(NamedTuple):
    """The sorted solids, the number of solids of each rank, and all outlines."""

    solids: np.ndarray
    counts: list[int]
    outlines: np.ndarray


def arranged(solids: list[Solid], camera: Camera, box: Box) -> Arranged:
    """Run the kernel on solids around Gaussians in a box."""
    options = Uploaded(StageFrame(BLACK, None, tuple(solids)), "cpu")
    kinds = glass.Solid, glass.Outline, int
    made = [wp.zeros(max(len(solids), 3), dtype=kind, device="cpu") for kind in kinds]
    inputs = [
        make_view(camera, FILTERS["dilate"]),
        *(wp.vec3(*corner) for corner in box),
        options.solids,
    ]
    wp.launch(arrange, len(solids), inputs=inputs, outputs=made, device="cpu")
    ordered, outlines, counts = (array.numpy() for array in made)
    return Arranged(ordered[: len(solids)], counts[:3].tolist(), outlines)


def distances(shape: str, geometry, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return normals [N,3] and signed distances [N] of points [N,3]."""
    out = wp.zeros(len(x), dtype=wp.vec4d)
    inputs = [wp.mat33d(*np.ravel(geometry)), wp.array(x, dtype=wp.vec3d)]
    wp.launch(make_distances(shape, wp.float64), len(x), inputs=inputs, outputs=[out])
    return out.numpy()[:, :3], out.numpy()[:, 3]
