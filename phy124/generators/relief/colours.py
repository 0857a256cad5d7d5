"""Colours of the inflated object: the picture in front, what its rim suggests behind."""

from __future__ import annotations

import numpy as np
import scipy.ndimage as ndi
from numpy.typing import NDArray

from phy124.generators.relief.height import Silhouette

Field = NDArray[np.float64]
INSET = 0.03
"""How far inside the rim its colour is read, in picture sizes."""
FRINGE = 2
"""Width of the edge whose colours are not trusted, pixels."""


def clean_picture(rgba: Field) -> Field:
    """Colours [H,W,3] without what shone through half transparent edge pixels.

    Those and everything outside take the colour of the nearest opaque pixel.
    """
    solid = rgba[..., 3] > 0.5
    clean = ndi.binary_erosion(rgba[..., 3] > 0.95, iterations=FRINGE)
    # Parts too thin to have clean pixels keep their middle.
    depth = ndi.distance_transform_edt(solid)
    ridge = depth >= ndi.maximum_filter(depth, size=3)
    reached = ndi.binary_dilation(clean, iterations=2 * FRINGE + 1)
    return _nearest(rgba[..., :3], clean | (solid & ridge & ~reached))


def back_picture(picture: Field, silhouette: Silhouette) -> Field:
    """Colours of the back [H,W,3]: those just inside the rim, continued by Laplace's equation.

    So nothing that lies within the silhouette (eyes, a beak) shows on the back a second time, and
    small features of the rim fade within their own size.
    """
    depth = ndi.distance_transform_edt(silhouette.inside)
    size = max(silhouette.inside.shape)
    ridge = ndi.maximum_filter(depth, size=2 * int(INSET * size) + 1)
    inner = depth >= np.minimum(INSET * size, 0.6 * ridge)
    rim = _nearest(ndi.gaussian_filter(picture, (1.5, 1.5, 0)), inner & silhouette.inside)
    return silhouette.harmonic(ndi.gaussian_filter(rim, (2, 2, 0)))


def colour(points: Field, normals: Field, front: Field, back: Field) -> Field:
    """Colours [N,3] of surface points: the front picture fading into the back past the rim."""
    place = points[:, 1::-1].T
    pictures = [
        np.stack([ndi.map_coordinates(p[..., c], place, order=1, mode="nearest") for c in range(3)])
        for p in (front, back)
    ]
    share = np.clip((0.3 - normals[:, 2]) / 0.6, 0, 1)
    share = share * share * (3 - 2 * share)
    return (pictures[0] * (1 - share) + pictures[1] * share).T


def _nearest(values: Field, known: NDArray[np.bool_]) -> Field:
    iy, ix = ndi.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return values[iy, ix]
