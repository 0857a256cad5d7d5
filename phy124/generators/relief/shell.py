"""Turns points on the object's surface into a shell of flat Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, quaternions
from phy124.generators.relief.picture import WORK

Field = NDArray[np.float64]
TANGENT = 0.58
"""Standard deviation along the surface, relative to the points' spacing; it makes neighbours
overlap, without holes."""
BACK_REACH = 1.25
"""On the back, the standard deviation along the surface is multiplied by this factor."""
NORMAL = 0.12
"""Standard deviation across the surface, relative to the points' spacing: small, to keep the
outline crisp."""
OPACITY = 0.97
DRAWN_IN = 1.35
"""Depth of the centres below the surface [pixels]; Gaussians seen edge-on extend outwards by about
this distance."""


@dataclass(frozen=True)
class Shell:
    """Points of a surface relative to the object's centre: x right, y down, z to the camera."""

    points: Field
    """Centres [N,3], pixels, `DRAWN_IN` below the surface."""
    normals: Field
    """Outward unit normals [N,3]."""
    spacing: Field
    """Mean distance to the neighbours [N], pixels."""
    rgb: Field
    """Colours [N,3], 0..1."""

    def gaussians(self) -> Gaussians:
        """Return the Gaussians in metres, in the axes of the world."""
        # In the world, x points towards the camera, y to the right, z up.
        means = self.points[:, [2, 0, 1]] * [1, 1, -1] / WORK
        normals = self.normals[:, [2, 0, 1]] * [1, 1, -1]
        # Wider on the back, whose colours are smooth: no gap must show the inside of the front.
        reach = TANGENT * self.spacing * np.interp(-normals[:, 0], [0.0, 0.5], [1.0, BACK_REACH])
        scales = np.stack([reach, reach, NORMAL * self.spacing], axis=1) / WORK
        opacities = np.full(len(means), OPACITY)
        quats = quaternions(_frames(normals))
        return Gaussians.from_rgb(
            *(v.astype(np.float32) for v in (means, quats, scales, opacities, self.rgb))
        )


def _frames(normals: Field) -> Field:
    """Return rotations [N,3,3] whose third column is the normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = first, np.cross(normals, first), normals
    return np.stack(axes, axis=2).astype(np.float64)
