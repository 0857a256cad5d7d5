"""The shell of an object that is known from the front and from the side."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.generators.relief.colours import back_picture, clean_picture
from phy124.generators.relief.ends import Continued, continued
from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.hull import Hull, spread_over
from phy124.generators.relief.parallel import Profile, matched, straightened
from phy124.generators.relief.picture import PADDING, WORK, opaque_size, work_picture
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.sides import Box, check_side, overlap
from phy124.generators.relief.single import ACROSS, FRONT, back_shown
from phy124.generators.relief.solids import flat_topped, half_thickness
from phy124.generators.relief.textures import Shown, blended
from phy124.generators.relief.view import VIEW_DISTANCE

Field = NDArray[np.float64]
Facing = Literal["left", "right"]
IMAGINED = 0.3
"""Weight of a side that no picture shows."""
BACK_PLACE = 1
"""Which of the four sides is the back."""


def from_sides(
    picture: Image.Image,
    side: Image.Image,
    *,
    facing: Facing,
    back: Image.Image | None,
    count: int,
    rng: np.random.Generator,
    step: Callable[[int], None],
) -> Shell:
    """What both silhouettes leave, with the colours of every picture where it shows them.

    Args:
        picture: The front.
        side: The object from one side.
        facing: Which way the object looks there.
        back: The object from behind.
        count: Approximate number of points.
        rng: Random numbers.
        step: Called with the number of steps done, also between them.

    Raises:
        InputError: If the silhouettes contradict each other.
    """
    (width, height), (depth, other) = opaque_size(picture), opaque_size(side)
    tall = WORK / max(1.0, width / height, depth / other)
    front = continued(work_picture(picture, tall / height), PADDING)
    turned = work_picture(side, tall / other)
    beside = continued(turned[:, ::-1] if facing == "left" else turned, PADDING)
    check_side(front.own, beside.own)
    distance = VIEW_DISTANCE * WORK
    one, two = _profile(front), _profile(beside)
    y, rows, side_rows = matched(one, two, distance)
    flat = one.ends[0] or two.ends[0], one.ends[1] or two.ends[1]
    hull = Hull.of(straightened(one, y, rows), straightened(two, y, side_rows), y, flat)
    step(1)
    points, normals, spacing = spread_over(hull, count, rng, lambda: step(1))
    step(2)
    points = points - hull.inset(points, DRAWN_IN) * normals
    shrunk = _shrinking(points, Box.of(front.own), distance)
    points, spacing = shrunk * points, shrunk * spacing
    shown = _shown(front, beside)
    if back is not None:
        shown[BACK_PLACE] = back_shown(back, tall / opaque_size(back)[1], front.own)
    rgb = blended(points, normals, shown, distance)
    step(3)
    return Shell(points, normals, spacing, rgb)


def _shown(front: Continued, beside: Continued) -> list[Shown]:
    """What front, back, one side and the other look like.

    The more symmetric of both pictures tells the plane of symmetry: the other one, mirrored, shows
    what is opposite to it. What is opposite to the symmetric one is imagined.
    """
    pictures = []
    for picture, towards, across in ((front, FRONT, ACROSS), (beside, ACROSS, FRONT)):
        rgb, middle = clean_picture(picture.rgba), Box.of(picture.own).middle
        plain = back_picture(rgb, picture.own, WORK)
        mirrored = Shown(rgb, middle, -towards, across)
        imagined = Shown(plain, middle, -towards, across, IMAGINED)
        pictures.append((Shown(rgb, middle, towards, across), mirrored, imagined))
    facing_us = _symmetry(front.own) >= _symmetry(beside.own)
    (ahead, behind, plain_behind), (near, far, plain_far) = pictures
    return [ahead, plain_behind if facing_us else behind, near, far if facing_us else plain_far]


def _symmetry(own: NDArray[np.bool_]) -> float:
    """Overlap of a silhouette [H,W] with its mirror image."""
    return overlap(own, own[:, ::-1])


def _profile(picture: Continued) -> Profile:
    silhouette, box = Silhouette.of(picture.alpha), Box.of(picture.own)
    half = half_thickness(silhouette, picture, WORK)
    w = flat_topped(silhouette.inside) if half is None else silhouette.extended(half)
    signs = {end.sign for end in picture.ends}
    return Profile(w, box.middle, box.size[1] / 2, (-1 in signs, 1 in signs))


def _shrinking(points: Field, box: Box, distance: float) -> float:
    """Factor that makes the front camera see points [N,3] as large as they are pictured."""
    axis = int(np.argmax(box.size))
    factor = 1.0
    for _ in range(4):
        seen = factor * points[:, axis] / (1 - factor * points[:, 2] / distance)
        factor *= box.size[axis] / (float(np.ptp(seen)) + 2 * DRAWN_IN)
    return factor
