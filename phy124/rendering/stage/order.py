"""Which glass is before all Gaussians, among them, or behind them, as a camera sees it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array
from phy124.rendering.stage.frame import Box, Solid

BEFORE, AMONG, BEHIND = range(3)
THIN, GIVE = 0.2, 0.3
"""What is pressed against a plate, thinner than this part of its width, may be within it by so many
of its half thicknesses and still counts as beside it."""
TOGETHER = 64
"""Points whose extremes are found together, as rows of many columns are quicker."""


def bounds(points: Array) -> Box:
    """Lowest and highest corner of a box around points [N,3]; not finite if one is not."""
    if not len(points):
        return np.full(3, np.nan, np.float32), np.full(3, np.nan, np.float32)
    even = len(points) // TOGETHER * TOGETHER
    many, rest = points[:even].reshape(-1, TOGETHER * 3), points[even:]
    ends = []
    for least in (np.minimum, np.maximum):
        found = [least.reduce(rest)] if len(rest) else []
        if even:
            found.append(least.reduce(least.reduce(many).reshape(-1, 3)))
        ends.append(least.reduce(found))
    return ends[0], ends[1]


def ranks(solids: Sequence[Solid], eye: NDArray, box: Box) -> NDArray[np.int64]:
    """For each solid `BEFORE`, `AMONG` or `BEHIND`, for an eye that looks at things in a box [S].

    A plane through one of its faces may have the box on its other side. If the eye is there too,
    no ray to the box meets the solid; else every ray leaves the solid before it comes to the box.
    """
    if not solids or not np.isfinite(box).all():
        return np.full(len(solids), AMONG)
    low, high = box
    axes = np.array([solid.axes for solid in solids])
    sizes = np.array([solid.half + solid.radius for solid in solids])
    centres = np.array([solid.centre for solid in solids])
    thin = sizes < THIN * sizes.max(axis=1, keepdims=True)
    to_box, to_eye = (
        np.matmul(axes, (place - centres)[:, :, None])[:, :, 0] for place in ((low + high) / 2, eye)
    )
    away = np.abs(to_box) - np.abs(axes) @ ((high - low) / 2)
    beyond = away > np.where(thin, 1 - GIVE, 1.0) * sizes
    with_eye = np.sign(to_box) * to_eye > sizes
    found = np.where(beyond.any(axis=1), BEFORE, AMONG)
    return np.where((beyond & with_eye).any(axis=1), BEHIND, found)
