"""Builds the shell of a vessel or a drum, with handles, that was photographed from above."""

import warnings

import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.colours import clean_picture
from phy124.generators.relief.elevation import Raised
from phy124.generators.relief.handles import Handle, find_handles, handle_shell
from phy124.generators.relief.height import nearest_of
from phy124.generators.relief.lathe import cut_lathe, find_lathe
from phy124.generators.relief.shell import Shell, join
from phy124.generators.relief.surface import View
from phy124.generators.relief.upright import Profile, upright_body

Field = NDArray[np.float64]
Mask = NDArray[np.bool_]
WIDER, ELLIPSE = (1.2, 4.0), 0.97
"""An outline may be that of a disc seen from above if its ratio of width to height is in this range
and its IoU with an ellipse is larger than `ELLIPSE`.
"""
EDGE = 0.035
"""Visible height of a disc's edge, relative to its width."""
DISC = (
    "shape = auto: the outline is an ellipse, and the object is assumed to be as deep as high, like"
    " an egg. If it is a disc seen from above, such as a plate or a pizza, set shape = upright and"
    " photo_elevation = {}."
)
MARGIN = 3
"""Width of the strip around a handle in which colours are ignored [pixels]."""


def vessel_shell(
    rgba: Field,
    view: View,
    count: int,
    rng: np.random.Generator,
    elevation: float | None,
    *,
    always: bool,
) -> Shell | None:
    """Return the shell of a vessel or a drum; None if the image shows neither of them from above.

    Args:
        rgba: The image [H,W,4].
        view: The camera in front of the object.
        count: Approximate number of points.
        rng: Random number generator.
        elevation: Angle above the horizontal from which the picture was taken [degrees]; None:
            estimated from the outline.
        always: Whether the object is known to be a solid of revolution, whatever its outline is. If
            no elevation is found, such an object is assumed to be seen from the front.
    """
    object_mask = rgba[..., 3] > 0.5
    body = upright_body(object_mask)
    if body is None and not always:
        if elevation is None and (angle := _disc_elevation(object_mask)):
            warnings.warn(DISC.format(round(angle)), stacklevel=4)
        return None
    solid = object_mask if body is None else body
    profile, middle = Profile.of(solid), float(view.middle[1])
    lathe = None
    if elevation is None:
        lathe = find_lathe(profile, middle, view.distance)
    if lathe is None and (elevation or always):
        lathe = cut_lathe(profile, middle, Raised(np.radians(elevation or 0.0), view.distance))
    if lathe is None:
        return None
    front, offset = clean_picture(rgba), profile.axis - float(view.middle[0])
    centre = np.array([profile.axis, middle])
    handles = find_handles(object_mask & ~solid, solid, view, lathe, offset)
    if not handles:
        return lathe.shell(count, front, centre, offset)
    share = np.count_nonzero(object_mask & ~solid) / np.count_nonzero(object_mask)
    wall = _without(rgba, handles)
    return join(
        lathe.shell(round(count * (1 - share)), wall, centre, offset),
        handle_shell(handles, rgba, front, view, lathe, offset, round(count * share), rng),
    )


def _disc_elevation(solid: Mask) -> float | None:
    """Return the elevation [degrees] from which a disc has the outline [H,W]; None if none has."""
    rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
    height, width = len(rows), len(columns)
    if not WIDER[0] * height < width < WIDER[1] * height:
        return None
    y, x = np.ogrid[: solid.shape[0], : solid.shape[1]]
    down, right = (y - rows.mean()) / height, (x - columns.mean()) / width
    ellipse = np.hypot(down, right) < 0.5
    overlap = np.count_nonzero(ellipse & solid) / np.count_nonzero(ellipse | solid)
    return float(np.degrees(np.arcsin(height / width - EDGE))) if overlap > ELLIPSE else None


def _without(rgba: Field, handles: list[Handle]) -> Field:
    """Return the colours of an image [H,W,4] without handles, which would be painted on the wall.

    The near side of a handle hides a strip of the wall next to the roots.
    """
    bare = rgba.copy()
    for handle in handles:
        half = nearest_of(~handle.mask)[0].max()
        bare[nearest_of(handle.mask)[0] <= MARGIN + half, 3] = 0
    return clean_picture(bare)
