"""Colours an object from its images and from a guess of its back."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.surface import Surface
from phy124.runtime.cores import cores

Field = NDArray[np.float64]
REACH = 0.2
"""Depth behind the rim over which the mirrored image fades into the back, in image sizes."""
STRETCH, BLURS = 1.0, (0.0, 1.5, 3.0, 6.0)
"""Blur of the image per unit by which a steep surface stretches the image, and levels of blur
[pixels]."""
FRINGE = 2.0
"""Width of the edge whose colours are ignored [pixels]."""


def clean_picture(rgba: Field) -> Field:
    """Return colours [H,W,3] without the background that is mixed into the edge pixels.

    Edge pixels, and all pixels outside, get the colour of the nearest reliable opaque pixel.
    """
    solid = rgba[..., 3] > 0.5
    clean = nearest_of(rgba[..., 3] <= 0.95)[0] > FRINGE
    # Where the object is too thin to have clean pixels, trust the pixels on its centre line.
    depth, _ = nearest_of(~solid)
    ridge = depth >= scipy.ndimage.maximum_filter(depth, size=3)
    lost = nearest_of(clean)[0] > 2 * FRINGE + 1 if clean.any() else solid
    trusted = clean | (solid & ridge & lost)
    return rgba[..., :3][nearest_of(trusted)[1]]


def colour_points(
    points: Field,
    normals: Field,
    surface: Surface,
    front: Field,
    unlit: Field,
    back: Field,
    light: Field,
    reach: float,
) -> Field:
    """Colour surface points [N,3] from the front image, and extend its colours around the rim.

    Behind the rim, the mirrored image fades into the back, so that there is no seam at the rim.
    Colours behind the rim are lit as the normals require.

    Args:
        points: Positions [N,3], pixels.
        normals: Unit normals [N,3].
        surface: The surface.
        front: Colours of the front [H,W,3].
        unlit: Colours of the front without light (`light.unlight`) [H,W,3].
        back: Colours of the back without light [H,W,3].
        light: Direction and strength of the light (`light.fit_light`) [3].
        reach: Depth behind the rim over which the mirrored image fades into the back, pixels; 0:
            only the narrow sides of a card show the mirrored image.
    """
    place = points[:, 1::-1].T
    blur = STRETCH * (1 / np.maximum(np.abs(normals[:, 2]), 1e-3) - 1)
    shown = _sample_blurred(front, place, blur)
    hidden = surface.middle(points) > points[:, 2]
    place, blur = place[:, hidden], blur[hidden]
    behind = _sample_blurred(back, place, blur)
    if back is not unlit:
        part = _fade(points[hidden], normals[hidden], surface, reach)
        behind = _sample_blurred(unlit, place, blur) * (1 - part) + behind * part
    shown[:, hidden] = behind * np.exp(normals[hidden] @ light)
    return np.clip(shown, 0, 1).T


def _fade(points: Field, normals: Field, surface: Surface, reach: float) -> Field:
    """Return the weight of the back's colours at surface points behind the rim [N]."""
    if reach == 0:
        return np.clip(-normals[:, 2], 0, 1) ** 2
    part = np.clip((surface.middle(points) - points[:, 2]) / reach, 0, 1)
    return part * part * (3 - 2 * part)


def _sample_blurred(picture: Field, place: Field, blur: Field) -> Field:
    """Return colours [3,N] at image positions; each position has a blur, stated as a standard
    deviation [pixels].

    On a steep surface, a pixel covers a long strip; without the blur, strips show as streaks.
    """

    def sample_level(width: float) -> Field:
        return _sample(scipy.ndimage.gaussian_filter(picture, (width, width, 0)), place)

    with ThreadPoolExecutor(cores()) as pool:
        levels = np.stack(list(pool.map(sample_level, BLURS)))
    level = np.interp(blur, BLURS, np.arange(len(BLURS)))
    below = np.minimum(level.astype(int), len(BLURS) - 2)
    number = np.arange(len(blur))
    part = level - below
    return (1 - part) * levels[below, :, number].T + part * levels[below + 1, :, number].T


def _sample(picture: Field, place: Field) -> Field:
    """Return colours [3,N] at image positions (y, x)."""
    channels = [
        scipy.ndimage.map_coordinates(picture[..., c], place, order=1, mode="nearest")
        for c in range(3)
    ]
    return np.stack(channels)


FACING = 4.0
"""Exponent of the cosine between normal and view direction in the weight of an image."""
HIDDEN = 0.02
"""Factor on the weight of an image in which the point is hidden."""
BEHIND = 8.0
"""A point is hidden if it is farther than this behind the visible surface [pixels]."""
CELL = 2.0
"""Size of the cells of the visibility test [pixels]."""


@dataclass(frozen=True, eq=False)
class Shown:
    """An image of the object from one side, with its camera."""

    rgb: Field
    """Colours [H,W,3], continued beyond the silhouette."""
    middle: tuple[float, float]
    """Column and row of the object's centre."""
    towards: Field
    """Unit vector from the object to the camera [3]."""
    across: Field
    """Unit vector along the rows of the image [3]."""
    weight: float = 1.0
    """Weight of the image relative to a photograph."""

    def colours(self, points: Field, distance: float) -> Field:
        """Return the colours [N,3] of points [N,3] as seen by the camera at `distance`."""
        column, row = self._places(points, distance)
        place = np.stack([row + self.middle[1], column + self.middle[0]])
        channels = [
            scipy.ndimage.map_coordinates(self.rgb[..., c], place, order=1, mode="nearest")
            for c in range(3)
        ]
        return np.stack(channels, axis=1)

    def weights(self, points: Field, normals: Field, distance: float) -> Field:
        """Return the weight of the image for each point [N]."""
        facing = np.maximum(normals @ self.towards, 0.0) ** FACING
        return self.weight * facing * np.where(self._seen(points, distance), 1.0, HIDDEN) + 1e-6

    def _seen(self, points: Field, distance: float) -> NDArray[np.bool_]:
        cells = np.floor(self._places(points, distance) / CELL).astype(int)
        cells -= cells.min(axis=1, keepdims=True)
        nearest = np.full(cells.max(axis=1) + 1, -np.inf)
        along = points @ self.towards
        np.maximum.at(nearest, tuple(cells), along)
        return along > nearest[tuple(cells)] - BEHIND

    def _places(self, points: Field, distance: float) -> Field:
        """Return the column and row of points relative to the object's centre [2,N]."""
        near = 1 - points @ self.towards / distance
        return np.stack([points @ self.across, points[:, 1]]) / near


def blend_pictures(
    points: Field, normals: Field, pictures: Sequence[Shown], distance: float
) -> Field:
    """Blend the colours [N,3] of points from several images, with weights by visibility.

    Args:
        points: Points relative to the object's centre [N,3], pixels.
        normals: Unit normals of the surface [N,3].
        pictures: Images of the object.
        distance: Distance of every camera from the centre, pixels.
    """
    weights = np.stack([picture.weights(points, normals, distance) for picture in pictures])
    weights /= weights.sum(axis=0)
    colours = np.stack([picture.colours(points, distance) for picture in pictures])
    return np.einsum("vn,vnc->nc", weights, colours)
