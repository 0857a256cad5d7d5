"""Builds the shell of an object from an image of its front alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.generators.relief.back import BackLook, choose_look, plain_back
from phy124.generators.relief.colours import (
    REACH,
    Shown,
    blend_pictures,
    clean_picture,
    colour_points,
)
from phy124.generators.relief.ends import End, continue_silhouette
from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.light import fit_light, unlight
from phy124.generators.relief.picture import PADDING, WORK, opaque_size, work_picture
from phy124.generators.relief.shell import DRAWN_IN, Shell
from phy124.generators.relief.sides import Box, check_back
from phy124.generators.relief.solids import RIM, apply_depth, inflate
from phy124.generators.relief.surface import VIEW_DISTANCE, Surface, View, spread

SEEN = 0.7
"""The height of a flat end's plane is a weighted mean. The object's front edge, which is seen on
the image's lowest line, has this weight; the end's corners have the rest. (For divided feet, the
weight is 1.)"""


@dataclass(frozen=True)
class Cap:
    """The flat face at an end of the object."""

    points: Field
    """Lattice of points on the face [M,3], pixels."""
    normals: Field
    """Normals before projection [M,3]."""
    level: float
    """Projected y of the face's plane [pixels]; everything beyond it is cut off."""
    sign: int
    """1 for the bottom, -1 for the top."""

    def within(self, y: Field, by: float) -> NDArray[np.bool_]:
        """Whether projected heights are inside the plane by at least `by` pixels."""
        return (self.level - y) * self.sign >= by


def make_cap(surface: Surface, view: View, end: End, pitch: float) -> Cap:
    """Make the flat face of an end, at the height that follows from the end's rows in the image.

    Args:
        surface: The inflated solid.
        view: The front camera.
        end: The end.
        pitch: Spacing of the points, pixels.
    """
    thick = _thick(surface, end.corner - 0.5 * end.sign)
    feet = _thick(surface, end.outermost - RIM * end.sign) if end.divided else thick
    near = (end.outermost - view.middle[1]) * view.k(np.array(feet))
    seen = 1.0 if end.divided else SEEN
    level = float(seen * near + (1 - seen) * (end.corner - view.middle[1]))
    width = surface.w.shape[1]
    x = np.arange(-width / 2, width / 2, pitch)
    z = np.arange(-thick, thick + pitch, pitch * 3**0.5 / 2)
    gx, gz = np.meshgrid(x, z)
    # A triangular lattice: every second line is shifted by half a spacing.
    gx = gx + np.where(np.arange(len(z)) % 2, pitch / 2, 0.0)[:, None]
    drawn = np.stack([gx.ravel(), np.full(gx.size, level), gz.ravel()], axis=1)
    points = view.unproject(drawn)
    value, gradient = surface.gradient(points)
    points = points[value > 0.5 * np.linalg.norm(gradient, axis=1)]
    depth = points[:, 2]
    tilt = -level / view.distance / view.k(depth) ** 2
    normals = end.sign * np.stack([np.zeros_like(tilt), np.ones_like(tilt), tilt], axis=1)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Cap(points, normals, level, end.sign)


def _thick(surface: Surface, row: float) -> float:
    """Return the largest half thickness in a row [pixels]."""
    return float(np.sqrt(max(surface.w[int(row)].max(), 0.0)))


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
    look: BackLook,
    thickness: float,
) -> Shell:
    """Inflate the silhouette. Colour the back from its image if there is one, else from the front's
    rim.

    Args:
        picture: Image of the front.
        count: Approximate number of points.
        rng: Random number generator.
        step: Called with the number of finished steps, also during a step.
        depth: Depth map of the image; None: the front is inflated like the back.
        back: Image of the object from behind.
        look: Look of the back if there is no such image.
        thickness: Factor on the depth guessed from the silhouette.
    """
    work = continue_silhouette(work_picture(picture, depth=depth), PADDING)
    silhouette = Silhouette.of(work.alpha)
    view = View.of(work.object_mask, VIEW_DISTANCE * WORK)
    surface = inflate(silhouette, work, view, WORK, thickness)
    if depth is not None:
        surface = apply_depth(surface, work.rgba[..., 4], work.object_mask)
    step(1)
    points, normals, spacing = _points(surface, view, work.ends, count, rng, lambda: step(1))
    step(2)
    front = clean_picture(work.rgba[..., :4])
    inner = points - surface.inset(points, DRAWN_IN) * normals
    drawn, turned = view.project_points(inner, normals)
    if back is None:
        light = fit_light(front, surface, work.object_mask)
        unlit = unlight(front, surface, light)
        plain = (choose_look(work.rgba) if look == "auto" else look) == "plain"
        imagined = plain_back(unlit, silhouette.inside, WORK, rng) if plain else unlit
        reach = REACH * WORK if plain else 0.0
        rgb = colour_points(points, normals, surface, front, unlit, imagined, light, reach)
    else:
        scale = Box.of(work.object_mask).size[1] / opaque_size(back)[1]
        middle = float(view.middle[0]), float(view.middle[1])
        shown = Shown(front, middle, FRONT, ACROSS), show_back(back, scale, work.object_mask)
        rgb = blend_pictures(drawn, turned, shown, view.distance)
    step(3)
    return Shell(drawn, turned, spacing, rgb)


def show_back(back: Image.Image, scale: float, object_mask: NDArray[np.bool_]) -> Shown:
    """Mirror an image from behind and check it; `object_mask` is the front's silhouette [H,W].

    Raises:
        InputError: If the silhouettes differ.
    """
    rgba = work_picture(back, scale)[:, ::-1]
    solid = rgba[..., 3] > 0.5
    check_back(object_mask, solid)
    return Shown(clean_picture(rgba), Box.of(solid).middle, BACK, ACROSS)


def _points(
    surface: Surface,
    view: View,
    ends: tuple[End, ...],
    count: int,
    rng: np.random.Generator,
    alive: Callable[[], None],
) -> tuple[Field, Field, Field]:
    """Return points, normals and spacing of the side walls and the flat ends."""
    points, normals, spacing, pitch = spread(surface, ends, count, rng, alive)
    caps = [make_cap(surface, view, end, pitch) for end in ends]
    height = view.project_points(points, normals)[0][:, 1]
    kept = np.ones(len(points), bool)
    for face in caps:
        kept &= face.within(height, DRAWN_IN)
    walls = points[kept], normals[kept], spacing[kept]
    faces = [(face.points, face.normals, np.full(len(face.points), pitch)) for face in caps]
    points, normals, spacing = (np.concatenate(all_) for all_ in zip(walls, *faces, strict=True))
    return points, normals, spacing
