"""The object of a picture, at the resolution of `relief`'s computation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.generators.extras import fit_to_picture
from phy124.generators.relief.solids import normalise_depth

Field = NDArray[np.float64]
Given = Image.Image | NDArray[np.uint8]
WORK = 248
"""Longest side of the silhouette during the computation, pixels."""
PADDING = 4
"""Width of the transparent border around it, pixels."""


def open_picture(image: Given, field: str = "image") -> Image.Image:
    """Convert a picture to RGBA, with something opaque in it.

    Raises:
        InputError: If nothing is opaque; `field` names the picture.
    """
    picture = image if isinstance(image, Image.Image) else Image.fromarray(np.asarray(image))
    picture = picture.convert("RGBA")
    if not (np.asarray(picture.getchannel("A")) > 127).any():
        limit = "Nothing in it is opaque."
        raise InputError(field, "transparent", limit, "Give a picture with an object in it.")
    return picture


def opaque_size(picture: Image.Image) -> tuple[int, int]:
    """Return the width and height of the opaque part of a picture."""
    left, top, right, bottom = _box(picture)
    return 1 + right - left, 1 + bottom - top


def work_picture(
    picture: Image.Image, scale: float | None = None, depth: NDArray | None = None
) -> Field:
    """Return the opaque part [H,W,4] in 0..1, padded by `PADDING`; channel 5 is the depth map.

    Args:
        picture: A picture of `open_picture`.
        scale: Enlargement; None: the longest side becomes `WORK` pixels.
        depth: Depth map of the picture.
    """
    left, top, right, bottom = _box(picture)
    # One pixel more on each side keeps the half transparent edge.
    box = left - 1, top - 1, right + 2, bottom + 2
    distances = None
    if depth is not None:
        alpha = np.asarray(picture.getchannel("A"))
        distances = Image.fromarray(
            normalise_depth(fit_to_picture(depth, *picture.size), alpha)
        ).crop(box)
    picture = picture.crop(box)
    scale = scale or WORK / (1 + max(right - left, bottom - top))
    size = max(3, round(picture.width * scale)), max(3, round(picture.height * scale))
    # Filters without negative lobes, since colours must not overshoot where alpha is clipped at 1.
    # Hamming is sharper, but shows the pixels of tiny pictures as squares.
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
