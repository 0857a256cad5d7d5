"""relief: a picture with alpha inflated into a closed shell of flat Gaussians, without weights.

Not a reconstruction but an honest guess: the silhouette becomes a rounded solid (after Igarashi et
al. 1999, "Teddy"), the front carries the picture, the back what the picture's rim suggests.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions
from phy124.generators.relief.colours import back_picture, clean_picture, colour
from phy124.generators.relief.height import Silhouette, squared_half_thickness
from phy124.generators.relief.surface import Surface, spread
from phy124.progress import Progress, silent

Field = NDArray[np.float64]
WORK = 248
"""Longest side of the silhouette while working, pixels."""
PADDING = 4
"""Transparent pixels around it."""
VIEW_DISTANCE = 2.0
"""Distance of the front camera that sees exactly the picture, in longest sides."""
TANGENT = 0.58
"""Standard deviation along the surface, in spacings: neighbours overlap without holes."""
NORMAL = 0.12
"""Standard deviation across the surface, in spacings: flat, so that the outline is crisp."""
OPACITY = 0.97
DRAWN_IN = 1.1
"""How far below the surface the centres lie, pixels: edge-on Gaussians reach out by as much."""
STAGES = 4


def relief(
    image_rgba: Image.Image | NDArray[np.uint8],
    *,
    seed: int = 0,
    progress: Progress = silent,
    count: int = 50_000,
) -> Gaussians:
    """Inflate the opaque part of a picture [H,W,4].

    Returns about `count` Gaussians; the silhouette's longest side is 1 m, it lies about x = 0 and
    faces +x. The same seed gives the same Gaussians.

    Raises:
        InputError: Nothing in the picture is opaque.
    """
    rng = np.random.default_rng(seed)
    progress("relief", 0, STAGES)
    rgba = _work_picture(image_rgba)
    silhouette = Silhouette.of(rgba[..., 3])
    surface = Surface.of(squared_half_thickness(silhouette))
    progress("relief", 1, STAGES)
    points, normals, spacing = spread(surface, count, rng)
    progress("relief", 2, STAGES)
    picture = clean_picture(rgba)
    rgb = colour(points, normals, picture, back_picture(picture, silhouette))
    progress("relief", 3, STAGES)
    points = points - surface.inset(points, DRAWN_IN) * normals
    gaussians = _placed(points, normals, spacing, rgb, silhouette.inside)
    progress("relief", STAGES, STAGES)
    return gaussians


def _work_picture(image: Image.Image | NDArray[np.uint8]) -> Field:
    """The opaque part [H,W,4] in 0..1, its longest side `WORK` pixels, `PADDING` around it."""
    picture = Image.fromarray(np.asarray(image)) if not isinstance(image, Image.Image) else image
    picture = picture.convert("RGBA")
    box = picture.getchannel("A").point(lambda a: 255 * (a > 127)).getbbox()
    if box is None:
        limit = "Nothing in it is opaque."
        raise InputError("image", "transparent", limit, "Give a picture with an object in it.")
    # One pixel more on each side keeps the half transparent edge.
    left, top, right, bottom = box
    picture = picture.crop((left - 1, top - 1, right + 1, bottom + 1))
    scale = WORK / max(right - left, bottom - top)
    size = tuple(max(3, round(n * scale)) for n in picture.size)
    picture = picture.resize(
        size, Image.Resampling.LANCZOS if scale < 1 else Image.Resampling.BICUBIC
    )
    rgba = np.asarray(picture, dtype=np.float64) / 255
    return np.pad(rgba, ((PADDING, PADDING), (PADDING, PADDING), (0, 0)))


def _placed(points: Field, normals: Field, spacing: Field, rgb: Field, inside: Any) -> Gaussians:
    """From pixels (x right, y down, z to the viewer) to metres in the world."""
    y, x = np.nonzero(inside)
    low, high = np.array([x.min(), y.min(), 0.0]) - 0.5, np.array([x.max(), y.max(), 0.0]) + 0.5
    metre = 1 / float((high - low).max())
    middle = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, 0.0])
    means, normals = _seen_from(VIEW_DISTANCE, (points - middle) * metre, normals)
    # World x is towards the viewer, y to the right, z up.
    world, normals = means[:, [2, 0, 1]] * [1, 1, -1], normals[:, [2, 0, 1]] * [1, 1, -1]
    scales = np.stack([TANGENT * spacing, TANGENT * spacing, NORMAL * spacing], axis=1) * metre
    opacities = np.full(len(world), OPACITY)
    quats = quaternions(_frames(normals))
    return Gaussians.from_rgb(world, quats, scales, opacities, rgb)


def _seen_from(distance: float, points: Field, normals: Field) -> tuple[Field, Field]:
    """Draw the front in so that a camera `distance` away sees each point over its pixel.

    x' = x k(z), y' = y k(z) with k = 1 - z / distance; behind the rim k levels off at once, so
    that the back is hardly wider and there is no edge at z = 0.
    """
    widest = 0.02
    z = points[:, 2:]
    back = np.exp(np.minimum(z, 0) / (distance * widest))
    k = np.where(z > 0, 1 - z / distance, 1 + widest * (1 - back))
    slope = -back / distance
    moved = np.concatenate([points[:, :2] * k, z], axis=1)
    flat = normals[:, :2] / k
    turned = np.concatenate(
        [flat, normals[:, 2:] - slope * (points[:, :2] * flat).sum(axis=1, keepdims=True)], axis=1
    )
    return moved, turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _frames(normals: Field) -> Field:
    """Rotations [N,3,3] whose third column is the normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first), normals], axis=2)
