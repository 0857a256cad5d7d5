"""Builds the shell of an object from one image of the front and one image of a side."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.generators.relief.back import BackLook, smooth_back
from phy124.generators.relief.colours import Shown, blend_pictures, clean_picture
from phy124.generators.relief.ends import Continued, continue_silhouette
from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.hull import Hull, spread_over
from phy124.generators.relief.parallel import Profile, match_heights, straighten
from phy124.generators.relief.picture import PADDING, WORK, opaque_size, work_picture
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.sides import Box, check_side, overlap
from phy124.generators.relief.single import ACROSS, FRONT, show_back
from phy124.generators.relief.solids import flat_topped, half_thickness
from phy124.generators.relief.surface import VIEW_DISTANCE

Field = NDArray[np.float64]
Facing = Literal["left", "right"]
IMAGINED = 0.3
"""Weight of the image of a side whose colours are invented."""
BACK_PLACE = 1


def from_sides(
    picture: Image.Image,
    side: Image.Image,
    *,
    facing: Facing,
    back: Image.Image | None,
    look: BackLook,
    count: int,
    rng: np.random.Generator,
    step: Callable[[int], None],
) -> Shell:
    """Build the surface of two silhouettes, and colour the surface from all images.

    Args:
        picture: Image of the front.
        side: Image of the object from one side.
        facing: Direction of the object's front in `side`.
        back: Image of the object from behind.
        look: How the back looks if there is no image from behind.
        count: Approximate number of points.
        rng: Random number generator.
        step: Called with the number of finished steps.

    Raises:
        InputError: If the silhouettes contradict each other.
    """
    (width, height), (depth, other) = opaque_size(picture), opaque_size(side)
    tall = WORK / max(1.0, width / height, depth / other)
    front = continue_silhouette(work_picture(picture, tall / height), PADDING)
    turned = work_picture(side, tall / other)
    side_picture = continue_silhouette(turned[:, ::-1] if facing == "left" else turned, PADDING)
    check_side(front.object_mask, side_picture.object_mask)
    distance = VIEW_DISTANCE * WORK
    ahead, across = _profile(front), _profile(side_picture)
    y, rows, side_rows = match_heights(ahead, across, distance)
    flat = ahead.ends[0] or across.ends[0], ahead.ends[1] or across.ends[1]
    hull = Hull.of(straighten(ahead, y, rows), straighten(across, y, side_rows), y, flat)
    step(1)
    points, normals, spacing = spread_over(hull, count, rng, lambda: step(1))
    step(2)
    points = points - hull.inset(points, DRAWN_IN) * normals
    shrunk = _shrinking(points, Box.of(front.object_mask), distance)
    points, spacing = shrunk * points, shrunk * spacing
    shown = _show_sides(front, side_picture, look)
    if back is not None:
        shown[BACK_PLACE] = show_back(back, tall / opaque_size(back)[1], front.object_mask)
    rgb = blend_pictures(points, normals, shown, distance)
    step(3)
    return Shell(points, normals, spacing, rgb)


def _show_sides(front: Continued, side_picture: Continued, look: BackLook) -> list[Shown]:
    """Return the images of the front, the back and both sides.

    The object is assumed to be symmetric about a vertical plane. The image with the more symmetric
    outline shows this plane edge-on; the other image is mirrored for the opposite side. A side that
    no image shows gets invented colours.
    """
    pictures = []
    for picture, towards, across in ((front, FRONT, ACROSS), (side_picture, ACROSS, FRONT)):
        rgb, middle = clean_picture(picture.rgba), Box.of(picture.object_mask).middle
        plain = smooth_back(rgb, picture.object_mask, WORK)
        mirrored = Shown(rgb, middle, -towards, across)
        imagined = Shown(plain, middle, -towards, across, IMAGINED)
        pictures.append((Shown(rgb, middle, towards, across), mirrored, imagined))
    facing_us = _symmetry(front.object_mask) >= _symmetry(side_picture.object_mask)
    (ahead, behind, plain_behind), (near, far, plain_far) = pictures
    plain = facing_us if look == "auto" else look == "plain"
    return [ahead, plain_behind if plain else behind, near, far if facing_us else plain_far]


def _symmetry(object_mask: NDArray[np.bool_]) -> float:
    return overlap(object_mask, object_mask[:, ::-1])


def _profile(picture: Continued) -> Profile:
    silhouette, box = Silhouette.of(picture.alpha), Box.of(picture.object_mask)
    half = half_thickness(silhouette, picture, WORK)
    w = flat_topped(silhouette.inside) if half is None else silhouette.extend(half)
    signs = {end.sign for end in picture.ends}
    return Profile(w, box.middle, box.size[1] / 2, (-1 in signs, 1 in signs))


def _shrinking(points: Field, box: Box, distance: float) -> float:
    axis = int(np.argmax(box.size))
    factor = 1.0
    for _ in range(4):
        seen = factor * points[:, axis] / (1 - factor * points[:, 2] / distance)
        factor *= box.size[axis] / (float(np.ptp(seen)) + 2 * DRAWN_IN)
    return factor
