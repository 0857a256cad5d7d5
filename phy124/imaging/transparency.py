"""Examines the transparency of a picture: an object cut out already, or half transparent."""

from __future__ import annotations

import numpy as np
from PIL import Image

REAL = 0.005
"""Smallest fraction of opaque and of transparent pixels of a meaningful alpha."""
FAINTEST = 8
"""Smallest alpha, of 255, of an object that is half transparent throughout."""


def has_alpha(image: Image.Image) -> bool:
    """Return whether the alpha channel separates an object from a transparent background."""
    solid = float(np.mean(np.asarray(image.convert("RGBA").getchannel("A")) > 127))
    return REAL <= solid <= 1 - REAL


def is_faint(image: Image.Image) -> bool:
    """Return whether the picture shows something of which nothing is opaque."""
    return FAINTEST <= _most_opaque(image) < 128


def make_solid(image: Image.Image) -> Image.Image:
    """Convert to RGBA; the most opaque part of a faint picture becomes opaque."""
    solid = image.convert("RGBA")
    if is_faint(solid):
        most = _most_opaque(solid)
        solid.putalpha(solid.getchannel("A").point([min(255, a * 255 // most) for a in range(256)]))
    return solid


def _most_opaque(image: Image.Image) -> int:
    """Return the largest alpha, 0..255, ignoring parts smaller than `REAL`."""
    alpha = np.asarray(image.convert("RGBA").getchannel("A"))
    return int(np.quantile(alpha, 1 - REAL, method="lower"))
