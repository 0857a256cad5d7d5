"""Colours of the inflated object: the picture in front, what its rim suggests on the back."""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.surface import Surface

Field = NDArray[np.float64]
INSET = 0.03
"""How far inside the rim its colour is read, in picture sizes."""
REACH = 0.2
"""How far round the rim the picture continues, in picture sizes."""
SHORTER = 6.0
"""How decidedly the back follows the shorter of row and column: a power of their ratio."""
FRINGE = 2.0
"""Width of the edge whose colours are not trusted, pixels."""


def clean_picture(rgba: Field) -> Field:
    """Colours [H,W,3] without the background that shines through half-transparent edge pixels.

    Those pixels, and everything outside, take the colour of the nearest opaque pixel.
    """
    solid = rgba[..., 3] > 0.5
    clean = nearest_of(rgba[..., 3] <= 0.95)[0] > FRINGE
    # Parts too thin to have clean pixels keep their middle.
    depth, _ = nearest_of(~solid)
    ridge = depth >= scipy.ndimage.maximum_filter(depth, size=3)
    lost = nearest_of(clean)[0] > 2 * FRINGE + 1 if clean.any() else solid
    trusted = clean | (solid & ridge & lost)
    return rgba[..., :3][nearest_of(trusted)[1]]


def back_picture(picture: Field, inside: NDArray[np.bool_], size: int) -> Field:
    """Colours of the back [H,W,3]: those just inside the rim at both ends of each row and column.

    So a stripe goes round, and nothing inside the silhouette (eyes, a beak) appears a second time.
    """
    depth, _ = nearest_of(~inside)
    ridge = scipy.ndimage.maximum_filter(depth, size=2 * int(INSET * size) + 1)
    inner = depth >= np.minimum(INSET * size, 0.6 * ridge)
    _, nearest = nearest_of(inner & inside)
    rim = scipy.ndimage.gaussian_filter(picture, (1.5, 1.5, 0))[nearest]
    thick = _thickness(depth)
    rows, wide = _between_ends(inside, rim, thick)
    columns, high = _between_ends(inside.T, rim.swapaxes(0, 1), thick.T)
    across = 1 / (1 + (wide / np.maximum(high.T, 1.0)) ** SHORTER)[..., None]
    mixed = across * rows + (1 - across) * columns.swapaxes(0, 1)
    return scipy.ndimage.gaussian_filter(np.where(inside[..., None], mixed, rim), (6, 6, 0))


def _thickness(depth: Field) -> Field:
    """Radius of the largest disc within the silhouette that covers each pixel [H,W], in steps."""
    thick = np.ones_like(depth)
    for radius in np.geomspace(1.5, max(2.0, float(depth.max())), 8)[:-1]:
        thick[nearest_of(depth >= radius)[0] <= radius] = radius
    return thick


def _between_ends(inside: NDArray[np.bool_], colours: Field, thick: Field) -> tuple[Field, Field]:
    """Colours [H,W,3] interpolated between both ends of each run of a row; its length [H,W].

    The colour of a thin part (a beak) reaches less far.
    """
    columns = np.arange(inside.shape[1])
    before = np.maximum.accumulate(np.where(inside, 0, columns), axis=1)
    after = np.minimum.accumulate(np.where(inside, len(columns) - 1, columns)[:, ::-1], axis=1)
    ends, total, weights = (before, after[:, ::-1]), np.zeros_like(colours), 0.0
    for end, step in zip(ends, (1, -1), strict=True):
        first = np.clip(end + step, 0, len(columns) - 1)
        far = np.maximum(np.abs(columns - end), 1) / np.take_along_axis(thick, first, axis=1)
        weight = (1 / far**2)[..., None]
        total += weight * np.take_along_axis(colours, first[..., None], axis=1)
        weights = weights + weight
    return total / weights, (ends[1] - before).astype(np.float64)


def colour(
    points: Field, surface: Surface, inside: NDArray[np.bool_], front: Field, back: Field, size: int
) -> Field:
    """Colours [N,3] of surface points: the picture where it shows them, going round its rim.

    Beyond the rim the picture is continued by its mirror image, at the distance along the surface,
    and fades into the back.

    Args:
        points: Positions [N,3], pixels.
        surface: What they lie on.
        inside: The silhouette [H,W].
        front: Colours of the front [H,W,3].
        back: Colours of the back [H,W,3].
        size: Of the object, pixels.
    """
    _, nearest = nearest_of(~inside)
    place = points[:, 1::-1].T
    at = np.clip(np.rint(place).astype(int), 0, np.array(inside.shape)[:, None] - 1)
    rim = np.stack([axis[tuple(at)] for axis in nearest]).astype(np.float64)
    inward = place - rim
    far = np.maximum(np.linalg.norm(inward, axis=0), 0.5)
    way = np.hypot(far, surface.middle(rim[::-1].T) - points[:, 2])
    hidden = points[:, 2] < surface.middle(points)
    around = _sampled(scipy.ndimage.gaussian_filter(front, (2, 2, 0)), rim + inward / far * way)
    shown = np.where(hidden, around, _sampled(front, place))
    fraction = np.where(hidden, np.clip(way / (REACH * size), 0, 1), 0.0)
    fraction = fraction * fraction * (3 - 2 * fraction)
    return (shown * (1 - fraction) + _sampled(back, place) * fraction).T


def _sampled(picture: Field, place: Field) -> Field:
    """Colours [3,N] at places (y, x)."""
    channels = [
        scipy.ndimage.map_coordinates(picture[..., c], place, order=1, mode="nearest")
        for c in range(3)
    ]
    return np.stack(channels)
