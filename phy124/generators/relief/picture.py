"""The object of a picture, at the size at which `relief` computes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.generators.depth_map import fitted
from phy124.generators.relief.front import normalised

Field = NDArray[np.float64]
Given = Image.Image | NDArray[np.uint8]
WORK = 248
"""Longest side of the silhouette during the computation, pixels."""
PADDING = 4
"""Width of the transparent border around it, pixels."""


def opened(given: Given, field: str = "image") -> Image.Image:
    """A picture with an alpha channel in which something is opaque.

    Raises:
        InputError: If nothing is; `field` says in which picture.
    """
    picture = given if isinstance(given, Image.Image) else Image.fromarray(np.asarray(given))
    picture = picture.convert("RGBA")
    if not (np.asarray(picture.getchannel("A")) > 127).any():
        limit = "Nothing in it is opaque."
        raise InputError(field, "transparent", limit, "Give a picture with an object in it.")
    return picture


def opaque_size(picture: Image.Image) -> tuple[int, int]:
    """Width and height of the opaque part of a picture."""
    left, top, right, bottom = _box(picture)
    return 1 + right - left, 1 + bottom - top


def work_picture(
    picture: Image.Image, scale: float | None = None, depth: NDArray | None = None
) -> Field:
    """The opaque part [H,W,4] in 0..1, padded by `PADDING`; a depth map is its fifth channel.

    Args:
        picture: A picture that `opened` gave.
        scale: Enlargement; None: the longest side becomes `WORK` pixels.
        depth: Depth map of the picture.
    """
    left, top, right, bottom = _box(picture)
    # One pixel more on each side keeps the half transparent edge.
    box = left - 1, top - 1, right + 2, bottom + 2
    distances = None
    if depth is not None:
        alpha = np.asarray(picture.getchannel("A"))
        distances = Image.fromarray(normalised(fitted(depth, *picture.size), alpha)).crop(box)
    picture = picture.crop(box)
    scale = scale or WORK / (1 + max(right - left, bottom - top))
    size = max(3, round(picture.width * scale)), max(3, round(picture.height * scale))
    # Filters without negative lobes: colours must not overshoot where alpha is cut at 1. Hamming is
    # the sharper one, but shows the pixels of tiny pictures as squares.
    sharp, smooth = Image.Resampling.HAMMING, Image.Resampling.BILINEAR
    picture = picture.resize(size, sharp if scale < 2 else smooth)
    rgba = np.asarray(picture, dtype=np.float64) / 255
    if distances is not None:
        far = np.asarray(distances.resize(size, smooth), dtype=np.float64)
        rgba = np.concatenate([rgba, far[..., None]], axis=2)
    return np.pad(rgba, ((PADDING, PADDING), (PADDING, PADDING), (0, 0)))


def _box(picture: Image.Image) -> tuple[int, int, int, int]:
    """Left, top, right and bottom pixel of the opaque part."""
    rows, columns = np.nonzero(np.asarray(picture.getchannel("A")) > 127)
    return int(columns.min()), int(rows.min()), int(columns.max()), int(rows.max())
