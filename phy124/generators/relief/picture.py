"""Resamples the object in an image to the resolution that `relief` uses."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.generators.extras import fit_to_picture
from phy124.generators.relief.solids import normalise_depth

Field = NDArray[np.float64]
Picture = Image.Image | NDArray[np.uint8]
WORK = 248
"""Longest side of the resampled silhouette [pixels]."""
PADDING = 4
"""Width of the transparent border [pixels]."""


def open_picture(image: Picture, field: str = "image") -> Image.Image:
    """Convert an image to RGBA.

    Raises:
        InputError: If no pixel is opaque; `field` is the name of the input.
    """
    picture = image if isinstance(image, Image.Image) else Image.fromarray(np.asarray(image))
    picture = picture.convert("RGBA")
    if not (np.asarray(picture.getchannel("A")) > 127).any():
        limit = "No part of the picture is opaque."
        raise InputError(field, "transparent", limit, "Give a picture that shows an object.")
    return picture


def opaque_size(picture: Image.Image) -> tuple[int, int]:
    """Return the width and height of the opaque part [pixels]."""
    left, top, right, bottom = _box(picture)
    return 1 + right - left, 1 + bottom - top


def work_picture(
    picture: Image.Image, scale: float | None = None, depth: NDArray | None = None
) -> Field:
    """Resample the opaque part to [H,W,4 or 5] in 0..1, with a border of `PADDING` pixels.

    Args:
        picture: Image from `open_picture`.
        scale: Scale factor; None: the longest side becomes `WORK` pixels.
        depth: Depth map, which becomes the fifth channel.
    """
    left, top, right, bottom = _box(picture)
    # One more pixel on each side keeps the half-transparent edge of the object.
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
    # Both filters have no negative lobes, because colours must not overshoot where alpha is clipped
    # at 1. The Hamming filter is sharper, but would show the pixels of tiny images as squares.
    sharp, smooth = Image.Resampling.HAMMING, Image.Resampling.BILINEAR
    picture = picture.resize(size, sharp if scale < 2 else smooth)
    rgba = np.asarray(picture, dtype=np.float64) / 255
    if distances is not None:
        far = np.asarray(distances.resize(size, smooth), dtype=np.float64)
        rgba = np.concatenate([rgba, far[..., None]], axis=2)
    return np.pad(rgba, ((PADDING, PADDING), (PADDING, PADDING), (0, 0)))


def _box(picture: Image.Image) -> tuple[int, int, int, int]:
    rows, columns = np.nonzero(np.asarray(picture.getchannel("A")) > 127)
    return int(columns.min()), int(rows.min()), int(columns.max()), int(rows.max())
