"""relief: inflates a picture with alpha into a closed shell of flat Gaussians, without weights.

It is a guess, not a reconstruction: the silhouette becomes the solid that it most plainly suggests
(`phy124.generators.relief.solids`), the front shows the picture, and the back what the picture's
rim suggests. How close that comes to solids known from all sides is in docs/results/relief.md.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.errors import InputError
from phy124.gaussians import Gaussians, quaternions
from phy124.generators.depth_map import fitted
from phy124.generators.relief.caps import cap
from phy124.generators.relief.colours import back_picture, clean_picture, colour
from phy124.generators.relief.ends import End, continued
from phy124.generators.relief.front import normalised, with_front
from phy124.generators.relief.height import Silhouette
from phy124.generators.relief.solids import inflated
from phy124.generators.relief.surface import Surface, spread
from phy124.generators.relief.view import View
from phy124.progress import Progress, silent

Field = NDArray[np.float64]
WORK = 248
"""Longest side of the silhouette during the computation, pixels."""
PADDING = 4
"""Width of the transparent border around it, pixels."""
VIEW_DISTANCE = 2.0
"""Distance of the front camera that sees exactly the picture, in longest sides."""
TANGENT = 0.58
"""Standard deviation along the surface, in spacings: neighbours overlap without holes."""
BACK_REACH = 1.25
"""The same on the back, relative to the front."""
NORMAL = 0.12
"""Standard deviation across the surface, in spacings: flat, so that the outline is crisp."""
OPACITY = 0.97
DRAWN_IN = 1.35
"""Depth of the centres below the surface, pixels: edge-on Gaussians extend as far outwards."""
STAGES = 4


def relief(
    image_rgba: Image.Image | NDArray[np.uint8],
    *,
    seed: int = 0,
    progress: Progress = silent,
    count: int = 50_000,
    depth: NDArray | None = None,
) -> Gaussians:
    """Inflate the opaque part of a picture.

    A camera `VIEW_DISTANCE` in front sees its silhouette with a longest side of 1 m at x = 0; the
    object faces +x with its middle near there. Equal
    seeds give equal Gaussians.

    Args:
        image_rgba: The picture [H,W,4].
        seed: Of the random positions.
        progress: Called as in `phy124.progress`.
        count: Approximate number of Gaussians.
        depth: Depth map of the picture [H,W] in any unit, near is large; None: the front is
            inflated, too.

    Raises:
        InputError: If nothing in the picture is opaque, or the depth map does not fit it.
    """
    rng = np.random.default_rng(seed)
    progress("relief", 0, STAGES)
    picture = continued(_work_picture(image_rgba, depth), PADDING)
    silhouette = Silhouette.of(picture.alpha)
    view = View.of(picture.own, VIEW_DISTANCE * WORK)
    surface = inflated(silhouette, picture, view, WORK)
    if depth is not None:
        surface = with_front(surface, picture.rgba[..., 4], picture.own)
    progress("relief", 1, STAGES)
    alive = partial(progress, "relief", 1, STAGES)
    points, normals, spacing = _points(surface, view, picture.ends, count, rng, alive)
    progress("relief", 2, STAGES)
    front = clean_picture(picture.rgba[..., :4])
    back = back_picture(front, silhouette.inside, WORK)
    rgb = colour(points, surface, silhouette.inside, front, back, WORK)
    progress("relief", 3, STAGES)
    points = points - surface.inset(points, DRAWN_IN) * normals
    gaussians = _placed(*view.drawn(points, normals), spacing, rgb)
    progress("relief", STAGES, STAGES)
    return gaussians


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


def _work_picture(image: Image.Image | NDArray[np.uint8], depth: NDArray | None) -> Field:
    """The opaque part [H,W,4] in 0..1, its longest side `WORK` pixels, padded by `PADDING`.

    A depth map is its fifth channel.
    """
    picture = Image.fromarray(np.asarray(image)) if not isinstance(image, Image.Image) else image
    picture = picture.convert("RGBA")
    rows, columns = np.nonzero(np.asarray(picture.getchannel("A")) > 127)
    if not len(rows):
        limit = "Nothing in it is opaque."
        raise InputError("image", "transparent", limit, "Give a picture with an object in it.")
    left, top, right, bottom = (
        int(v) for v in (columns.min(), rows.min(), columns.max(), rows.max())
    )
    # One pixel more on each side keeps the half transparent edge.
    box = left - 1, top - 1, right + 2, bottom + 2
    distances = None
    if depth is not None:
        alpha = np.asarray(picture.getchannel("A"))
        distances = Image.fromarray(normalised(fitted(depth, *picture.size), alpha)).crop(box)
    picture = picture.crop(box)
    scale = WORK / (1 + max(right - left, bottom - top))
    size = max(3, round(picture.width * scale)), max(3, round(picture.height * scale))
    # Filters without negative lobes: colours must not overshoot where alpha is cut at 1. Hamming is
    # the sharper one, but shows the pixels of tiny pictures as squares.
    sharp, smooth = Image.Resampling.HAMMING, Image.Resampling.BILINEAR
    picture = picture.resize(size, sharp if scale < 2 else smooth)
    rgba = np.asarray(picture, dtype=np.float64) / 255
    if distances is not None:
        far = np.asarray(distances.resize(size, smooth), dtype=np.float64)
        rgba = np.concatenate([rgba, far[..., None]], axis=2)
    return np.pad(rgba, ((PADDING, PADDING), (PADDING, PADDING), (0, 0)))


def _placed(points: Field, normals: Field, spacing: Field, rgb: Field) -> Gaussians:
    """From pixels (x right, y down, z towards the viewer) to metres in the world."""
    # World x is towards the viewer, y to the right, z up.
    means = points[:, [2, 0, 1]] * [1, 1, -1] / WORK
    normals = normals[:, [2, 0, 1]] * [1, 1, -1]
    # Wider behind, where colours are smooth: no gap shows the front from within.
    reach = TANGENT * spacing * np.interp(-normals[:, 0], [0.0, 0.5], [1.0, BACK_REACH])
    scales = np.stack([reach, reach, NORMAL * spacing], axis=1) / WORK
    opacities = np.full(len(means), OPACITY)
    quats = quaternions(_frames(normals))
    return Gaussians.from_rgb(
        *(v.astype(np.float32) for v in (means, quats, scales, opacities, rgb))
    )


def _frames(normals: Field) -> Field:
    """Rotations [N,3,3] whose third column is the normal."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = first, np.cross(normals, first), normals
    return np.stack(axes, axis=2).astype(np.float64)
