"""Places the cameras of a clip, and checks whether they show the whole motion."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Container
from phy124.camera import FOV_Y, VIEWS, Camera
from phy124.errors import InputError
from phy124.io.clip import Clip
from phy124.rendering.nearest import OUTSIDE, Sample, Values, place_along, place_nearest
from phy124.rendering.stage.build import boundaries_of
from phy124.rendering.stage.rest import AtRest
from phy124.rendering.stage.solids import span_container
from phy124.scene import View
from phy124.scene.cameras import Poses

STEP = 0.1
"""Recommended camera distances are multiples of this value, in units of the object's size."""
LARGEST = 5.0
"""Largest extent of a motion that a fixed camera shows [object sizes]; otherwise, the camera
follows the object.
"""
WINDOW = 0.3
"""A moving camera shows all positions of the object within this time around each frame [s]."""
NEARER = 1.1
"""With several objects, the camera moves in and out if the objects then look larger by at least
this factor in most frames.
"""
MORE = 1.5
"""Largest factor by which the camera's distance may grow to show a whole container."""
FARTHEST = 100.0
"""Largest allowed camera distance of a view, in units of the object's size."""


def cameras(clip: Clip, view: View, side: str) -> list[Camera]:
    """Return each frame's camera from one side: fixed, circling, moving, or following the object.

    If the distance is not set (`View.fits`), the camera is as near as possible while it shows the
    whole motion. If the motion would then look too small, the camera follows the object. If there
    are several objects, the camera moves in and out instead.
    """
    known = _placed.setdefault(clip, {})
    if (view, side) not in known:
        known[view, side] = _place(clip, view, side)
    return known[view, side]


_placed: WeakKeyDictionary[Clip, dict[tuple[View, str], list[Camera]]] = WeakKeyDictionary()
"""Cameras of each clip by view and side; a run's videos and its report need the same cameras."""


def _place(clip: Clip, view: View, side: str) -> list[Camera]:
    camera, poses = view.camera(side), _poses(clip, view, side)
    if view.fits and not (camera is not None and camera.chosen):
        return _nearest(clip, view, poses)
    low, high = _box(clip, view)
    size = float((high - low).max())
    path = Sample.of(clip).path if view.follow else 0.0
    targets = (low + high) / 2 + size * poses.target + path
    width, height = view.size
    # For a portrait picture, the camera is farther away, so that it shows as much width as a
    # square.
    portrait = max(1.0, height / width)
    return _make_cameras(view, poses, poses.distance * size * portrait, targets)


def still_camera(clip: Clip, view: View, side: str) -> Camera:
    """Return the camera of a player; this camera does not move."""
    return cameras(clip, view.model_copy(update={"follow": False}), side)[0]


def _nearest(clip: Clip, view: View, poses: Poses) -> list[Camera]:
    """Return the nearest cameras that show the motion, up to `LARGEST` object sizes."""
    low, high = _box(clip, view)
    size = float((high - low).max())
    sample, count = Sample.of(clip), len(clip)
    follow = sample.has_rare_moment(LARGEST * size) if view.follow is None else view.follow
    seen, path = (sample.follow(), sample.path) if follow else (sample, 0.0)
    around = _make_cameras(view, poses, np.ones(count), np.tile(seen.middle, (count, 1)))
    stand = place_nearest(seen, around, zooms=view.fov == FOV_Y)
    containers = [] if follow else list(_containers(clip, view))
    if containers:
        with_them = seen.with_fixed(np.concatenate(containers))
        whole = place_nearest(with_them, around, zooms=view.fov == FOV_Y)
        if whole.distance * stand.zoom <= MORE * stand.distance * whole.zoom:
            seen, stand = with_them, whole
    farthest = stand.zoom * LARGEST * size / (2 * min(around[0].halves))
    middle = seen.middle + stand.shift if stand.distance <= farthest else (low + high) / 2
    radii = np.full(count, min(stand.distance, farthest))
    targets = np.broadcast_to(middle + path, (count, 3))
    if view.follow is None and len(clip.objects) > 1 and not follow:
        window = math.ceil(WINDOW * count / _length(clip))
        nearer, shifts = place_along(seen, around, stand, window)
        if np.median(nearer) * NEARER < radii[0]:
            radii, targets = nearer, seen.middle + shifts
    if stand.zoom != 1:
        half = np.tan(np.radians(poses.fov) / 2) / stand.zoom
        poses = poses.replace(fov=np.degrees(2 * np.arctan(half)))
    return _make_cameras(view, poses, radii, targets)


