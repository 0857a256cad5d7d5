"""Examines the alpha channel of images."""

import numpy as np
from PIL import Image

REAL = 0.003
"""In a cut-out, at least this fraction of the pixels is opaque, and at least the same fraction is
transparent.
"""
FAINTEST = 8
"""An image counts as empty if its largest alpha (0 to 255) is below this value."""


def has_alpha(image: Image.Image) -> bool:
    """Whether the alpha channel separates an object from a transparent background."""
    solid = float(np.mean(np.asarray(image.convert("RGBA").getchannel("A")) > 127))
    return REAL <= solid <= 1 - REAL


def is_faint(image: Image.Image) -> bool:
    """Whether the image shows something although no pixel is opaque."""
    return FAINTEST <= _most_opaque(image) < 128


def make_solid(image: Image.Image) -> Image.Image:
    """Convert an image to RGBA, and scale a faint alpha so that its maximum becomes opaque."""
    solid = image.convert("RGBA")
    if is_faint(solid):
        most = _most_opaque(solid)
        solid.putalpha(solid.getchannel("A").point([min(255, a * 255 // most) for a in range(256)]))
    return solid


def _most_opaque(image: Image.Image) -> int:
    """Return the largest alpha, 0..255, of all pixels except the fraction `REAL` with the highest
    alpha.
    """
    alpha = np.asarray(image.convert("RGBA").getchannel("A"))
    return int(np.quantile(alpha, 1 - REAL, method="lower"))
