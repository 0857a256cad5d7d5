"""A chequered ball, for studies without a picture."""

from __future__ import annotations

import numpy as np

from phy124.gaussians import Gaussians, quaternions, spread_directions

FLATNESS = 0.15
"""Thickness of the discs on its surface, relative to their width."""


def ball(count: int = 6000, diameter: float = 1.0) -> Gaussians:
    """Return a closed shell of evenly spread, flat Gaussians (Fibonacci lattice), facing +x."""
    normals = spread_directions(count)
    helper = np.where(np.abs(normals[:, 2:]) < 0.7, [[0.0, 0, 1]], [[1.0, 0, 0]])
    along = np.cross(helper, normals)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    axes = np.stack([along, np.cross(normals, along), normals], axis=2)
    width = 0.7 * diameter / 2 * np.sqrt(4 * np.pi / count)
    longitude = np.arctan2(normals[:, 1], normals[:, 0])
    squares = np.floor(longitude * 4 / np.pi) + np.floor(4 * normals[:, 2])
    rgb = np.where((squares % 2 == 0)[:, None], [[0.85, 0.2, 0.15]], [[0.95, 0.9, 0.8]])
    return Gaussians.from_rgb(
        (normals * diameter / 2).astype(np.float32),
        quaternions(axes).astype(np.float32),
        np.tile(np.array([width, width, FLATNESS * width], np.float32), (count, 1)),
        np.full(count, 0.95, np.float32),
        rgb.astype(np.float32),
    )
