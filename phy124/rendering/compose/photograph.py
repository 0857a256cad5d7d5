"""A photograph, the outline of its object, and the camera that took the photograph."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.image import open_image, reduce_size
from phy124.rendering.render import BLACK, Renderer

CUTOUT = "cutout.png"
"""Name of the file in a run's folder whose alpha shows the object's position in the photograph."""
LARGEST = 1024
"""Longest side of a photograph [pixels]; larger photographs are reduced."""
MARGIN = 0.015
"""Width of the border inpainted with the object, relative to the photograph's longest side."""
HOLE = 320
"""Longest side of the picture in which holes are inpainted [pixels]; a larger picture takes longer
and gives no better result.
"""
DISTANCES = (2.0, 1.6, 3.0)
"""Camera distances that are tried, in units of the object's size in the photograph: those of relief
and LGM, and one that is typical of a longer lens.
"""
ELEVATIONS = tuple(range(0, 65, 5))
SMALL = 128
"""Longest side of the picture in which the elevations are compared [pixels]."""
CLEARER = 1.0
"""A raised camera is assumed only if it improves the PSNR by at least this difference [dB]."""
RIM = 0.008
"""Width of the border that is compared in addition to the object, relative to the photograph's
longest side.
"""
ROUNDS = (False, False, False, True, True)
"""For each round: whether only the object and a thin border are compared with the photograph."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph, and the area that its object covers."""

    rgb: NDArray[np.uint8]
    """Colours [H,W,3]."""
    alpha: NDArray[np.float32]
    """Fraction of each pixel that the object covers [H,W], 0..1."""

    @classmethod
    def of(cls, picture: Image.Image, cutout: Image.Image) -> Photograph:
        """Combine a picture with its cut-out; their sizes may differ.

        Transparent areas of the picture become white.

        Raises:
            InputError: The cut-out is empty.
        """
        size = reduce_size(picture.size[::-1], LARGEST, 16)
        on_white = Image.new("RGBA", picture.size, "white")
        on_white.alpha_composite(picture.convert("RGBA"))
        rgb = on_white.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        alpha = cutout.convert("RGBA").getchannel("A").resize(size)
        opaque = np.asarray(alpha, np.float32) / np.float32(255)
        if not (opaque > 0.5).any():
            limit = "it shows no part of the object."
            raise InputError("compose", "the cut-out", limit, "Give another picture or mask.")
        return cls(np.asarray(rgb), opaque)

    def reduce(self, longest: int) -> Photograph:
        """Return the photograph, reduced so that its sides have at most `longest` pixels."""
        size = reduce_size(self.alpha.shape, longest, 16)
        small = Image.fromarray(self.rgb).resize(size, Image.Resampling.BOX)
        opaque = Image.fromarray(self.alpha).resize(size, Image.Resampling.BOX)
        return Photograph(np.asarray(small), np.asarray(opaque))

    def erase_object(self) -> NDArray[np.uint8]:
        """Return the photograph after replacing its object by inpainting (Telea 2004)."""
        import cv2

        height, width = self.alpha.shape
        margin = max(2, round(MARGIN * max(height, width)))
        hole = cv2.dilate((self.alpha > 0.02).astype(np.uint8), np.ones((2 * margin + 1,) * 2))
        size = reduce_size(self.alpha.shape, HOLE, 8)
        small = cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA)
        inside = cv2.resize(hole, size, interpolation=cv2.INTER_NEAREST)
        if inside.all():
            return np.full_like(self.rgb, 255)
        filled = cv2.inpaint(small, inside, 3, cv2.INPAINT_TELEA)
        calm = cv2.GaussianBlur(filled, (0, 0), 0.02 * max(size))
        large = cv2.resize(calm, (width, height), interpolation=cv2.INTER_CUBIC).astype(float)
        soft = cv2.GaussianBlur(hole.astype(float), (0, 0), margin / 3)[..., None]
        mixed = np.where(hole[..., None] > 0, np.maximum(soft, 0.5), soft)
        return np.rint(mixed * large + (1 - mixed) * self.rgb).clip(0, 255).astype(np.uint8)


def match(
    gaussians: Gaussians,
    photograph: Photograph,
    *,
    device: str = "cpu",
    each: Callable[[], object] = lambda: None,
) -> tuple[Camera, float]:
    """Align a rendered picture of the object with the photograph.

    Return the photograph's camera, and the PSNR of the rendered picture inside the object [dB].

    Args:
        gaussians: The object as the photograph shows it.
        photograph: The photograph.
        device: Warp's name of the device that renders.
        each: Function that is called before each correction. It may raise Cancelled.
    """
    renderer = Renderer(device=device)
    each()
    elevation = _elevation(renderer, gaussians, photograph)
    tried = []
    for distance in DISTANCES:
        camera = _first_camera(gaussians, photograph, distance, elevation)
        for near in ROUNDS:
            each()
            tried.append((likeness(renderer, gaussians, camera, photograph), camera))
            camera = _correct_camera(renderer, gaussians, camera, photograph, near)
        tried.append((likeness(renderer, gaussians, camera, photograph), camera))
    quality, camera = max(tried, key=lambda pair: pair[0])
    return camera, quality


