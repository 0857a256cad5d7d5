"""A camera as the renderer's kernels expect it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.kernels.splat import screen

NEAR = 0.01
"""Gaussians whose centres are closer to the camera are not drawn, m."""
FRUSTUM_MARGIN = 1.3
"""How far out the projection is linearised, in half images (Kerbl et al. 2023)."""
MAX_PIXELS = 1 << 26
"""Number of pixels of the largest image (8192 x 8192)."""


def pinhole(camera: Camera) -> Any:
    """A `screen.View` of the camera, all but the filter.

    Raises:
        InputError: The camera or its picture's size cannot be used.
    """
    width, height = camera.width, camera.height
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InputError(
            "size",
            f"{width} x {height}",
            f"an image has 1 to {MAX_PIXELS:,} pixels.",
            "Choose a size such as 512 x 512.",
        )
    with np.errstate(all="ignore"):
        matrix = camera.view.astype(np.float32)
    if not (np.isfinite(matrix).all() and 0 < camera.fov_y < 180):
        raise InputError(
            "camera",
            camera,
            "it has no direction to look in, or no field of view.",
            "Place eye and target apart, at finite positions, and take 0 < fov_y < 180 degrees.",
        )
    view = screen.View()
    view.rotation = wp.mat33(matrix[:3, :3].ravel())
    view.translation, view.eye = wp.vec3(*matrix[:3, 3]), wp.vec3(*camera.eye)
    view.focal, view.near = camera.focal, NEAR
    x, y = camera.centre
    view.centre = wp.vec2(x, y)
    farthest = wp.vec2(max(x, width - x), max(y, height - y))
    view.limit = FRUSTUM_MARGIN * farthest / camera.focal
    view.width, view.height = width, height
    view.columns, view.rows = (math.ceil(side / screen.TILE) for side in (width, height))
    return view
