"""The comparison: what was filmed, what the fitted scene shows, and where they differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.camera import Camera
from phy124.fit.table import Values
from phy124.fit.video import Film
from phy124.io.clip import Clip
from phy124.rendering.render import Renderer, to_bytes

ROWS = 8
"""Most instants that are shown."""
HEIGHT = 192
"""Height of each picture [pixels]."""
BOTH, ONLY_SEEN, ONLY_FITTED = (225, 225, 225), (213, 94, 0), (0, 114, 178)
"""Colours of the difference, which colour-blind people tell apart, too."""


def write_comparison(
    path: Path, film: Film, times: Values, clip: Clip, cameras: Sequence[Camera]
) -> None:
    """Write one picture: a row per instant of target, fitted, and difference.

    Args:
        path: The PNG file.
        film: What was filmed.
        times: When [T], s.
        clip: The fitted scene.
        cameras: What sees it, for each of its frames.
    """
    draw = Renderer(device="cpu")
    shown = np.unique(np.linspace(0, len(times) - 1, min(ROWS, len(times))).round().astype(int))
    rows = [_row(film, int(n), clip, cameras, float(times[n]), draw) for n in shown]
    Image.fromarray(np.concatenate(rows)).save(path)


def _row(
    film: Film, number: int, clip: Clip, cameras: Sequence[Camera], time: float, draw: Renderer
) -> NDArray[np.uint8]:
    """Target, fitted, and difference at an instant."""
    frame = int(np.abs(clip.times - time).argmin())
    camera = cameras[frame]
    part = HEIGHT / camera.height
    size = (round(camera.width * part), HEIGHT)
    shift = (camera.shift[0] * part, camera.shift[1] * part)
    seen = replace(camera, width=size[0], height=size[1], shift=shift)
    fitted = draw(clip.frame(frame).gaussians, seen, alpha=True)
    target = cv2.resize(film.pictures[number], size, interpolation=cv2.INTER_AREA)
    mask = cv2.resize(film.masks[number].astype(np.float32), size, interpolation=cv2.INTER_AREA)
    apart = difference(mask > 0.5, fitted[..., 3] > 0.5)
    return np.concatenate([target, to_bytes(fitted[..., :3]), apart], axis=1)


def difference(seen: NDArray[np.bool_], fitted: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Where both are, only what was seen is, and only what was fitted is, in colours [H,W,3]."""
    picture = np.full((*seen.shape, 3), 255, np.uint8)
    picture[seen & fitted] = BOTH
    picture[seen & ~fitted] = ONLY_SEEN
    picture[fitted & ~seen] = ONLY_FITTED
    return picture
