"""Computes TripoSR's density and colour at points in space from the network's triplane.

The three planes (xy, xz and yz) contain features on square grids, which are interpolated
bilinearly. A small network maps the features to density and colour.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RADIUS = 0.87
"""Half the side of the triplane's cube."""
AXES = ((0, 1), (0, 2), (1, 2))
"""The two axes that span each plane."""
CHUNK = 1 << 16
"""Number of points that are decoded at a time."""
Array = NDArray[np.float32]
Decode = Callable[[Array, Array], tuple[Array, Array]]
"""A decoder: `(points [N,3], features [N,C]) -> density [N,1], colour [N,3] in 0..1`.

Some decoders ignore the features, because they sample the triplane themselves.
"""


@dataclass(frozen=True)
class Field:
    """Density and colour in the cube of half side `RADIUS`."""

    triplane: Array
    """Features [3,C,S,S]: planes, channels, vertical and horizontal axis."""
    decode: Decode
    samples: bool = True
    """Whether `decode` uses the features."""

    def __call__(self, points: NDArray) -> tuple[Array, Array]:
        """Return density [N] and colour [N,3] at points [N,3]."""
        points = np.ascontiguousarray(points, np.float32)
        density, colour = np.empty(len(points), np.float32), np.empty((len(points), 3), np.float32)
        for start in range(0, len(points), CHUNK):
            part = points[start : start + CHUNK]
            features = sample_planes(self.triplane, part) if self.samples else part[:, :0]
            d, c = self.decode(part, features)
            density[start : start + CHUNK], colour[start : start + CHUNK] = d[:, 0], c
        return density, colour

    def on_grid(self, axis: Array) -> Callable[[NDArray[np.int64]], Array]:
        """Return a function that maps indices [N,3] of a cubic grid to densities [N]."""
        if not self.samples:
            return lambda places: self(axis[places])[0]
        first, second = (v.ravel() for v in np.meshgrid(axis, axis, indexing="ij"))
        planes = [sample_plane(plane, first, second) for plane in self.triplane]

        def decode(places: NDArray[np.int64]) -> Array:
            density = np.empty(len(places), np.float32)
            for start in range(0, len(places), CHUNK):
                part = places[start : start + CHUNK]
                lines = [part[:, a] * len(axis) + part[:, b] for a, b in AXES]
                features = [plane[line] for plane, line in zip(planes, lines, strict=True)]
                d, _ = self.decode(axis[part], np.concatenate(features, axis=1))
                density[start : start + CHUNK] = d[:, 0]
            return density

        return decode


def sample_planes(triplane: Array, points: Array) -> Array:
    """Interpolate features [3,C,S,S] at points [N,3]; return [N,3C]."""
    parts = [
        sample_plane(plane, points[:, horizontal], points[:, vertical])
        for plane, (horizontal, vertical) in zip(triplane, AXES, strict=True)
    ]
    return np.concatenate(parts, axis=1)


def sample_plane(plane: Array, horizontal: Array, vertical: Array) -> Array:
    """Interpolate features [C,S,S] at coordinates [N] along the two axes; return [N,C].

    The outermost pixel centres lie half a pixel inside the cube; farther out, features fade to
    zero.
    """
    size = plane.shape[-1]
    padded = np.pad(plane, ((0, 0), (1, 1), (1, 1))).reshape(len(plane), -1).T
    x, y = (
        np.clip((v / RADIUS + 1) * (size / 2) - 0.5, -1, size) + 1 for v in (horizontal, vertical)
    )
    column, row = (np.minimum(v.astype(np.int64), size) for v in (x, y))
    u, v = (x - column)[:, None], (y - row)[:, None]
    first = row * (size + 2) + column
    top = padded[first] * (1 - u) + padded[first + 1] * u
    below = padded[first + size + 2] * (1 - u) + padded[first + size + 3] * u
    return (top * (1 - v) + below * v).astype(np.float32)
