"""Framing: where the cameras of a clip stand, and whether they show everything that moves."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.camera import FOV_Y, VIEWS, Camera
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.rendering.nearest import OUTSIDE, Sample, Values, nearest
from phy124.scene import View
from phy124.scene.cameras import Poses

STEP = 0.1
"""Recommended distances are multiples of this, in object sizes."""
LARGEST = 5.0
"""Extent of a motion that a still camera shows, in object sizes; larger ones are followed."""
FARTHEST = 100.0
"""Largest distance a view may have, in object sizes."""


def cameras(clip: Clip, view: View, side: str) -> list[Camera]:
    """The camera of each frame from one side: fixed, circling, moving, or following the object.

    Without a distance of its own (`View.fits`) it stands as near as shows the whole motion, and
    follows one of which a still camera would show most frames too small.
    """
    camera, poses = view.camera(side), _poses(clip, view, side)
    if view.fits and not (camera is not None and camera.chosen):
        return _nearest(clip, view, poses)
    low, high = _box(clip, view)
    size = float((high - low).max())
    path = Sample.of(clip).path if view.follow else 0.0
    targets = (low + high) / 2 + size * poses.target + path
    return _placed(view, poses, poses.distance * size * _portrait(view), targets)


def standing(clip: Clip, view: View, side: str) -> Camera:
    """The camera of a player, which stands still while the clip plays."""
    return cameras(clip, view.model_copy(update={"follow": False}), side)[0]


def _nearest(clip: Clip, view: View, poses: Poses) -> list[Camera]:
    """Cameras as near as shows the whole motion, or a motion of `LARGEST` if it is larger."""
    low, high = _box(clip, view)
    size = float((high - low).max())
    sample, count = Sample.of(clip), len(clip)
    follow = sample.rare(LARGEST * size) if view.follow is None else view.follow
    seen, path = (sample.followed(), sample.path) if follow else (sample, 0.0)
    around = _placed(view, poses, np.ones(count), np.tile(seen.middle, (count, 1)))
    stand = nearest(seen, around, zooms=view.fov == FOV_Y)
    farthest = stand.zoom * LARGEST * size / (2 * min(around[0].halves))
    middle = seen.middle + stand.shift if stand.distance <= farthest else (low + high) / 2
    radii = np.full(count, min(stand.distance, farthest))
    targets = np.broadcast_to(middle + path, (count, 3))
    return _placed(view, _narrowed(poses, stand.zoom), radii, targets)


def _narrowed(poses: Poses, zoom: float) -> Poses:
    """The same with a view that shows a part of what it showed, once as large."""
    if zoom == 1:
        return poses
    return poses.replace(fov=np.degrees(2 * np.arctan(np.tan(np.radians(poses.fov) / 2) / zoom)))


def _placed(view: View, poses: Poses, radii: Values, targets: Values) -> list[Camera]:
    """Cameras that look at targets [T,3] m from distances [T] m."""
    lists = (poses.azimuth, poses.elevation, radii, targets, poses.fov)
    return [
        Camera.orbit(azimuth, elevation, radius, view.size, (x, y, z), fov)
        for azimuth, elevation, radius, (x, y, z), fov in zip(
            *(values.tolist() for values in lists), strict=True
        )
    ]


def _portrait(view: View) -> float:
    """How much farther away a portrait picture is taken, to be as wide as a square one."""
    width, height = view.size
    return max(1.0, height / width)


def _poses(clip: Clip, view: View, side: str) -> Poses:
    """Where the camera stands around the object in each frame."""
    count, camera = len(clip), view.camera(side)
    azimuth = 0.0 if camera or side == "orbit" else _azimuth(side)
    still = Poses.still(count, azimuth, view.elevation, view.distance, view.fov)
    if camera is not None:
        times = clip.times - clip.times[0]
        return camera.poses(times, _length(clip), still)
    return still.replace(azimuth=np.arange(count) * 360 / count) if side == "orbit" else still


def _length(clip: Clip) -> float:
    """How long a clip is, each frame counted for the time to the next [s]."""
    count = len(clip)
    return float(clip.times[-1] - clip.times[0]) * count / (count - 1) if count > 1 else 1.0


@dataclass(frozen=True)
class Departure:
    """A side whose pictures do not show the whole object."""

    view: str
    frame: int
    """The first frame in which part of it is outside, from 0."""
    worst_frame: int
    """The frame in which most of it is outside."""
    outside: float
    """Fraction of the object that is outside in that frame."""
    distance: float
    """Distance from which all of it would be visible, in object sizes."""


def departures(clip: Clip, view: View) -> list[Departure]:
    """The sides from which the object leaves the picture.

    A camera with a distance, an opening or a target of its own was meant to show what it shows.
    """
    own = {camera.name for camera in view.cameras if camera.chosen}
    sample = Sample.of(clip)
    points = sample.means[:, sample.moving]
    found = [_departure(clip, points, view, side) for side in view.sides if side not in own]
    return [departure for departure in found if departure is not None]


def framing(clip: Clip, view: View) -> dict[str, Any]:
    """The `departures`, and `notes`: sentences about them and about ways that are cut off."""
    left = departures(clip, view)
    notes = [note for note in (_note(clip, view, left), _cut_off(clip, view)) if note]
    return {"departures": [asdict(one) for one in left], "notes": notes}


def _cut_off(clip: Clip, view: View) -> str | None:
    """A sentence if the way of a camera goes on after the clip, or None."""
    last = float(clip.times[-1] - clip.times[0])
    late = [camera for camera in view.cameras if camera.end > last * (1 + 1e-9)]
    if not late:
        return None
    names, end = ", ".join(camera.name for camera in late), max(camera.end for camera in late)
    return (
        f"The clip ends at {last:.3g} s, before the way of {names} does; "
        f"simulate with --seconds {end + _length(clip) / len(clip):.3g} to see all of it."
    )


def _note(clip: Clip, view: View, left: list[Departure]) -> str | None:
    if not left:
        return None
    sides = ", ".join(
        f"{one.view} from frame {one.frame} (frame {one.worst_frame}: {one.outside:.0%} outside)"
        for one in left
    )
    remedies = []
    distance = max(one.distance for one in left)
    if distance <= FARTHEST:
        remedies.append(f"view.distance = {distance:g}")
    following = view.model_copy(update={"follow": True})
    if not view.follow and not departures(clip, following):
        remedies.append("view.follow = true")
    remedy = " or ".join(remedies) or "a wider view.fov"
    return f"The object leaves the picture: {sides}. Film it again with {remedy}."


def _departure(clip: Clip, points: Values, view: View, side: str) -> Departure | None:
    """What a side misses of the points [T,S,3], or None."""
    seen = cameras(clip, view, side)
    needed = _radii(points, seen)
    radius = math.dist(seen[0].eye, seen[0].target)
    outside = (needed > radius * (1 + 1e-9)).mean(axis=1)
    if not (outside > OUTSIDE).any():
        return None
    still = view.model_copy(update={"fit": False, "follow": bool(view.follow)})
    usual = cameras(clip, still, side)
    enough = np.quantile(_radii(points, usual), 1 - OUTSIDE, axis=1, method="higher").max()
    ratio = float(enough) / math.dist(usual[0].eye, usual[0].target)
    distance = math.ceil(ratio * view.distance / STEP) * STEP
    first, worst = int((outside > OUTSIDE).argmax()), int(outside.argmax())
    return Departure(side, first, worst, float(outside[worst]), round(distance, 3))


def _radii(points: Values, cameras: list[Camera]) -> Values:
    """Distances from their targets at which cameras would see each of the points [T,S]."""
    return np.stack([_radius(seen, at) for seen, at in zip(points, cameras, strict=True)])


def _radius(points: Values, camera: Camera) -> Values:
    """Distance from its target at which the camera would see each of the points [S]."""
    across, down, ahead = ((points - camera.target) @ camera.view[:3, :3].T).T
    half_width, half_height = camera.halves
    return np.maximum(np.abs(across) / half_width, np.abs(down) / half_height) - ahead


def _azimuth(side: str) -> float:
    return VIEWS[side] if side in VIEWS else float(side.removeprefix("azimuth-"))


def _box(clip: Clip, view: View) -> tuple[NDArray, NDArray]:
    """Corners of the object at rest, and of the ground below if it will fall there."""
    # A row per axis, where extremes take a small part of the time of short rows.
    rest = np.ascontiguousarray(clip.means[0][clip.own].T)
    first = np.compress(np.isfinite(rest).all(axis=0), rest, axis=1)
    if not first.size:
        limit = "no Gaussian of its first frame is anywhere: all have NaN or infinite values."
        raise InputError("clip", f"{len(clip)} frames", limit, "Simulate it once more.")
    low, high = first.min(axis=1), first.max(axis=1)
    floors = [b["height"] for b in clip.scene.get("boundaries", []) if b["kind"] == "ground"]
    if floors and not view.follow:
        low = np.minimum(low, [np.inf, np.inf, max(floors)])
    return low, high
