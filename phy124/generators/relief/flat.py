"""Flattens objects whose fronts show no shading, such as keys, leaves, coins and signs.

Light changes the brightness of a round surface. If a photograph shows no such change, the front is
assumed to be flat. Narrow objects, such as tools, are flatter than compact objects, such as cars
seen from their side. Discs are flatter still.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.generators.relief.back import body_without_handles
from phy124.generators.relief.ends import Continued
from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.light import Shading
from phy124.generators.relief.solids import is_turned
from phy124.generators.relief.surface import Surface

Field = NDArray[np.float64]
PLAIN = 0.004
"""Smallest standard deviation of the logarithm of the brightness in a photograph. Drawings in plain
colours have a smaller value, even if the object is round.
"""
SHADED = (0.015, 0.018)
"""A front is flat if the contrast of the shading is below the first value, and round if the
contrast is above the second value.
"""
RADII = (0.1, 0.15, 0.22, 0.3, 0.4, 0.45)
HALVES = (0.03, 0.04, 0.08, 0.24, 0.24, 0.08)
"""Half the thickness of a flat object, as a function of the radius of the largest disc inside its
outline. All values are relative to the object's size.
"""
DISC = 0.4
"""Radius of the largest inscribed disc, relative to the object's size, from which an outline counts
as a disc.
"""
GROUND = 0.1
"""Height of the lowest strip, in which feet are searched for, relative to the object's height."""
TOUCH = 0.03
"""Largest height of a foot above ground, relative to the object's height."""
FOOT = 0.35
"""Largest width of a foot, relative to the object's width."""
SHARPNESS = 4
"""Exponent of the smooth minimum."""


def flatten(
    half: Field,
    surface: Surface,
    picture: Continued,
    size: int,
    *,
    always: bool = False,
    most: float = 1.0,
) -> Field | None:
    """Limit squared half thicknesses [H,W] of an object without shading; return None for a round
    one.

    Args:
        half: Squared half thicknesses of a round object.
        surface: Surface of the round object.
        picture: Colours of the image, and mask of the object.
        size: Size of the object [pixels].
        always: Whether the object is flat even if the front shows shading.
        most: Largest half thickness of a flat object, relative to `size`.
    """
    shading = Shading.of(picture.rgba[..., :3], surface, picture.object_mask)
    radius = float(nearest_of(~picture.object_mask)[0].max()) / size
    if not always and (
        shading.total < PLAIN or shading.contrast >= SHADED[1] or _is_thick(picture, radius)
    ):
        return None
    deepest = float(np.sqrt(half.max()))
    flat = min(deepest, size * min(most, float(np.interp(radius, RADII, HALVES))))
    contrast = 0.0 if always else shading.contrast
    limit = float(np.interp(contrast, SHADED, (flat, deepest)))
    return limit_thickness(half, limit)


def limit_thickness(half: Field, limit: Field | float) -> Field:
    """Limit squared half thicknesses [H,W] smoothly; `limit` is a half thickness [pixels]."""
    ratio = half / limit**2
    return half / (1 + ratio**SHARPNESS) ** (1 / SHARPNESS)


def _is_thick(picture: Continued, radius: float) -> bool:
    if radius < DISC and is_turned(body_without_handles(picture.object_mask)):
        return True
    return picture.body is not None or stands_on_feet(picture.object_mask)


def stands_on_feet(object_mask: NDArray[np.bool_]) -> bool:
    """Whether a silhouette [H,W] ends in several feet or wheels at the same height."""
    rows = np.flatnonzero(object_mask.any(axis=1))
    width = np.ptp(np.flatnonzero(object_mask.any(axis=0))) + 1
    low = object_mask[rows[-1] + 1 - max(2, round(GROUND * len(rows))) : rows[-1] + 1]
    parts, _ = scipy.ndimage.label(low)  # pyright: ignore
    touch = max(1, round(TOUCH * len(rows)))
    feet = [
        columns.stop - columns.start
        for row, columns in scipy.ndimage.find_objects(parts)  # pyright: ignore
        if row.stop > len(low) - touch
    ]
    return len(feet) > 1 and max(feet) <= FOOT * width
