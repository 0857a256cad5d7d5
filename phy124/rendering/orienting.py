"""Renders Gaussians from a file with unknown axes in each possible orientation."""

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile, Reading, normalise_size
from phy124.io.axes import FRONTS, orientation, rotate_gaussians
from phy124.particles.thinning import thin
from phy124.rendering.render import BLACK, WHITE, Renderer

ENOUGH = 30_000
UPS = ("-y", "y", "z", "-z", "x", "-x")
"""The six possible up axes, with the most common axis first."""
TURNS = ("x", "y", "z", "-x", "-y", "-z")
UNTURNED = Reading(up="z", front="x")
"""Axes of a file that needs no rotation, because they are the axes of phy124."""


def candidates(up: str | None) -> list[Reading]:
    """Return the orientations in which the object of a file is drawn.

    There is one orientation for each up axis or, if the up axis is known, for each front axis.
    """
    if up is None:
        return [Reading(up=axis, front=FRONTS[axis]) for axis in UPS]
    return [Reading(up=up, front=axis) for axis in TURNS if axis[-1] != up[-1]]


def samples(path: str) -> tuple[Gaussians, tuple[str, ...]]:
    """Read at most `ENOUGH` of a file's Gaussians, in the file's axes; return them with notes.

    Raises:
        InputError: The file cannot be read (see `PlyFile.open`), or all centres coincide.
    """
    opened = PlyFile(path, UNTURNED).open()
    few = thin(opened.gaussians, ENOUGH, seed=0)
    return normalise_size(few, path), opened.notes


def draw_oriented(
    renderer: Renderer, gaussians: Gaussians, reading: Reading, size: int, *, alpha: bool = False
) -> NDArray[np.uint8]:
    """Render the object [size,size,3] from its front, slightly from the left and from above.

    Args:
        renderer: The renderer.
        gaussians: The object in the axes of its file, of any size.
        reading: The file's axes that point up and to the front.
        size: Width and height of the picture [pixels].
        alpha: Whether the background is transparent, with the coverage as the fourth channel.
            Otherwise the background is white.

    Raises:
        InputError: The centres of all Gaussians coincide.
    """
    standing = normalise_size(rotate_gaussians(gaussians, orientation(reading.up, reading.front)))
    camera = Camera.orbit(20.0, 15.0, 1.6, size)
    image = renderer(standing, camera, BLACK if alpha else WHITE, alpha=alpha)
    if alpha:
        image[..., :3] /= np.maximum(image[..., 3:], 1e-3)
    return (np.clip(image, 0, 1) * 255).round().astype(np.uint8)
