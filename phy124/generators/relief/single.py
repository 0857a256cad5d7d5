"""The shell of an object whose shape is known from the front alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.generators.relief.caps import cap
from phy124.generators.relief.colours import back_picture, clean_picture, colour
from phy124.generators.relief.ends import End, continued
from phy124.generators.relief.front import with_front
from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.picture import PADDING, WORK, opaque_size, work_picture
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.sides import Box, check_back
from phy124.generators.relief.solids import inflated
from phy124.generators.relief.surface import Surface, spread
from phy124.generators.relief.textures import Shown, blended
from phy124.generators.relief.view import VIEW_DISTANCE, View

Field = NDArray[np.float64]
Step = Callable[[int], None]
FRONT, BACK, ACROSS = np.array([0.0, 0, 1]), np.array([0.0, 0, -1]), np.array([1.0, 0, 0])


def from_front(
    picture: Image.Image,
    *,
    count: int,
    rng: np.random.Generator,
    step: Step,
    depth: NDArray | None,
    back: Image.Image | None,
    thickness: float,
) -> Shell:
    """The silhouette inflated; the back as the picture's rim suggests it, or as pictured.

    Args:
        picture: The front.
        count: Approximate number of points.
        rng: Random numbers.
        step: Called with the number of steps done, also between them.
        depth: Depth map of the picture; None: the front is inflated, too.
        back: The object from behind.
        thickness: Of the object, relative to what its silhouette suggests.
    """
    work = continued(work_picture(picture, depth=depth), PADDING)
    silhouette = Silhouette.of(work.alpha)
    view = View.of(work.own, VIEW_DISTANCE * WORK)
    surface = inflated(silhouette, work, view, WORK, thickness)
    if depth is not None:
        surface = with_front(surface, work.rgba[..., 4], work.own)
    step(1)
    points, normals, spacing = _points(surface, view, work.ends, count, rng, lambda: step(1))
    step(2)
    front = clean_picture(work.rgba[..., :4])
    inner = points - surface.inset(points, DRAWN_IN) * normals
    drawn, turned = view.drawn(inner, normals)
    if back is None:
        imagined = back_picture(front, silhouette.inside, WORK)
        rgb = colour(points, surface, silhouette.inside, front, imagined, WORK)
    else:
        scale = Box.of(work.own).size[1] / opaque_size(back)[1]
        middle = float(view.middle[0]), float(view.middle[1])
        shown = Shown(front, middle, FRONT, ACROSS), back_shown(back, scale, work.own)
        rgb = blended(drawn, turned, shown, view.distance)
    step(3)
    return Shell(drawn, turned, spacing, rgb)


def back_shown(back: Image.Image, scale: float, own: NDArray[np.bool_]) -> Shown:
    """A picture from behind, mirrored; `own` is the front's silhouette [H,W].

    Raises:
        InputError: If the silhouettes differ.
    """
    rgba = work_picture(back, scale)[:, ::-1]
    solid = rgba[..., 3] > 0.5
    check_back(own, solid)
    return Shown(clean_picture(rgba), Box.of(solid).middle, BACK, ACROSS)


def _points(
    surface: Surface,
    view: View,
    ends: tuple[End, ...],
    count: int,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[Field, Field, Field]:
    """Points, normals and spacing of the walls between the flat ends, and of those."""
    points, normals, spacing, pitch = spread(surface, ends, count, rng, alive)
    caps = [cap(surface, view, end, pitch) for end in ends]
    height = view.drawn(points, normals)[0][:, 1]
    kept = np.ones(len(points), bool)
    for face in caps:
        kept &= face.within(height, DRAWN_IN)
    walls = points[kept], normals[kept], spacing[kept]
    faces = [(face.points, face.normals, np.full(len(face.points), pitch)) for face in caps]
    points, normals, spacing = (np.concatenate(all_) for all_ in zip(walls, *faces, strict=True))
    return points, normals, spacing