def likeness(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, photograph: Photograph
) -> float:
    """Return the PSNR [dB] between a rendered picture and the photograph, inside the object.

    Args:
        renderer: The renderer that renders the picture.
        gaussians: The object.
        camera: The camera to compare.
        photograph: The photograph to compare with.
    """
    inside = photograph.alpha > 0.99
    seen = renderer(gaussians, camera)[inside] - photograph.rgb[inside] / np.float32(255)
    return float(-10 * math.log10(float((seen**2).mean()) + 1e-12))


def _elevation(renderer: Renderer, gaussians: Gaussians, photograph: Photograph) -> float:
    """Return the elevation [degrees] at which the object looks most like its photograph."""
    small = photograph.reduce(SMALL)
    if not (small.alpha > 0.99).any():
        return 0.0
    quality = [
        likeness(
            renderer, gaussians, _first_camera(gaussians, small, DISTANCES[0], elevation), small
        )
        for elevation in ELEVATIONS
    ]
    best = int(np.argmax(quality))
    return float(ELEVATIONS[best]) if quality[best] > quality[0] + CLEARER else 0.0


def _first_camera(
    gaussians: Gaussians, photograph: Photograph, distance: float, elevation: float
) -> Camera:
    """Return a camera in front of the object, raised by an elevation [degrees]."""
    means = gaussians.means[gaussians.opacities > 0.1].astype(float)
    means = means[np.isfinite(means).all(axis=1)]
    low, high = means.min(axis=0), means.max(axis=0)
    x, y, z = (low + high) / 2
    size = float((high - low)[1:].max())
    rows, columns = np.nonzero(photograph.alpha > 0.5)
    height, width = photograph.alpha.shape
    # The scale is found by a trial with a focal length of a thousand pixels.
    up = math.radians(elevation)
    eye = (x + distance * size * math.cos(up), y, z + distance * size * math.sin(up))
    camera = _camera(eye, (x, y, z), (width, height), 1000.0, (0.0, 0.0))
    pixels, _ = camera.project(means)
    seen = pixels.max(axis=0) - pixels.min(axis=0)
    wanted = np.array([np.ptp(columns) + 1, np.ptp(rows) + 1], float)
    scale = float(np.sqrt(np.prod(wanted / seen)))
    middle = np.array([columns.min() + columns.max() + 1, rows.min() + rows.max() + 1]) / 2
    centre = np.array([width, height]) / 2
    shift = middle - centre - scale * ((pixels.max(axis=0) + pixels.min(axis=0)) / 2 - centre)
    return _camera(camera.eye, camera.target, (width, height), 1000 * scale, tuple(shift.tolist()))


def _camera(eye: Any, target: Any, size: tuple[int, int], focal: float, shift: Any) -> Camera:
    fov = math.degrees(2 * math.atan(size[1] / 2 / focal))
    return Camera(eye, target, *size, fov, shift)


def _correct_camera(
    renderer: Renderer, gaussians: Gaussians, camera: Camera, photograph: Photograph, near: bool
) -> Camera:
    """Align the camera with the photograph by the method ECC (Evangelidis and Psarakis 2008)."""
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
    # Pixel p of the photograph corresponds to pixel scale * p + offset of the picture. Pixel
    # centres are at half-integers.
    scale = float(np.sqrt(abs(np.linalg.det(warp[:, :2]))))
    if not 0.5 < scale < 2:
        return camera
    centre = np.array(camera.centre)
    middle = np.linalg.solve(warp[:, :2], centre - 0.5 - warp[:, 2]) + 0.5
    size = (camera.width, camera.height)
    shift = tuple((middle - np.array(size) / 2).tolist())
    return _camera(camera.eye, camera.target, size, camera.focal / scale, shift)


def _near(photograph: Photograph) -> NDArray[np.uint8]:
    """Return a mask of the object and a border. The border is needed because flat ends of the
    object are rendered too long.
    """
    import cv2

    reach = max(1, round(RIM * max(photograph.alpha.shape)))
    inside = (photograph.alpha > 0.5).astype(np.uint8)
    return np.asarray(cv2.dilate(inside, np.ones((2 * reach + 1,) * 2)), np.uint8)


def photograph_of(picture: str | os.PathLike[str], folder: Path) -> Photograph:
    """Return the photograph of a clip, with the outline of the cut-out in the folder of the run.

    Raises:
        InputError: The photograph or its cut-out cannot be opened, or there is no cut-out.
    """
    opened = open_image(picture, field="compose")
    if not (folder / CUTOUT).is_file():
        limit = f"{folder} has no {CUTOUT}, which shows where the object was."
        remedy = "Use --compose with a clip in the folder that `phy124 generate` wrote."
        raise InputError("compose", picture, limit, remedy)
    return Photograph.of(opened, open_image(folder / CUTOUT, field="compose"))
