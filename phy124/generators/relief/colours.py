"""Colours of the inflated object: the picture in front, what its rim suggests on the back."""

from __future__ import annotations

import numpy as np
import scipy.ndimage as ndi
from numpy.typing import NDArray

from phy124.generators.relief.height import Silhouette, nearest_of

Field = NDArray[np.float64]
INSET = 0.03
"""How far inside the rim its colour is read, in picture sizes."""
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
    ridge = depth >= ndi.maximum_filter(depth, size=3)
    lost = nearest_of(clean)[0] > 2 * FRINGE + 1 if clean.any() else solid
    trusted = clean | (solid & ridge & lost)
    return rgba[..., :3][nearest_of(trusted)[1]]


def back_picture(picture: Field, silhouette: Silhouette, size: int) -> Field:
    """Colours of the back [H,W,3]: those just inside the rim, continued by Laplace's equation.

    So nothing inside the silhouette (eyes, a beak) appears a second time on the back, and small
    features of the rim fade within their own size.
    """
    depth, _ = nearest_of(~silhouette.inside)
    ridge = ndi.maximum_filter(depth, size=2 * int(INSET * size) + 1)
    inner = depth >= np.minimum(INSET * size, 0.6 * ridge)
    _, nearest = nearest_of(inner & silhouette.inside)
    rim = ndi.gaussian_filter(picture, (1.5, 1.5, 0))[nearest]
    return silhouette.harmonic(ndi.gaussian_filter(rim, (2, 2, 0)))


def colour(points: Field, normals: Field, front: Field, back: Field) -> Field:
    """Colours [N,3] of surface points: the front picture, fading into the back beyond the rim.

    Args:
        points: Positions [N,3], pixels.
        normals: Outward unit normals [N,3].
        front: Colours of the front [H,W,3].
        back: Colours of the back [H,W,3].
    """
    place = points[:, 1::-1].T
    pictures = [
        np.stack([ndi.map_coordinates(p[..., c], place, order=1, mode="nearest") for c in range(3)])
        for p in (front, back)
    ]
    fraction = np.clip((0.3 - normals[:, 2]) / 0.6, 0, 1)
    fraction = fraction * fraction * (3 - 2 * fraction)
    return (pictures[0] * (1 - fraction) + pictures[1] * fraction).T
