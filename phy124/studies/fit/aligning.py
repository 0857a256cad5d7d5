"""Alignment: a film whose camera is not known, laid on what the scene's camera sees at rest.

A similarity (one scale, one shift) is what is left of a camera that looks from about the right side
from some distance: it is found for the first picture, and holds for all.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.camera import Camera
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.studies.fit.silhouettes import smaller
from phy124.studies.fit.table import Values
from phy124.studies.fit.video import SIDE, Film

BLUR = 2.0
"""Standard deviation by which outlines are blurred, so that they attract each other [pixels]."""
STEP, LONGEST, SETTLED, ROUNDS = 0.5, 8.0, 0.01, 20
"""Half the distance of differences, the longest step, the one at which it ends [pixels]; steps."""
LEAST = 0.6
"""Part of their common area that two outlines must share: less is another object or side."""


class Laid(NamedTuple):
    """How a film was laid on what the camera sees."""

    scale: float
    """How much larger its pictures are shown."""
    shift: tuple[float, float]
    """Where their upper left corner then is, right and down [parts of the camera's height]."""
    shared: float
    """Area in both outlines over the area in either."""


def laid_on(film: Film, gaussians: Gaussians, camera: Camera) -> tuple[Film, Laid]:
    """A film as the camera would have taken it.

    Args:
        film: What was filmed; its first picture shows the object at rest.
        gaussians: The object at rest.
        camera: What sees it in the scene.

    Raises:
        InputError: Their outlines cannot be laid on each other.
    """
    from phy124.rendering.render import Renderer

    part = SIDE / max(camera.width, camera.height)
    size = (round(camera.width * part), round(camera.height * part))
    drawn = Renderer(device="cpu", filter="mip")(gaussians, smaller(camera, size), alpha=True)
    wanted = drawn[..., 3] > 0.5
    matrix = _fitted(film.masks[0], wanted)
    masks = np.stack([_moved(mask.astype(np.float32), matrix, size) > 0.5 for mask in film.masks])
    shared = float(np.sum(masks[0] & wanted) / max(np.sum(masks[0] | wanted), 1))
    if shared < LEAST:
        limit = f"its first outline and the object's at rest share {shared:.0%} of their area."
        remedy = "Film the object at rest first, from the side that is named."
        raise InputError("align", True, limit, remedy)
    pictures = np.stack([_moved(one, matrix, size, cv2.BORDER_REPLICATE) for one in film.pictures])
    shift = (float(matrix[0, 2] / size[1]), float(matrix[1, 2] / size[1]))
    scale = float(matrix[0, 0] * film.masks.shape[1] / size[1])
    return Film(masks, pictures, film.fps), Laid(scale, shift, shared)


def _fitted(mask: NDArray[np.bool_], wanted: NDArray[np.bool_]) -> Values:
    """The similarity [2,3] that lays a mask on another one: moments, then Gauss-Newton steps."""
    size = wanted.shape[::-1]
    areas = [max(int(one.sum()), 1) for one in (mask, wanted)]
    middles = [
        np.argwhere(one).mean(0)[::-1] if one.any() else np.zeros(2) for one in (mask, wanted)
    ]
    # All three in pixels at the outline: a scale moves that by the radius of the area.
    start, radius = float(np.sqrt(areas[1] / areas[0])), float(np.sqrt(areas[1] / np.pi))
    solid, place = mask.astype(np.float32), np.zeros(3)
    goal = _blurred(wanted.astype(np.float32))

    def matrix(place: Values) -> Values:
        scale = start * np.exp(place[0] / radius)
        shift = middles[1] - scale * middles[0] + place[1:]
        return np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])

    def apart(place: Values) -> Values:
        return np.asarray(_blurred(_moved(solid, matrix(place), size)) - goal, float).ravel()

    for _ in range(ROUNDS):
        sides = [(apart(place + STEP * one) - apart(place - STEP * one)) for one in np.eye(3)]
        slopes = np.stack(sides, 1) / (2 * STEP)
        step = -np.linalg.lstsq(slopes, apart(place), rcond=None)[0]
        place = place + np.clip(step, -LONGEST, LONGEST)
        if np.abs(step).max() < SETTLED:
            break
    return matrix(place)


def _moved(
    picture: NDArray, matrix: Values, size: tuple[int, ...], border: int = cv2.BORDER_CONSTANT
) -> NDArray:
    """A picture in another place, in a picture of another size (width, height)."""
    return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=border)


def _blurred(mask: NDArray) -> NDArray:
    return cv2.GaussianBlur(mask, (0, 0), BLUR)
