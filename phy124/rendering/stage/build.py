"""Builds the stage of a clip: the surroundings of the object in each frame."""

import base64
import io
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.boundaries import BOUNDARIES, AnyBoundary, Boundary
from phy124.gaussians import Array, Frame
from phy124.imaging.image import open_image
from phy124.io.clip import Clip
from phy124.rendering.stage.frame import POOL, Backdrop, Floor, Solid, StageFrame, bounds
from phy124.rendering.stage.rest import AtRest
from phy124.rendering.stage.shadow import GLASS, SLOPE, Caster, Glass
from phy124.rendering.stage.solids import floor_heights, place_walls
from phy124.scene import View
from phy124.schema.refusals import validate
from phy124.schema.section import Section

RECENT = 64
"""Number of frames whose surroundings are stored for pictures from other sides."""
SAMPLE = 1024
"""Number of Gaussians whose paths determine the size of the shadow map."""
OUTLIERS = (0.5, 99.5)
"""The shadow map extends between these percentiles of the Gaussians' positions in each frame."""
ROOM = 0.9
"""Margin of the shadow map, as a fraction of the object's largest height above the floor."""
LARGEST = 4.0
"""Half the side of the largest shadow map, in units of the object's size."""
PICTURE_SIDE = 1280
"""Longest side of the backdrop picture in a player [pixels]."""


@dataclass(eq=False)
class Stage:
    """The surroundings of the object in each frame; recent frames are stored for reuse."""

    backdrop: Backdrop
    heights: NDArray[np.float64]
    """Height of the floor in each frame [T], m."""
    walls: tuple[tuple[Solid, NDArray[np.float64], NDArray[np.bool_]], ...]
    """Each boundary as a solid, with its displacement [T,3], m, and whether it is present [T]."""
    caster: Caster | None
    """Object that computes the shadows; None if there is no floor."""
    shadowing: NDArray[np.bool_] | None = None
    """Mask of the Gaussians that cast a shadow [N]; None if all of them do."""
    pool: float = POOL
    """Brightness that is added in the middle of the floor."""
    frames: dict[int, StageFrame] = field(default_factory=dict)
    lock: Any = field(default_factory=Lock)

    def at(self, frame: Frame) -> StageFrame:
        """Return the surroundings of the object in a frame of the clip."""
        with self.lock:  # several threads, one for each side, request the same frame
            if frame.index not in self.frames:
                while len(self.frames) >= RECENT:
                    del self.frames[next(iter(self.frames))]
                self.frames[frame.index] = self._make(frame)
            return self.frames[frame.index]

    def _make(self, frame: Frame) -> StageFrame:
        solids = tuple(
            replace(solid, centre=solid.centre + displacement[frame.index])
            for solid, displacement, present in self.walls
            if present[frame.index]
        )
        box = bounds(frame.gaussians.means) if solids else None
        return StageFrame(self.backdrop, self._floor(frame, solids), solids, box)

    def _floor(self, frame: Frame, solids: tuple[Solid, ...]) -> Floor | None:
        caster, gaussians = self.caster, frame.gaussians
        if caster is None:
            return None
        height = float(self.heights[frame.index])
        if self.shadowing is not None:
            gaussians = gaussians.select(self.shadowing)
        shade = caster.shade(gaussians, height, glass(caster, solids, height))
        return Floor(height, caster.middle, caster.reach, shade, self.pool)


def make_stage(
    clip: Clip, view: View, *, rest: AtRest | None = None, device: str = "cpu"
) -> Stage | None:
    """Build the stage of a clip; None if the view shows the object in front of a plain background.

    Args:
        clip: The clip.
        view: View that defines the stage and the background.
        rest: The objects at rest. If None, the objects in the first frame.
        device: Warp's name of the device that computes the shadows.

    Raises:
        InputError: The picture for the background cannot be opened.
    """
    if view.stage == "plain" and view.picture is None and view.gradient is None:
        return None
    if view.stage == "transparent":
        return None
    background = backdrop(view)
    rest = AtRest.of(clip) if rest is None else rest
    if view.stage == "plain" or not len(rest.points):
        return Stage(background, np.zeros(len(clip)), (), None)
    walls = place_walls(boundaries_of(clip), rest)
    heights = floor_heights(walls, rest.points, clip.times)
    shown = tuple(
        (wall.solid(), wall.displacements(clip.times), wall.present(clip.times))
        for wall in walls
        if not wall.is_floor
    )
    shadowing = None if clip.object_mask.all() else clip.object_mask
    return Stage(background, heights, shown, _caster(clip, rest.points, heights, device), shadowing)


def _finite(points: NDArray) -> NDArray[np.bool_]:
    return np.asarray(np.isfinite(np.asfortranarray(points)).all(axis=1))


def boundaries_of(clip: Clip) -> Sequence[Boundary]:
    """Return the boundaries of a clip's scene, except those from plug-ins that are not installed.

    A plug-in counts as installed if its class is registered or is defined in this program.
    """
    defined = {kind.model_fields["kind"].default: kind for kind in _kinds(Boundary)}
    known: list[Any] = []
    for options in clip.scene.get("boundaries", []):
        kind = options.get("kind")
        if BOUNDARIES.knows(options):
            known.append(options)
        elif kind in defined:
            known.append(defined[kind].model_validate(options))
    return validate(_Boundaries, {"boundaries": known}, "clip").boundaries


