"""The front's shape from a depth map."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.surface import Surface

Field = NDArray[np.float64]
RIM = 8.0
"""Width along the rim where depth maps mix object and background, pixels."""
PLANE = 0.01
"""Spread over the object, as a fraction of the whole map's range, below which it is plane."""
THINNEST = 2.0
"""Least half thickness behind the rim, pixels."""


def normalised(depth: NDArray, alpha: NDArray) -> NDArray[np.float32]:
    """A depth map in 0..1, checked against the object's alpha [H,W].

    Raises:
        InputError: If it is constant, or has the object behind what surrounds it.
    """
    low, high = float(depth.min()), float(depth.max())
    if high - low <= 1e-6 * max(abs(low), abs(high), 1e-30):
        limit = "It has one and the same value everywhere."
        raise InputError("depth", "map", limit, "Give the network's output before any rounding.")
    inside, outside = alpha > 127, alpha == 0
    if outside.any() and float(depth[inside].mean()) < float(depth[outside].mean()):
        limit = "In it the object is farther away than what surrounds it."
        remedy = "If black is near in it, add --near black; if white is, leave that out."
        raise InputError("depth", "map", limit, remedy)
    return ((depth - low) / (high - low)).astype(np.float32)


def with_front(surface: Surface, depth: Field, own: NDArray[np.bool_]) -> Surface:
    """The surface with a front as in the depth map [H,W] in 0..1, near is 1.

    Its scale and zero are unknown: both are set so that mean and spread are those of the inflated
    front, unless it is plane. The back stays.
    """
    far, _ = nearest_of(~own)
    known = far > min(RIM / 2, 0.5 * float(far.max()))
    half = np.sqrt(np.maximum(surface.w, 0.0))
    front, back = surface.m + half, surface.m - half
    spread = float(depth[known].std())
    scale = float(front[known].std()) / spread if spread > PLANE else 0.0
    shaped = (depth - depth[known].mean()) * scale + front[known].mean()
    part = np.clip((far - 1) / RIM, 0, 1)
    part = part * part * (3 - 2 * part)
    shaped = scipy.ndimage.gaussian_filter((1 - part) * front + part * shaped, 1.0)
    thickness = np.maximum((shaped - back) / 2, np.minimum(half, THINNEST))
    inside = surface.w > 0
    w = np.where(inside & own, thickness**2, surface.w)
    return Surface.of(w, np.where(inside & own, back + np.sqrt(np.maximum(w, 0)), surface.m))
