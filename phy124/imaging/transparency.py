"""A picture's own transparency: whether it separates an object, and objects that are half clear."""

from __future__ import annotations

import numpy as np
from PIL import Image

REAL = 0.005
"""Least fraction of opaque pixels, and of transparent ones, for an alpha to be meaningful."""
FAINTEST = 8
"""Least alpha of an object that is half transparent throughout, of 255."""


def has_alpha(image: Image.Image) -> bool:
    """Whether the alpha channel separates an object: some pixels opaque, some transparent."""
    solid = float(np.mean(np.asarray(image.convert("RGBA").getchannel("A")) > 127))
    return REAL <= solid <= 1 - REAL


def is_faint(image: Image.Image) -> bool:
    """Whether the picture shows something, but nothing of it is opaque."""
    return FAINTEST <= _most_opaque(image) < 128


def made_solid(image: Image.Image) -> Image.Image:
    """The picture in RGBA; if it is faint, its most opaque part is made opaque."""
    solid = image.convert("RGBA")
    if is_faint(solid):
        most = _most_opaque(solid)
        solid.putalpha(solid.getchannel("A").point([min(255, a * 255 // most) for a in range(256)]))
    return solid


def _most_opaque(image: Image.Image) -> int:
    """The alpha of the most opaque part, of 255; smaller parts than `REAL` do not count."""
    alpha = np.asarray(image.convert("RGBA").getchannel("A"))
    return int(np.quantile(alpha, 1 - REAL, method="lower"))
