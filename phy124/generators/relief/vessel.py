"""Builds the shell of a vessel or a drum, with handles, that was photographed from above."""

import cv2
import numpy as np
from numpy.typing import NDArray

from phy124.generators.relief.colours import clean_picture
from phy124.generators.relief.elevation import Raised
from phy124.generators.relief.lathe import Lathe, cut_lathe, find_lathe
from phy124.generators.relief.parts import inflate_part, keep
from phy124.generators.relief.shell import DRAWN_IN, Shell, join
from phy124.generators.relief.surface import View
from phy124.generators.relief.upright import Profile, upright_body

Field = NDArray[np.float64]
JOINT = 4
"""Handles are extended by this length into the body [pixels]."""


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
    handles = object_mask & ~solid
    part = np.count_nonzero(handles) / np.count_nonzero(object_mask)
    shell = lathe.shell(round(count * (1 - part)), front, np.array([profile.axis, middle]), offset)
    if not handles.any():
        return shell
    return join(
        shell, _handles(rgba, handles, view, lathe, offset, front, round(count * part), rng)
    )


def _handles(
    rgba: Field,
    handles: NDArray[np.bool_],
    view: View,
    lathe: Lathe,
    offset: float,
    front: Field,
    count: int,
    rng: np.random.Generator,
) -> Shell:
    """Handles lie in the vertical plane through the vessel's axis."""
    near = cv2.dilate(handles.astype(np.uint8), np.ones((2 * JOINT + 1,) * 2)) > 0
    part, _ = inflate_part(np.where(near, rgba[..., 3], 0.0), front, view, count, rng)
    shell = lathe.camera.stand(part)
    x, y, z = shell.points.T
    radii = np.interp(-y, lathe.heights, lathe.radii - DRAWN_IN, left=0, right=0)
    return keep(shell, np.hypot(x - offset, z) > radii)
