"""Describes to the kernels how a camera projects Gaussians onto the screen."""

import math
from typing import Any

import numpy as np
import warp as wp

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.kernels.splat import screen

Filter = tuple[float, bool]

FILTERS = {"dilate": (0.3, False), "mip": (0.1, True)}
"""Anti-aliasing filters: what is added to the screen covariance [px^2], and whether opacities are
reduced to compensate.

3D Gaussian Splatting does not reduce opacities, so thin objects look too thick from far away.
Mip-Splatting reduces opacities (Yu et al. 2024, section 4.2).
"""
NEAR = 0.01
"""Smallest distance between the camera and the centre of a Gaussian that is drawn, m."""
FRUSTUM_MARGIN = 1.3
"""The projection is linearised at a Gaussian's centre, or at this multiple of half the image if the
centre is farther outside (Kerbl et al. 2023).
"""
MAX_PIXELS = 1 << 26
"""Number of pixels of the largest image (8192 x 8192)."""


def make_view(camera: Camera, filter: Filter) -> Any:
    """Return a camera with an anti-aliasing filter (a value of `FILTERS`), as a `screen.View`.

    Raises:
        InputError: The camera or the size of its image cannot be used.
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
            "the camera has no viewing direction or no field of view.",
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
    view.low_pass, view.keeps_light = filter
    view.low_area = float(np.float32(view.low_pass) ** 2)
    return view
