"""Framing: where the cameras of a clip stand, and whether they show everything that moves."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.camera import VIEWS, Camera
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.scene import View
from phy124.scene.cameras import Poses

SAMPLE = 4096
"""Number of Gaussians, evenly picked, that represent all of them."""
VISIBLE = 0.1
"""Opacity from which a Gaussian counts as part of the object."""
OUTSIDE = 0.01
"""Fraction of the object that may be outside the picture without a warning."""
STEP = 0.1
"""Recommended distances are multiples of this, in object sizes."""
FIT_AT_MOST = 3.0
"""How many times farther away than usual a camera stands at most to see the whole motion."""
ROOM = 1.15
"""How much farther it stands than the middles of nearly all Gaussians ask for."""
FARTHEST = 100.0
"""Largest distance a view may have, in object sizes."""


def fitted(clip: Clip, view: View) -> View:
    """The view from far enough away to see the whole motion, if it is to fit (`view.fit`)."""
    if not view.fit:
        return view
    given = view.model_copy(update={"fit": False})
    if view.follow or view.distance != View().distance:
        return given
    left = departures(clip, given)
    if not left:
        return given
    needed = ROOM * max(one.distance for one in left)
    return given.model_copy(update={"distance": min(needed, FIT_AT_MOST * view.distance)})


def cameras(clip: Clip, view: View, side: str) -> list[Camera]:
    """The camera of each frame from one side: fixed, circling, moving, or following the object.

    Portrait pictures are taken from farther away, so that their width shows as much as that of a
    square picture.
    """
    view = fitted(clip, view)
    low, high = _box(clip, view)
    size = float((high - low).max())
    poses = _poses(clip, view, side)
    targets = (low + high) / 2 + size * poses.target + (_path(clip) if view.follow else 0.0)
    width, height = view.size
    radii = poses.distance * size * max(1.0, height / width)
    lists = (poses.azimuth, poses.elevation, radii, targets, poses.fov)
    return [
        Camera.orbit(azimuth, elevation, radius, view.size, (x, y, z), fov)
        for azimuth, elevation, radius, (x, y, z), fov in zip(
            *(values.tolist() for values in lists), strict=True
        )
    ]


def _poses(clip: Clip, view: View, side: str) -> Poses:
    """Where the camera stands around the object in each frame."""
    count, camera = len(clip), view.camera(side)
    azimuth = 0.0 if camera or side == "orbit" else _azimuth(side)
    still = Poses.still(count, azimuth, view.elevation, view.distance, view.fov)
    if camera is not None:
        times = clip.times - clip.times[0]
        return camera.poses(times, _length(clip), still)
    return still.changed(azimuth=np.arange(count) * 360 / count) if side == "orbit" else still


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
    points, view = _sample(clip), fitted(clip, view)
    own = {camera.name for camera in view.cameras if camera.chosen}
    sides = [side for side in view.sides if side not in own]
    found = [_departure(points, cameras(clip, view, side), view, side) for side in sides]
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


def _departure(
    points: NDArray[np.float64], cameras: list[Camera], view: View, side: str
) -> Departure | None:
    """What a side misses of the points [T,S,3], or None."""
    needed = np.stack([_radius(seen, at) for seen, at in zip(points, cameras, strict=True)])
    camera = cameras[0]
    radius = math.dist(camera.eye, camera.target)
    outside = (needed > radius * (1 + 1e-9)).mean(axis=1)
    if not (outside > OUTSIDE).any():
        return None
    worst = int(outside.argmax())
    enough = float(np.quantile(needed, 1 - OUTSIDE, axis=1, method="higher").max())
    distance = math.ceil(enough / radius * view.distance / STEP) * STEP
    first = int((outside > OUTSIDE).argmax())
    return Departure(side, first, worst, float(outside[worst]), round(distance, 3))


def _radius(points: NDArray[np.float64], camera: Camera) -> NDArray[np.float64]:
    """Distance from its target at which the camera would see each of the points [S]."""
    across, down, ahead = ((points - camera.target) @ camera.view[:3, :3].T).T
    half_width, half_height = (0.5 * s / camera.focal for s in (camera.width, camera.height))
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


def _path(clip: Clip) -> NDArray[np.float64]:
    """Displacement of the middle of what moves, relative to the first frame [T,3], m."""
    points = _sample(clip)
    finite = np.isfinite(points).all(axis=2, keepdims=True)
    middle = np.where(finite, points, 0).sum(axis=1) / np.maximum(finite.sum(axis=1), 1)
    return middle - middle[0]


def _sample(clip: Clip) -> NDArray[np.float64]:
    """Visible Gaussians that move, or all visible ones if none does [T,S,3], m."""
    own = clip.own
    visible = np.flatnonzero(own & (clip.opacities >= VISIBLE))
    chosen = visible if len(visible) else np.flatnonzero(own)
    points = clip.means[:, chosen[:: 1 + len(chosen) // SAMPLE]].astype(np.float64)
    moves = (points != points[0]).any(axis=(0, 2))
    return points[:, moves] if moves.any() else points
