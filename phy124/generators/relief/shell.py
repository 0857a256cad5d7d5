"""Converts points on the object's surface to a closed shell of flat Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, quaternions
from phy124.generators.relief.picture import WORK
from phy124.particles.extent import limit_to_surface

Field = NDArray[np.float64]
TANGENT = 0.58
"""Standard deviation along the surface, relative to the points' spacing; neighbours overlap without
holes.
"""
BACK_REACH = 1.25
"""Factor on the standard deviation along the surface for Gaussians on the back."""
NORMAL = 0.12
"""Standard deviation across the surface, relative to the points' spacing. A small value makes the
outline sharp.
"""
OPACITY = 0.97
DRAWN_IN = 1.35
"""Depth of the centres below the surface [pixels]. Gaussians seen edge-on extend outwards by about
this distance.
"""


@dataclass(frozen=True)
class Shell:
    """Points of a surface relative to the object's centre: x right, y down, z to the camera."""

    points: Field
    """Centres of the Gaussians [N,3], pixels, at `DRAWN_IN` below the surface."""
    normals: Field
    """Outward unit normals [N,3]."""
    spacing: Field
    """Mean distance to the neighbours [N], pixels."""
    rgb: Field
    """Colours [N,3], 0..1."""

    def scale_depth(self, factor: float) -> Shell:
        """Multiply the depths of all points, relative to the object's centre, by a factor."""
        along = self.normals * [factor, factor, 1.0]
        stretch = np.linalg.norm(along, axis=1)
        return Shell(
            self.points * [1.0, 1.0, factor],
            along / stretch[:, None],
            self.spacing * np.maximum(stretch, 1.0),
            self.rgb,
        )

    def gaussians(self) -> Gaussians:
        """Return the Gaussians in metres, in the world's axes."""
        # In the world, x points towards the camera, y to the right, z up.
        means = self.points[:, [2, 0, 1]] * [1, 1, -1] / WORK
        normals = self.normals[:, [2, 0, 1]] * [1, 1, -1]
        # On the back, where colours are smooth, Gaussians are wider, so that the inside of the
        # front is not visible through gaps.
        reach = TANGENT * self.spacing * np.interp(-normals[:, 0], [0.0, 0.5], [1.0, BACK_REACH])
        scales = np.stack([reach, reach, NORMAL * self.spacing], axis=1) / WORK
        opacities = np.full(len(means), OPACITY)
        quats = quaternions(_frames(normals))
        made = Gaussians.from_rgb(
            *(v.astype(np.float32) for v in (means, quats, scales, opacities, self.rgb))
        )
        return limit_to_surface(made, DRAWN_IN / WORK)


def join(*shells: Shell) -> Shell:
    """Return one shell with the points of several shells."""
    parts = zip(*(vars(shell).values() for shell in shells), strict=True)
    return Shell(*(np.concatenate(part) for part in parts))


def _frames(normals: Field) -> Field:
    """Return rotation matrices [N,3,3] whose third columns are the normals."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = first, np.cross(normals, first), normals
    return np.stack(axes, axis=2).astype(np.float64)
