"""Colours an object from the images and from a guessed back."""

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
"""Depth behind the rim in which the mirrored front's colours change to the back's colours, relative
to the image's size.
"""
STRETCH = 1.0
"""Blur of the image per unit of stretch by a steep surface [pixels]."""
BLURS = 0.0, 1.5, 3.0, 6.0
"""Levels of blur [pixels]."""
FRINGE = 2.0
"""Width of the strip along the silhouette's edge in which colours are ignored [pixels]."""


def clean_picture(rgba: Field) -> Field:
    """Return colours [H,W,3] without the background that is mixed into edge pixels.

    Edge pixels and pixels outside get the colour of the nearest opaque pixel inside the object.
    """
    solid = rgba[..., 3] > 0.5
    clean = nearest_of(rgba[..., 3] <= 0.95)[0] > FRINGE
    # Where the object is too thin to have clean pixels, use the pixels on its centre line.
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
    """Colour surface points [N,3] from the front image.

    Behind the rim, the colours change gradually from the mirrored image to the back, so that no
    seam is visible.

    Args:
        points: Points [N,3], pixels.
        normals: Unit normals of the surface at the points [N,3].
        surface: The surface on which the points lie.
        front: Colours of the front [H,W,3].
        unlit: Colours of the front without light [H,W,3].
        back: Colours of the back without light [H,W,3].
        light: Direction and strength of the light [3].
        reach: Depth behind the rim over which the colours change [pixels]. If 0, only the narrow
            sides of a card show the mirrored image.
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
    if reach == 0:
        return np.clip(-normals[:, 2], 0, 1) ** 2
    part = np.clip((surface.middle(points) - points[:, 2]) / reach, 0, 1)
    return part * part * (3 - 2 * part)


def _sample_blurred(picture: Field, place: Field, blur: Field) -> Field:
    """Return colours [3,N] with a blur for each position, as a standard deviation [pixels].

    On a steep surface, a pixel covers a long strip, which would look like a streak without blur.
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
    channels = [
        scipy.ndimage.map_coordinates(picture[..., c], place, order=1, mode="nearest")
        for c in range(3)
    ]
    return np.stack(channels)


FACING = 4.0
"""An image's weight contains this power of the cosine between the normal and the view direction."""
HIDDEN = 0.02
"""Factor of an image's weight for points that are hidden in the image."""
BEHIND = 8.0
"""Smallest distance of hidden points behind the visible surface [pixels]."""
CELL = 2.0
"""Size of the cells in which visibility is tested [pixels]."""


@dataclass(frozen=True, eq=False)
class Shown:
    """An image of the object from one side."""

    rgb: Field
    """Colours [H,W,3], also outside the silhouette."""
    middle: tuple[float, float]
    """Column and row of the object's centre."""
    towards: Field
    """Unit vector towards the camera [3]."""
    across: Field
    """Unit vector along the rows [3]."""
    weight: float = 1.0
    """Weight of the image's colours; the weight of a photograph is 1."""

    def colours(self, points: Field, distance: float) -> Field:
        """Return the colours [N,3] that a camera at `distance` sees at points [N,3]."""
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
        return self.weight * facing * np.where(self.sees(points, distance), 1.0, HIDDEN) + 1e-6

    def sees(self, points: Field, distance: float) -> NDArray[np.bool_]:
        """Return whether no other point hides a point [N,3] from a camera at `distance` [N]."""
        cells = np.floor(self._places(points, distance) / CELL).astype(int)
        cells -= cells.min(axis=1, keepdims=True)
        nearest = np.full(cells.max(axis=1) + 1, -np.inf)
        along = points @ self.towards
        np.maximum.at(nearest, tuple(cells), along)
        return along > nearest[tuple(cells)] - BEHIND

    def _places(self, points: Field, distance: float) -> Field:
        """Return columns and rows relative to the object's centre [2,N]."""
        near = 1 - points @ self.towards / distance
        return np.stack([points @ self.across, points[:, 1]]) / near


def blend_pictures(
    points: Field, normals: Field, pictures: Sequence[Shown], distance: float
) -> Field:
    """Blend the colours [N,3] of points from several images, weighted by visibility.

    Args:
        points: Points relative to the object's centre [N,3], pixels.
        normals: Unit normals of the surface [N,3].
        pictures: Images of the object.
        distance: Distance of the cameras from the centre [pixels].
    """
    weights = np.stack([picture.weights(points, normals, distance) for picture in pictures])
    weights /= weights.sum(axis=0)
    colours = np.stack([picture.colours(points, distance) for picture in pictures])
    return np.einsum("vn,vnc->nc", weights, colours)
