"""The front's shape from a depth map."""

from __future__ import annotations

import numpy as np
import scipy.ndimage as ndi
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.surface import Surface

Field = NDArray[np.float64]
RIM = 8.0
"""Width along the rim where depth maps mix object and background, pixels."""
THINNEST = 2.0
"""Least half thickness behind the rim, pixels."""


def refuse_reversed(depth: NDArray, alpha: NDArray) -> None:
    """Check that the object [H,W] is nearer than what surrounds it.

    Raises:
        InputError: If the depth map has it the other way round.
    """
    inside, outside = alpha > 127, alpha == 0
    if outside.any() and float(depth[inside].mean()) < float(depth[outside].mean()):
        limit = "In it the object is farther away than what surrounds it."
        remedy = "If black is near in it, add --near black; if white is, leave that out."
        raise InputError("depth", "map", limit, remedy)


def with_front(surface: Surface, depth: Field, own: NDArray[np.bool_]) -> Surface:
    """The surface with a front as in the depth map [H,W], whose large values are near.

    Its scale and zero are unknown: both are set so that mean and spread are those of the inflated
    front. The back stays.

    Raises:
        InputError: If it is constant.
    """
    far, _ = nearest_of(~own)
    known = far > min(RIM / 2, 0.5 * float(far.max()))
    half = np.sqrt(np.maximum(surface.w, 0.0))
    front, back = surface.m + half, surface.m - half
    spread = float(depth[known].std())
    if spread <= 1e-6 * max(1.0, float(np.abs(depth[known]).max())):
        limit = "It has one and the same value all over the object."
        raise InputError("depth", "map", limit, "Give the network's output before any rounding.")
    scale = float(front[known].std()) / spread
    shaped = (depth - depth[known].mean()) * scale + front[known].mean()
    part = np.clip((far - 1) / RIM, 0, 1)
    part = part * part * (3 - 2 * part)
    shaped = ndi.gaussian_filter((1 - part) * front + part * shaped, 1.0)
    thickness = np.maximum((shaped - back) / 2, np.minimum(half, THINNEST))
    inside = surface.w > 0
    w = np.where(inside & own, thickness**2, surface.w)
    return Surface.of(w, np.where(inside & own, back + np.sqrt(np.maximum(w, 0)), surface.m))
