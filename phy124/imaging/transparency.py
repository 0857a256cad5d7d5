"""Examines the alpha channel of images."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

REAL = 0.003
"""Smallest fraction of an image that an object covers, except in large images."""
SMALLEST = 256
"""Number of pixels that suffice for an object in a large image, whatever fraction they are."""
FAINTEST = 8
"""An image counts as empty if its largest alpha (0 to 255) is below this value."""


def has_alpha(image: Image.Image) -> bool:
    """Whether the alpha channel separates an object from a transparent background."""
    solid = np.asarray(image.convert("RGBA").getchannel("A")) > 127
    return shows_object(solid) and float(solid.mean()) <= 1 - REAL


def shows_object(solid: NDArray[np.bool_]) -> bool:
    """Whether a mask [H,W] has enough pixels for an object: `SMALLEST`, or the fraction `REAL`."""
    return bool(np.count_nonzero(solid) >= min(SMALLEST, REAL * solid.size))


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
