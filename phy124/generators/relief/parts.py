"""Inflates a part of an object separately, such as a handle or a leg.

The part is as deep as it is wide, and shows the image on both sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.picture import PADDING, WORK
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.solids import round_thickness
from phy124.generators.relief.surface import Surface, View, spread

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]


def inflate_part(
    alpha: Field, front: Field, view: View, count: int, rng: np.random.Generator
) -> tuple[Shell, float]:
    """Return a part's shell in the vertical plane, and the part's half thickness [pixels].

    Args:
        alpha: Silhouette of the part [H,W].
        front: Colours of the image [H,W,3].
        view: The front camera.
        count: Approximate number of points.
        rng: Random number generator.
    """
    first, last = _bounds(alpha > 0)
    corner = first - PADDING
    box = np.s_[first[0] : last[0], first[1] : last[1]]
    silhouette = Silhouette.of(np.pad(alpha[box], PADDING))
    half = silhouette.extend(round_thickness(silhouette, WORK))
    surface = Surface.seen(half, view.middle - [*corner[::-1], 0.0], view.distance)
    points, normals, spacing, _ = spread(surface, (), count, rng)
    column, row = np.rint(points[:, :2] + corner[::-1]).astype(int).T
    rgb = front[row.clip(0, len(front) - 1), column.clip(0, front.shape[1] - 1)]
    inner = points - surface.inset(points, DRAWN_IN) * normals + [*corner[::-1], 0.0]
    drawn, turned = view.project_points(inner, normals)
    return Shell(drawn, turned, spacing, rgb), float(np.sqrt(half.max()))


def keep(shell: Shell, kept: Mask) -> Shell:
    """Return the points of a shell in a mask [N]."""
    return replace(shell, **{name: values[kept] for name, values in vars(shell).items()})


def _bounds(inside: Mask) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    places = np.argwhere(inside)
    return places.min(axis=0), places.max(axis=0) + 1
