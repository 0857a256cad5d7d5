"""Silhouettes: how much of each pixel the object covers, seen by a known camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.studies.fit.observation import Groups, at_times
from phy124.studies.fit.table import Values
from phy124.studies.fit.video import Film, shrunk

LONGEST = 64
"""Longest side of the compared pictures [pixels]: a cell of a draft grid is about 2."""
BLUR = 1.0
"""Standard deviation by which silhouettes are blurred, so that edges that miss attract [pixels]."""
BLOCK = 16
"""Width of the blocks of pixels that are taken to err together."""


class Silhouettes:
    """What a camera sees of the object, as coverage."""

    name, unit = "silhouettes", "of a pixel"

    def __init__(self, film: Film, times: Values, cameras: Sequence[Camera]) -> None:
        """Make the film small.

        Args:
            film: What was filmed.
            times: When [T], s.
            cameras: What sees the object, for each frame of the scene.

        Raises:
            InputError: The film has another aspect ratio than the camera.
        """
        height, width = film.masks.shape[1:]
        camera = cameras[0]
        if abs(width / height - camera.width / camera.height) > 0.02:
            limit = f"its pictures, made small, are {width} x {height}, the camera's are "
            remedy = f"Add --set view.size=[{width},{height}]."
            asked = f"{limit}{camera.width} x {camera.height}."
            raise InputError("target", f"{len(times)} pictures", asked, remedy)
        part = LONGEST / max(width, height)
        self._size = (max(round(width * part), 1), max(round(height * part), 1))
        self._cameras = [smaller(one, self._size) for one in cameras]
        self._times, self.last = times, float(times.max())
        covered = shrunk(film.masks, self._size)
        self.measured = _blurred(covered).ravel()
        self.groups: Groups = _blocks(covered.shape)

    def predicted(self, clip: Clip) -> Values:
        """Those of a clip."""
        from phy124.rendering.render import Renderer

        draw = Renderer(device="cpu", filter="mip")
        seen = zip(clip.surface.frames(), self._cameras, strict=False)
        alphas = [draw(frame.gaussians, camera, alpha=True)[..., 3] for frame, camera in seen]
        return _blurred(at_times(clip.times, np.stack(alphas).astype(float), self._times)).ravel()

    def apart(self, predicted: Values) -> Values:
        """Root mean square difference in each picture [T], of a pixel."""
        squares = (predicted - self.measured) ** 2
        return np.sqrt(squares.reshape(len(self._times), -1).mean(1))


def smaller(camera: Camera, size: tuple[int, int]) -> Camera:
    """The same camera with fewer pixels."""
    part = size[0] / camera.width
    shift = (camera.shift[0] * part, camera.shift[1] * part)
    return replace(camera, width=size[0], height=size[1], shift=shift)


def _blurred(covered: Values) -> Values:
    return scipy.ndimage.gaussian_filter(covered, (0, BLUR, BLUR))


def _blocks(shape: tuple[int, ...]) -> Groups:
    """Numbers of blocks of pixels, anew in each picture [T*h*w]."""
    t, h, w = np.indices(shape)
    across, down = -(-shape[2] // BLOCK), -(-shape[1] // BLOCK)
    return ((t * down + h // BLOCK) * across + w // BLOCK).ravel()
