"""The camera of a photograph, found by aligning pictures of the object with it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.gaussians import Gaussians
from phy124.rendering.compose.photograph import Photograph
from phy124.rendering.render import BLACK, Renderer

DISTANCES = (2.0, 1.6, 3.0)
"""Distances of the photograph's camera that are tried, in sizes of the silhouette: that of relief,
of LGM, and a longer lens."""
RIM = 0.008
"""Surroundings of the object that are looked at, too, in longest sides of the photograph."""
ROUNDS = (False, False, False, True, True)
"""Corrections of the camera: by all of the picture, or by what is near the object."""


def match(
    gaussians: Gaussians,
    photograph: Photograph,
    *,
    device: str = "cpu",
    each: Callable[[], object] = lambda: None,
) -> tuple[Camera, float]:
    """The photograph's camera, and the PSNR of its picture inside the object, dB.

    Args:
        gaussians: The object as the photograph shows it.
        photograph: The photograph.
        device: Warp's name of the device that draws.
        each: Called before each correction; may raise Cancelled.
    """
    renderer = Renderer(device=device)
    tried = []
    for distance in DISTANCES:
        camera = _first(gaussians, photograph, distance)
        for near in ROUNDS:
            each()
            tried.append((likeness(renderer, gaussians, camera, photograph), camera))
            camera = _corrected(renderer, gaussians, camera, photograph, near)
        tried.append((likeness(renderer, gaussians, camera, photograph), camera))
    quality, camera = max(tried, key=lambda pair: pair[0])
    return camera, quality


def likeness(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, photograph: Photograph
) -> float:
    """PSNR of a picture of Gaussians against the photograph inside the object, dB.

    Args:
        renderer: Draws the picture.
        gaussians: The object.
        camera: Where from.
        photograph: What it should look like.
    """
    inside = photograph.alpha > 0.99
    seen = renderer(gaussians, camera)[inside] - photograph.rgb[inside] / np.float32(255)
    return float(-10 * math.log10(float((seen**2).mean()) + 1e-12))


def _first(gaussians: Gaussians, photograph: Photograph, distance: float) -> Camera:
    """A camera in front that sees the object as large and where the photograph shows it."""
    means = gaussians.means[gaussians.opacities > 0.1].astype(float)
    means = means[np.isfinite(means).all(axis=1)]
    low, high = means.min(axis=0), means.max(axis=0)
    x, y, z = (low + high) / 2
    size = float((high - low)[1:].max())
    rows, columns = np.nonzero(photograph.alpha > 0.5)
    height, width = photograph.alpha.shape
    # A focal length of a thousand pixels, to see how large it then is.
    camera = _camera((x + distance * size, y, z), (x, y, z), (width, height), 1000.0, (0.0, 0.0))
    pixels, _ = camera.project(means)
    seen = pixels.max(axis=0) - pixels.min(axis=0)
    wanted = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1], float)
    scale = float(np.sqrt(np.prod(wanted / seen)))
    middle = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
    centre = np.array([width, height]) / 2
    shift = middle - centre - scale * ((pixels.max(axis=0) + pixels.min(axis=0)) / 2 - centre)
    return _camera(camera.eye, camera.target, (width, height), 1000 * scale, tuple(shift.tolist()))


def _camera(
    eye: tuple[float, ...], target: tuple[float, ...], size: tuple[int, int], focal: float,
    shift: tuple[float, ...],
) -> Camera:  # fmt: skip
    fov = math.degrees(2 * math.atan(size[1] / 2 / focal))
    (ex, ey, ez), (tx, ty, tz), (sx, sy) = eye, target, shift
    return Camera((ex, ey, ez), (tx, ty, tz), *size, fov, (sx, sy))


def _corrected(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, photograph: Photograph, near: bool
) -> Camera:
    """The camera, zoomed and shifted so that its picture fits the photograph better.

    The picture is aligned with the photograph by Evangelidis and Psarakis' ECC (2008).
    """
    import cv2

    image = renderer(gaussians, camera, BLACK, alpha=True)
    drawn = (image[..., :3].mean(axis=2) + 0.3 * image[..., 3]).astype(np.float32)
    grey = photograph.rgb.mean(axis=2) / 255 * photograph.alpha + 0.3 * photograph.alpha
    warp = np.eye(2, 3, dtype=np.float32)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-6)
    try:
        looked_at = _near(photograph) if near else np.ones(grey.shape, np.uint8)
        _, warp = cv2.findTransformECC(
            grey.astype(np.float32), drawn, warp, cv2.MOTION_AFFINE, until, looked_at, 5
        )
    except cv2.error:
        return camera
    # A pixel p of the photograph is the picture's at scale p + offset; centres are at + 1/2.
    scale = float(np.sqrt(abs(np.linalg.det(warp[:, :2]))))
    if not 0.5 < scale < 2:
        return camera
    centre = np.array(camera.centre)
    middle = np.linalg.solve(warp[:, :2], centre - 0.5 - warp[:, 2]) + 0.5
    size = (camera.width, camera.height)
    shift = tuple((middle - np.array(size) / 2).tolist())
    return _camera(camera.eye, camera.target, size, camera.focal / scale, shift)


def _near(photograph: Photograph) -> NDArray[np.uint8]:
    """The object and its rim [H,W].

    Without what is drawn beyond it: the arc of a flat end that the picture shows as a line.
    """
    import cv2

    reach = max(1, round(RIM * max(photograph.alpha.shape)))
    inside = (photograph.alpha > 0.5).astype(np.uint8)
    return np.asarray(cv2.dilate(inside, np.ones((2 * reach + 1,) * 2)), np.uint8)
