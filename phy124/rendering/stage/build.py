"""The stage of a clip: what stands around the object in each of its frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import BOUNDARIES, Boundary
from phy124.gaussians import Array, Frame
from phy124.io.clip import Clip
from phy124.rendering.stage.backdrop import backdrop
from phy124.rendering.stage.frame import POOL, Backdrop, Floor, Solid, StageFrame, bounds
from phy124.rendering.stage.ground import floor_heights
from phy124.rendering.stage.shadow import GLASS, SLOPE, Caster, Glass
from phy124.rendering.stage.solids import placed
from phy124.scene import Scene, View
from phy124.schema.plugins import load_plugin

SAMPLE = 1024
"""Number of Gaussians whose path decides how much of the floor the shadow map covers."""
OUTLIERS = (0.5, 99.5)
"""Percentiles of their places, in each frame, that it covers."""
ROOM = 0.9
"""Floor around them that it covers too, in heights of the object."""
LARGEST = 4.0
"""Half its largest side, in object sizes."""


@dataclass(eq=False)
class Stage:
    """What stands around the object, by frame; a frame's is kept from view to view."""

    backdrop: Backdrop
    heights: NDArray[np.float64]
    """Height of the floor [T], m."""
    walls: tuple[tuple[Solid, NDArray[np.float64], NDArray[np.bool_]], ...]
    """What is drawn of each boundary, where it is [T,3] m, and whether it is there [T]."""
    caster: Caster | None
    """Makes shadows; None: there is no floor."""
    own: NDArray[np.bool_] | None = None
    """Which Gaussians cast a shadow [N]; None: all."""
    pool: float = POOL
    """How much brighter the floor is in the middle."""
    frames: dict[int, StageFrame] = field(default_factory=dict)

    def at(self, frame: Frame) -> StageFrame:
        """What is around the object in a frame of the clip."""
        if frame.index not in self.frames:
            self.frames[frame.index] = self._made(frame)
        return self.frames[frame.index]

    def _made(self, frame: Frame) -> StageFrame:
        solids = tuple(
            replace(solid, centre=solid.centre + moved[frame.index])
            for solid, moved, there in self.walls
            if there[frame.index]
        )
        box = bounds(frame.gaussians.means) if solids else None
        return StageFrame(self.backdrop, self._floor(frame, solids), solids, box)

    def _floor(self, frame: Frame, solids: tuple[Solid, ...]) -> Floor | None:
        caster, gaussians = self.caster, frame.gaussians
        if caster is None:
            return None
        height = float(self.heights[frame.index])
        own = gaussians if self.own is None else gaussians.select(self.own)
        shade = caster.shade(own, height, glass(caster, solids, height))
        return Floor(height, caster.middle, caster.reach, shade, self.pool)


def stage_of(
    clip: Clip, view: View, *, rest: NDArray | None = None, device: str = "cpu"
) -> Stage | None:
    """The stage of a clip; None if there is nothing but the object before one colour.

    Args:
        clip: The clip.
        view: What is to be behind and around the object.
        rest: Where the object is at rest [N,3], m; None: as in the first frame.
        device: Warp's name of the device that makes the shadows.

    Raises:
        InputError: The picture for the background cannot be opened.
    """
    if view.stage == "plain" and view.picture is None and view.gradient is None:
        return None
    if view.stage == "transparent":
        return None
    behind = backdrop(view)
    rest = np.asarray(clip.means[0][clip.own] if rest is None else rest)
    # Each axis in a row of memory, where extremes take a fraction of the time.
    rest = np.asfortranarray(rest[_finite(rest)], np.float64)
    if view.stage == "plain" or not len(rest):
        return Stage(behind, np.zeros(len(clip)), (), None)
    walls = placed(_boundaries(clip), rest)
    heights = floor_heights(walls, rest, clip.times)
    shown = tuple(
        (wall.solid(), wall.displacements(clip.times), wall.present(clip.times))
        for wall in walls
        if not wall.is_floor
    )
    own = None if clip.own.all() else clip.own
    return Stage(behind, heights, shown, _caster(clip, rest, heights, device), own)


def _finite(points: NDArray) -> NDArray[np.bool_]:
    """Which of the points [N,3] are somewhere."""
    return np.asarray(np.isfinite(np.asfortranarray(points)).all(axis=1))


def _boundaries(clip: Clip) -> Sequence[Boundary]:
    """The boundaries of a clip's scene.

    Of those from outside these are known: registered ones, and those of a class that this program
    has defined.
    """
    defined = {kind.model_fields["kind"].default: kind for kind in _kinds(Boundary)}
    known: list[Any] = []
    for told in clip.scene.get("boundaries", []):
        kind = told.get("kind")
        if kind in BOUNDARIES.by_name or load_plugin("boundaries", kind) is not None:
            known.append(told)
        elif kind in defined:
            known.append(defined[kind].model_validate(told))
    return Scene.from_data({"boundaries": known}).boundaries


def _kinds(base: type[Boundary]) -> Iterator[type[Boundary]]:
    """All subclasses that name their kind."""
    for kind in base.__subclasses__():
        if "kind" in kind.model_fields:
            yield kind
        yield from _kinds(kind)


def _caster(clip: Clip, rest: NDArray, heights: NDArray, device: str) -> Caster:
    """A shadow map that covers the floor around the object in all frames."""
    chosen = np.flatnonzero(clip.own & _finite(clip.means[0]))
    points = clip.means[:, chosen[:: 1 + len(chosen) // SAMPLE]].astype(np.float64)
    points = np.where(np.isfinite(points), points, points[0])
    points[..., 2] -= heights[:, None]
    points[..., :2] += np.maximum(points[..., 2:], 0) * np.array(SLOPE)
    ends = np.percentile(points, OUTLIERS, axis=1)
    low, high = ends[0].min(axis=0), ends[1].max(axis=0)
    size = float(np.ptp(rest, axis=0).max())
    tallest = max(float(high[2]), 0.05 * size)
    reach = min(float((high - low)[:2].max()) / 2 + ROOM * tallest, LARGEST * size)
    x, y = (low + high)[:2] / 2
    return Caster((float(x), float(y)), max(reach, 0.1 * size), tallest, device)


def glass(caster: Caster, solids: Iterable[Solid], floor: float) -> Iterator[Glass]:
    """What is drawn as glass, as optical depth in cells of two layers, at its lowest point."""
    for solid in solids:
        x, y, z = solid.centre.tolist()
        *reach, down = (np.abs(solid.axes.T) @ solid.half + solid.radius).tolist()
        height = max(z - down - floor, 0.0)
        layer, upper = caster.layer(height)
        x, y = x + height * SLOPE[0], y + height * SLOPE[1]
        along_x, along_y = caster.within(x, y, *reach)
        dark: Array | float = -math.log(1 - GLASS)
        if solid.radius:
            xs, ys = caster.places
            dark = dark * _covered(solid, xs[along_x, None] - x, ys[None, along_y] - y)
        yield (layer, along_x, along_y), (1 - upper) * dark
        yield (layer + 1, along_x, along_y), upper * dark


def _covered(solid: Solid, x: Array, y: Array) -> Array:
    """Which places are under a capsule, 1 or 0; they are relative to its middle."""
    ax, ay = solid.axes[0, :2]
    along = x * ax + y * ay
    near = np.clip(along / max(ax * ax + ay * ay, 1e-12), -solid.half[0], solid.half[0])
    away = (x - near * ax) ** 2 + (y - near * ay) ** 2
    return (away <= solid.radius**2).astype(np.float32)