class _Boundaries(Section):
    """A list of boundaries; the names of objects in them are not checked."""

    boundaries: tuple[AnyBoundary, ...]


def _kinds(base: type[Boundary]) -> Iterator[type[Boundary]]:
    for kind in base.__subclasses__():
        if "kind" in kind.model_fields:
            yield kind
        yield from _kinds(kind)


def _caster(clip: Clip, rest: NDArray, heights: NDArray, device: str) -> Caster:
    chosen = np.flatnonzero(clip.object_mask & _finite(clip.means[0]))
    chosen = chosen[:: 1 + len(chosen) // SAMPLE]
    first = clip.means[0][chosen].astype(np.float64)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for height, (points, _, _) in zip(heights, clip.rows_of(chosen), strict=True):
        points = np.where(np.isfinite(points), points, first)
        points[:, 2] -= height
        points[:, :2] += np.maximum(points[:, 2:], 0) * np.array(SLOPE)
        ends = np.percentile(points, OUTLIERS, axis=0)
        low, high = np.minimum(low, ends[0]), np.maximum(high, ends[1])
    size = float(np.ptp(rest, axis=0).max())
    tallest = max(float(high[2]), 0.05 * size)
    reach = min(float((high - low)[:2].max()) / 2 + ROOM * tallest, LARGEST * size)
    x, y = (low + high)[:2] / 2
    return Caster((float(x), float(y)), max(reach, 0.1 * size), tallest, device)


def glass(caster: Caster, solids: Iterable[Solid], floor: float) -> Iterator[Glass]:
    """Yield the optical depth that each glass solid adds to two layers of the shadow map.

    The layers are just below and just above the solid's lowest point. The optical depth is
    interpolated linearly between the two layers.
    """
    for solid in solids:
        x, y, z = solid.centre.tolist()
        *reach, down = (np.abs(solid.axes.T) @ solid.half + solid.radius).tolist()
        height = max(z - down - floor, 0.0)
        layer, upper = caster.layer(height)
        x, y = x + height * SLOPE[0], y + height * SLOPE[1]
        along_x, along_y = caster.within(x, y, *reach)
        dark: Array | float = -math.log(1 - GLASS)
        if solid.radius:
            xs, ys = caster.cell_centres
            dark = dark * _capsule_mask(solid, xs[along_x, None] - x, ys[None, along_y] - y)
        yield (layer, along_x, along_y), (1 - upper) * dark
        yield (layer + 1, along_x, along_y), upper * dark


def _capsule_mask(solid: Solid, x: Array, y: Array) -> Array:
    """Return 1 under a capsule of glass, 0 elsewhere; positions are relative to its centre."""
    ax, ay = solid.axes[0, :2]
    along = x * ax + y * ay
    near = np.clip(along / max(ax * ax + ay * ay, 1e-12), -solid.half[0], solid.half[0])
    away = (x - near * ax) ** 2 + (y - near * ay) ** 2
    return (away <= solid.radius**2).astype(np.float32)


def backdrop(view: View) -> Backdrop:
    """Return the backdrop of a view: a colour, a gradient of two colours, or the user's picture.

    Raises:
        InputError: The picture cannot be opened.
    """
    picture = None
    if view.picture is not None:
        picture = np.asarray(open_image(view.picture, field="view.picture").convert("RGB"))
    return Backdrop(view.background, view.gradient or view.background, picture)


def pack_stage(
    stage: Stage | None, clip: Clip, gloss: dict[str, Any] | None = None
) -> tuple[dict[str, Any], NDArray[np.uint8]] | None:
    """Return a clip's stage in the format of the player (phy124/io/viewer/stage.js).

    The result consists of plain data, and of shadow maps [T,cells,cells], in which 255 means no
    light. `clip` contains the frames that the player shows. If liquids have separate opacities,
    `gloss` contains them in `hues`.
    """
    if stage is None:
        return None
    frames, hues = clip.frames(), (gloss or {}).get("hues")
    if hues is not None:
        frames = (
            replace(frame, gaussians=replace(frame.gaussians, opacities=hue[:, 3] / 255))
            for frame, hue in zip(frames, hues, strict=True)
        )
    first, shades = None, []
    for frame in frames:
        floor = stage.at(frame).floor
        if floor is not None:
            first = first or floor
            shades.append(np.rint(floor.shade * 255).astype(np.uint8))
    back = stage.backdrop
    data: dict[str, Any] = {"top": list(back.top), "bottom": list(back.bottom)}
    data["picture"] = None if back.picture is None else _data_url(back.picture)
    data["floor"] = first and {
        "heights": stage.heights.tolist(),
        "middle": list(first.middle),
        "reach": first.reach,
        "cells": len(first.shade),
    }
    data["solids"] = [
        {
            "centres": (solid.centre + displacement).tolist(),
            "present": present.tolist(),
            "half": solid.half.tolist(),
            "axes": solid.axes.tolist(),
            "radius": solid.radius,
        }
        for solid, displacement, present in stage.walls
    ]
    return data, np.stack(shades) if shades else np.zeros((len(clip), 0, 0), np.uint8)


def _data_url(picture: NDArray[np.uint8]) -> str:
    image = Image.fromarray(picture)
    image.thumbnail((PICTURE_SIDE, PICTURE_SIDE))
    with io.BytesIO() as file:
        image.save(file, "JPEG", quality=88)
        return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"
