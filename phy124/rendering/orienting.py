"""Pictures of Gaussians in all orientations that a file of unknown axes may have."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile, Reading, normalised
from phy124.io.axes import FRONTS, orientation, turned
from phy124.particles.thinning import thin
from phy124.rendering.render import Renderer

ENOUGH = 30_000
"""Gaussians that show which way is up."""
UPS = ("-y", "y", "z", "-z", "x", "-x")
"""Ways up, the most usual first."""
TURNS = ("x", "y", "z", "-x", "-y", "-z")
UNTURNED = Reading(up="z", front="x")
"""Reads a file without any rotation: these are our own axes."""


def candidates(up: str | None) -> list[Reading]:
    """The ways up, each with its usual front; of a known way up, its fronts."""
    if up is None:
        return [Reading(up=axis, front=FRONTS[axis]) for axis in UPS]
    return [Reading(up=up, front=axis) for axis in TURNS if axis[-1] != up[-1]]


def samples(path: str) -> tuple[Gaussians, tuple[str, ...]]:
    """Enough of a file's Gaussians for pictures, in the axes of the file, and notes on the file.

    Raises:
        InputError: As `PlyFile.open`, or if all centres lie in one point.
    """
    opened = PlyFile(path, UNTURNED).open()
    few = thin(opened.gaussians, ENOUGH, seed=0)
    return normalised(few, path), opened.notes


def drawn(
    renderer: Renderer, gaussians: Gaussians, reading: Reading, size: int
) -> NDArray[np.uint8]:
    """The object from its front, a little from the left and from above [size,size,3].

    Args:
        renderer: Draws it.
        gaussians: The object in the axes of its file, of any size.
        reading: Which of these axes point up and to the front.
        size: Side of the picture [pixels].

    Raises:
        InputError: If all centres lie in one point.
    """
    standing = normalised(turned(gaussians, orientation(reading.up, reading.front)))
    image = renderer(standing, Camera.orbit(20.0, 15.0, 1.6, size))[..., :3]
    return (np.clip(image, 0, 1) * 255).round().astype(np.uint8)