def _containers(clip: Clip, view: View) -> Iterator[NDArray]:
    if view.stage != "studio" or Sample.of(clip).corners is None:
        return
    for boundary in boundaries_of(clip):
        if isinstance(boundary, Container) and boundary.motion is None:
            box = np.array(span_container(boundary, AtRest.of(clip)))
            yield np.array([[box[i, 0], box[j, 1], box[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])


def _make_cameras(view: View, poses: Poses, radii: Values, targets: Values) -> list[Camera]:
    """Create cameras that look at targets [T,3] m from distances [T] m."""
    lists = (poses.azimuth, poses.elevation, radii, targets, poses.fov)
    return [
        Camera.orbit(azimuth, elevation, radius, view.size, (x, y, z), fov)
        for azimuth, elevation, radius, (x, y, z), fov in zip(
            *(values.tolist() for values in lists), strict=True
        )
    ]


def _poses(clip: Clip, view: View, side: str) -> Poses:
    count, camera, azimuth = len(clip), view.camera(side), 0.0
    if not camera and side != "orbit":
        azimuth = VIEWS[side] if side in VIEWS else float(side.removeprefix("azimuth-"))
    still = Poses.still(count, azimuth, view.elevation, view.distance, view.fov)
    if camera is not None:
        times = clip.times - clip.times[0]
        return camera.poses(times, _length(clip), still)
    return still.replace(azimuth=np.arange(count) * 360 / count) if side == "orbit" else still


def _length(clip: Clip) -> float:
    """Return the duration of a clip [s], including the interval after its last frame."""
    count = len(clip)
    return float(clip.times[-1] - clip.times[0]) * count / (count - 1) if count > 1 else 1.0


@dataclass(frozen=True)
class Departure:
    """A view in which the object leaves the picture, and the frames in which this happens."""

    view: str
    frame: int
    """Index of the first frame in which part of the object is outside the picture."""
    worst_frame: int
    """Index of the frame in which the largest part of the object is outside the picture."""
    outside: float
    """Fraction of the object that is outside the picture in frame `worst_frame`."""
    distance: float
    """Camera distance at which the whole object would be visible, in units of the object's size."""


def departures(clip: Clip, view: View) -> list[Departure]:
    """Return the sides from which part of the object leaves the picture.

    A camera is not checked if the user set its distance, field of view or target.
    """
    chosen = {camera.name for camera in view.cameras if camera.chosen}
    sides = (side for side in view.sides if side not in chosen)
    checked = (_find_departure(clip, view, side) for side in sides)
    return [departure for departure in checked if departure is not None]


def describe_framing(clip: Clip, view: View) -> dict[str, Any]:
    """Return `departures`, the views that the object leaves, and `notes` for the user."""
    left = departures(clip, view)
    notes = [note for note in (_note_departures(clip, view, left), _note_cut(clip, view)) if note]
    return {"departures": [asdict(departure) for departure in left], "notes": notes}


def _note_cut(clip: Clip, view: View) -> str | None:
    last = float(clip.times[-1] - clip.times[0])
    late = [camera for camera in view.cameras if camera.end > last * (1 + 1e-9)]
    if not late:
        return None
    names, end = ", ".join(camera.name for camera in late), max(camera.end for camera in late)
    return (
        f"The clip ends at {last:.3g} s, before the path of camera {names}; "
        f"simulate with --seconds {end + _length(clip) / len(clip):.3g} to see the whole path."
    )


def _note_departures(clip: Clip, view: View, left: list[Departure]) -> str | None:
    if not left:
        return None
    sides = ", ".join(
        f"{d.view} from frame {d.frame} on ({d.outside:.0%} outside in frame {d.worst_frame})"
        for d in left
    )
    remedies = []
    distance = max(departure.distance for departure in left)
    if distance <= FARTHEST:
        remedies.append(f"view.distance = {distance:g}")
    following = view.model_copy(update={"follow": True})
    if not view.follow and not departures(clip, following):
        remedies.append("view.follow = true")
    remedy = " or ".join(remedies) or "a wider view.fov"
    return f"The object leaves the picture: {sides}. Film it again with {remedy}."


def _find_departure(clip: Clip, view: View, side: str) -> Departure | None:
    sample, seen = Sample.of(clip), cameras(clip, view, side)
    points = sample.means[:, sample.moving]
    needed = _radii(points, seen)
    radii = np.array([math.dist(camera.eye, camera.target) for camera in seen])
    outside = (needed > radii[:, None] * (1 + 1e-9)).mean(axis=1)
    if not (outside > OUTSIDE).any():
        return None
    still = view.model_copy(update={"fit": False, "follow": bool(view.follow)})
    usual = cameras(clip, still, side)
    enough = np.quantile(_radii(points, usual), 1 - OUTSIDE, axis=1, method="higher").max()
    ratio = float(enough) / math.dist(usual[0].eye, usual[0].target)
    distance = math.ceil(ratio * view.distance / STEP) * STEP
    first, worst = int((outside > OUTSIDE).argmax()), int(outside.argmax())
    return Departure(side, first, worst, float(outside[worst]), round(distance, 3))


def _radii(points: NDArray[np.floating], cameras: list[Camera]) -> Values:
    """Return the smallest camera distances [T,S], m, at which S points are visible in T frames."""

    def radius(points: NDArray[np.floating], camera: Camera) -> Values:
        across, down, ahead = ((points - camera.target) @ camera.view[:3, :3].T).T
        half_width, half_height = camera.halves
        return np.maximum(np.abs(across) / half_width, np.abs(down) / half_height) - ahead

    return np.stack([radius(seen, at) for seen, at in zip(points, cameras, strict=True)])


def _box(clip: Clip, view: View) -> tuple[NDArray, NDArray]:
    """Return the box around the object at rest, extended to the ground if the object can fall."""
    corners = Sample.of(clip).corners
    if corners is None:
        limit = "all Gaussians of its first frame have NaN or infinite values."
        raise InputError("clip", f"{len(clip)} frames", limit, "Simulate it once more.")
    low, high = corners
    floors = [b["height"] for b in clip.scene.get("boundaries", []) if b["kind"] == "ground"]
    if floors and not view.follow:
        low = np.minimum(low, [np.inf, np.inf, max(floors)])
    return low, high
