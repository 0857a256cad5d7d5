"""Removes highlights from an image, because they would move with the object.

A highlight is a small spot that is brighter than its surroundings by equal amounts of red, green
and blue, unless a channel is clipped. White paint mainly adds the colours that the surface lacks.
Grey surfaces are left unchanged, because paint and highlights look alike on grey.
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.generators.relief.colours import clean_picture
from phy124.generators.relief.picture import WORK, opaque_size

Field = NDArray[np.float64]
LARGEST = 0.065
"""Largest radius of a highlight, relative to the image's size."""
SMALLEST = 3
"""Smallest radius of a highlight [pixels]; narrower spots are edges between colours."""
BRIGHT = 0.08
"""Smallest difference in brightness between a highlight and its surroundings."""
NEUTRAL = 0.15
"""Largest difference between the added amounts of red, green and blue, relative to the largest
amount.
"""
COLOURED = 0.15
"""Smallest saturation of a highlight's surroundings."""
FULL = 0.985
"""Smallest value of a clipped channel."""
RIM = 2
"""Width of a highlight's faint rim [pixels]."""


def matte(picture: Image.Image) -> Image.Image:
    """Replace the highlights of an RGBA image with the colours around the highlights."""
    scale = WORK / max(opaque_size(picture))
    size = max(3, round(picture.width * scale)), max(3, round(picture.height * scale))
    small = np.asarray(picture.resize(size, Image.Resampling.BILINEAR), np.float64) / 255
    taken = np.asarray(cv2.resize(_light(small), picture.size, interpolation=cv2.INTER_LINEAR))
    if not taken.any():
        return picture
    rgba = np.asarray(picture).astype(np.float64)
    rgba[..., :3] = np.clip(rgba[..., :3] - 255 * taken, 0, 255)
    return Image.fromarray(np.rint(rgba).astype(np.uint8))


def _light(rgba: Field) -> Field:
    """Return the brightness that highlights add [H,W,3]."""
    rgb, inside = clean_picture(rgba).astype(np.float32), rgba[..., 3] > 0.5
    disc = _disc(round(LARGEST * WORK))
    # A morphological opening removes bright spots that are smaller than the disc.
    dark = cv2.erode(np.where(inside[..., None], rgb, np.float32(1)), disc, borderValue=(1, 1, 1))
    under = np.asarray(cv2.dilate(dark, disc, borderValue=(0, 0, 0)), np.float32)
    shine = inside & _white(rgb, under)
    shine = cv2.morphologyEx(shine.astype(np.uint8), cv2.MORPH_OPEN, _disc(SMALLEST))
    shine = cv2.dilate(shine, _disc(RIM)) * inside
    filled = cv2.inpaint(np.rint(255 * rgb).astype(np.uint8), shine, 3, cv2.INPAINT_TELEA) / 255
    return np.where(shine[..., None] > 0, np.maximum(rgb - filled, 0.0), 0.0)


def _white(rgb: NDArray[np.float32], under: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return whether each colour [H,W,3] equals `under` [H,W,3] plus some white light."""
    added, full = rgb - under, rgb > FULL
    light = np.where(full, -np.inf, added).max(axis=2, keepdims=True)
    light = np.where(np.isfinite(light), light, added.max(axis=2, keepdims=True))
    # In a clipped channel, only a lower bound of the added light is known.
    apart = np.where(full, np.maximum(added - light, 0), np.abs(added - light)).max(axis=2)
    most = added.max(axis=2)
    coloured = np.ptp(under, axis=2) > COLOURED * np.maximum(under.max(axis=2), 1e-3)
    return (most > BRIGHT) & (apart < NEUTRAL * most) & coloured


def _disc(radius: int) -> NDArray[np.uint8]:
    side = 2 * radius + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side)), np.uint8)
