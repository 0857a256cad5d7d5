"""A photograph, the place of its object, and what is to be seen there without it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError

LARGEST = 1024
"""Longest side of the pictures [pixels]."""
MARGIN = 0.015
"""Surroundings of the object that are filled in with it, in longest sides of the photograph."""
HOLE = 320
"""Longest side at which holes are filled in [pixels]: slower and no better if it is larger."""


@dataclass(frozen=True, eq=False)
class Photograph:
    """A photograph and where its object is."""

    rgb: NDArray[np.uint8]
    """[H,W,3]"""
    alpha: NDArray[np.float32]
    """Which part of each pixel is object [H,W], 0..1."""

    @classmethod
    def of(cls, picture: Image.Image, cutout: Image.Image) -> Photograph:
        """A picture, on white where it is transparent, and its cut-out, of any sizes.

        Raises:
            InputError: The cut-out is empty.
        """
        scale = min(1.0, LARGEST / max(picture.size))
        width, height = (max(16, round(side * scale)) for side in picture.size)
        on_white = Image.new("RGBA", picture.size, "white")
        on_white.alpha_composite(picture.convert("RGBA"))
        rgb = on_white.convert("RGB").resize((width, height), Image.Resampling.LANCZOS)
        alpha = cutout.convert("RGBA").getchannel("A").resize((width, height))
        opaque = np.asarray(alpha, np.float32) / np.float32(255)
        if not (opaque > 0.5).any():
            limit = "nothing in it is the object."
            raise InputError("compose", "the cut-out", limit, "Give another picture or mask.")
        return cls(np.asarray(rgb), opaque)

    def without(self) -> NDArray[np.uint8]:
        """The photograph without its object: the hole is filled in from around (Telea 2004)."""
        import cv2

        height, width = self.alpha.shape
        margin = max(2, round(MARGIN * max(height, width)))
        hole = cv2.dilate((self.alpha > 0.02).astype(np.uint8), np.ones((2 * margin + 1,) * 2))
        scale = min(1.0, HOLE / max(height, width))
        size = (max(8, round(width * scale)), max(8, round(height * scale)))
        small = cv2.resize(self.rgb, size, interpolation=cv2.INTER_AREA)
        inside = cv2.resize(hole, size, interpolation=cv2.INTER_NEAREST)
        if inside.all():
            return np.full_like(self.rgb, 255)
        filled = cv2.inpaint(small, inside, 3, cv2.INPAINT_TELEA)
        calm = cv2.GaussianBlur(filled, (0, 0), 0.02 * max(size))
        large = cv2.resize(calm, (width, height), interpolation=cv2.INTER_CUBIC).astype(float)
        soft = cv2.GaussianBlur(hole.astype(float), (0, 0), margin / 3)[..., None]
        mixed = np.where(hole[..., None] > 0, np.maximum(soft, 0.5), soft)
        return np.rint(mixed * large + (1 - mixed) * self.rgb).clip(0, 255).astype(np.uint8)
