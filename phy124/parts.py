"""Parts: which material each particle is made of, where a scene names several.

A part is picked by a box in space, by a segmentation mask of the picture, by the Gaussians it
holds, or by several of these at once. Later parts win; what no part claims keeps the scene's
material.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from phy124.errors import InputError
from phy124.scene import Part

Crop = tuple[float, float, float, float]
WHOLE: Crop = (0.0, 0.0, 1.0, 1.0)
"""Left, top, right, bottom of the object in the picture, as shares of its width and height."""


def crop_of(cutout: Image.Image) -> Crop:
    """Where the object is in its picture, an RGBA cut-out."""
    opaque = np.asarray(cutout.getchannel("A")) > 127
    rows, columns = np.flatnonzero(opaque.any(axis=1)), np.flatnonzero(opaque.any(axis=0))
    if not len(rows):
        return WHOLE
    height, width = opaque.shape
    left, right = columns[0] / width, (columns[-1] + 1) / width
    return float(left), rows[0] / height, float(right), (rows[-1] + 1) / height


def assign(
    x: NDArray, gaussian: NDArray, parts: Sequence[Part], crop: Crop = WHOLE
) -> NDArray[np.int32]:
    """Number of the material of each particle [P]: 0 the scene's, i the i-th part's (from 1).

    Args:
        x: Positions at rest [P,3], m, the object upright and facing +x.
        gaussian: The Gaussian each particle is [P], or -1: it follows its nearest Gaussian.
        parts: The scene's parts.
        crop: Where the object is in the picture that masks were painted on.

    Raises:
        InputError: a mask cannot be read, or a part holds no particle.
    """
    chosen = np.zeros(len(x), np.int32)
    for number, part in enumerate(parts, 1):
        inside = np.ones(len(x), bool)
        if part.region is not None:
            inside &= part.region.contains(x)
        if part.gaussians is not None:
            inside &= _held(x, gaussian, part.gaussians)
        if part.mask is not None:
            inside &= _painted(x, part.mask, crop)
        if not inside.any():
            raise InputError(
                f"parts.{number - 1}", part.data(), "it holds no particle.",
                "Give it a larger region, another mask or other Gaussians.",
            )  # fmt: skip
        chosen[inside] = number
    return chosen


def _held(x: NDArray, gaussian: NDArray, span: tuple[int, int]) -> NDArray[np.bool_]:
    """Particles of the Gaussians first <= i < last, fillers by their nearest Gaussian particle."""
    owner = gaussian.copy()
    own, filler = gaussian >= 0, gaussian < 0
    if filler.any() and own.any():
        nearest = KDTree(x[own]).query(x[filler])[1]
        owner[filler] = gaussian[own][nearest]
    return (owner >= span[0]) & (owner < span[1])


def _painted(x: NDArray, path: str, crop: Crop) -> NDArray[np.bool_]:
    """Particles whose place in the picture is painted bright."""
    try:
        with Image.open(path) as opened:
            mask = np.asarray(opened.convert("L")) > 127
    except (OSError, ValueError) as error:
        raise InputError(
            "parts.mask", path, f"it cannot be read ({error}).", "Give a PNG, white on the part."
        ) from None
    low, high = x.min(axis=0), x.max(axis=0)
    across = (x[:, 1] - low[1]) / max(high[1] - low[1], 1e-12)
    down = (high[2] - x[:, 2]) / max(high[2] - low[2], 1e-12)
    left, top, right, bottom = crop
    column = (left + across * (right - left)) * mask.shape[1]
    row = (top + down * (bottom - top)) * mask.shape[0]
    i = np.clip(row.astype(int), 0, mask.shape[0] - 1)
    return mask[i, np.clip(column.astype(int), 0, mask.shape[1] - 1)]
