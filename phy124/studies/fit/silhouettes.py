"""Measures silhouettes (the covered fraction of each pixel), and aligns videos."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.studies.fit.observation import Groups, Values, at_times
from phy124.studies.fit.video import SIDE, Film, shrunk

LONGEST = 64
"""Longest side of the compared silhouettes [pixels]; a cell of a `draft` is about 2 pixels."""
BLUR = 1.0
"""Standard deviation of the blur [pixels].

With blur, the difference has a gradient even if the silhouettes' edges do not overlap.
"""
BLOCK = 8
"""Side of a block of pixels [pixels]; errors in a block are assumed to be correlated in all frames.

For a video of a pressed cow, blocks of 8 and 12 pixels give equal intervals (within 7 %). Smaller
blocks give narrower intervals, because errors of adjacent pixels are correlated. With blocks of 16
pixels, the interval depends on only three blocks.
"""


class Silhouettes:
    """Measured silhouettes: the fraction of each pixel of a video that the object covers."""

    name, unit = "silhouettes", "of a pixel"

    def __init__(self, film: Film, times: Values, cameras: Sequence[Camera]) -> None:
        """Reduce the silhouettes of a video to `LONGEST` pixels.

        `times` [T] are the times of the video's frames [s]. Each frame of the scene has a camera.

        Raises:
            InputError: The aspect ratio of the video differs from that of the camera.
        """
        height, width = film.masks.shape[1:]
        camera = cameras[0]
        if abs(width / height - camera.width / camera.height) > 0.02:
            limit = f"its frames, reduced in size, have {width} x {height} pixels; the camera has "
            remedy = f"Add --set view.size=[{width},{height}]."
            asked = f"{limit}{camera.width} x {camera.height}."
            raise InputError("target", f"{len(times)} pictures", asked, remedy)
        part = LONGEST / max(width, height)
        self._size = (max(round(width * part), 1), max(round(height * part), 1))
        self._cameras = [smaller(each, self._size) for each in cameras]
        self._times, self.last = times, float(times.max())
        covered = shrunk(film.masks, self._size)
        self.measured = _blur(covered).ravel()
        self.groups: Groups = _blocks(covered.shape)

    def predict(self, clip: Clip) -> Values:
        """Predict the silhouettes [M] from a clip."""
        from phy124.rendering.render import Renderer

        draw = Renderer(device="cpu", filter="mip")
        seen = zip(clip.surface.frames(), self._cameras, strict=False)
        alphas = [draw(frame.gaussians, camera, alpha=True)[..., 3] for frame, camera in seen]
        return _blur(at_times(clip.times, np.stack(alphas).astype(float), self._times)).ravel()

    def apart(self, predicted: Values) -> Values:
        """Return the RMS difference of the coverage, 0..1, for each frame [T]."""
        squares = (predicted - self.measured) ** 2
        return np.sqrt(squares.reshape(len(self._times), -1).mean(1))


def smaller(camera: Camera, size: tuple[int, int]) -> Camera:
    """Return the same camera with another image size (width, height) [pixels]."""
    part = size[0] / camera.width
    shift = (camera.shift[0] * part, camera.shift[1] * part)
    return replace(camera, width=size[0], height=size[1], shift=shift)


def _blur(covered: Values) -> Values:
    return scipy.ndimage.gaussian_filter(covered, (0, BLUR, BLUR))


def _blocks(shape: tuple[int, ...]) -> Groups:
    """Return the index of each pixel's block [T*h*w], which is the same in all frames."""
    _, h, w = np.indices(shape)
    across = -(-shape[2] // BLOCK)
    return (h // BLOCK * across + w // BLOCK).ravel()


ALIGN_BLUR = 2.0
"""Standard deviation of the blur during alignment [pixels]."""
STEP = 0.5
"""Shift for the central differences [pixels]."""
LONGEST_STEP = 8.0
"""Longest step of the alignment [pixels]."""
SETTLED = 0.01
"""The alignment ends at a step shorter than this [pixels]."""
ROUNDS = 20
LEAST = 0.6
"""Aligned silhouettes whose intersection over union is smaller show another object or view."""


class Laid(NamedTuple):
    """The transform that aligns a video with the camera's view."""

    scale: float
    """Factor by which the video's frames are magnified."""
    shift: tuple[float, float]
    """Shift of the frames' upper left corner (right, down), relative to the image's height."""
    shared: float
    """Intersection over union of the first silhouette in the video and in the scene."""


def align_film(film: Film, gaussians: Gaussians, camera: Camera) -> tuple[Film, Laid]:
    """Align a video with the camera's view by a scale and a shift.

    The first frame must show the object at rest.

    Raises:
        InputError: The video's silhouette cannot be aligned with the object's silhouette.
    """
    from phy124.rendering.render import Renderer

    part = SIDE / max(camera.width, camera.height)
    size = (round(camera.width * part), round(camera.height * part))
    drawn = Renderer(device="cpu", filter="mip")(gaussians, smaller(camera, size), alpha=True)
    wanted = drawn[..., 3] > 0.5
    matrix = _fit_similarity(film.masks[0], wanted)
    masks = np.stack([_warp(mask.astype(np.float32), matrix, size) > 0.5 for mask in film.masks])
    shared = float(np.sum(masks[0] & wanted) / max(np.sum(masks[0] | wanted), 1))
    if shared < LEAST:
        limit = f"its first outline and that of the object share {shared:.0%} of their area."
        remedy = "Begin the video with the object at rest, seen from --side."
        raise InputError("align", True, limit, remedy)
    pictures = np.stack(
        [_warp(picture, matrix, size, cv2.BORDER_REPLICATE) for picture in film.pictures]
    )
    shift = (float(matrix[0, 2] / size[1]), float(matrix[1, 2] / size[1]))
    scale = float(matrix[0, 0] * film.masks.shape[1] / size[1])
    return Film(masks, pictures, film.fps), Laid(scale, shift, shared)


def _fit_similarity(mask: NDArray[np.bool_], wanted: NDArray[np.bool_]) -> Values:
    """Return the scale and shift [2,3] that align a mask with another mask."""
    size, masks = wanted.shape[::-1], (mask, wanted)
    areas = [max(int(outline.sum()), 1) for outline in masks]
    middles = [np.argwhere(m).mean(0)[::-1] if m.any() else np.zeros(2) for m in masks]
    # Multiplying the scale by exp(1 / radius) moves the outline by about one pixel. The unit of all
    # three parameters is therefore a pixel.
    start, radius = float(np.sqrt(areas[1] / areas[0])), float(np.sqrt(areas[1] / np.pi))
    solid, place = mask.astype(np.float32), np.zeros(3)
    goal = _blur_outline(wanted.astype(np.float32))

    def matrix(place: Values) -> Values:
        scale = start * np.exp(place[0] / radius)
        shift = middles[1] - scale * middles[0] + place[1:]
        return np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])

    def apart(place: Values) -> Values:
        return np.asarray(_blur_outline(_warp(solid, matrix(place), size)) - goal, float).ravel()

    for _ in range(ROUNDS):
        sides = [(apart(place + STEP * axis) - apart(place - STEP * axis)) for axis in np.eye(3)]
        slopes = np.stack(sides, 1) / (2 * STEP)
        step = -np.linalg.lstsq(slopes, apart(place), rcond=None)[0]
        place = place + np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        if np.abs(step).max() < SETTLED:
            break
    return matrix(place)


def _warp(
    picture: NDArray, matrix: Values, size: tuple[int, ...], border: int = cv2.BORDER_CONSTANT
) -> NDArray:
    return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=border)


def _blur_outline(mask: NDArray) -> NDArray:
    return cv2.GaussianBlur(mask, (0, 0), ALIGN_BLUR)
