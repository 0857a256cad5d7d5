"""Turns a 3DGS capture of a real place into an object that stands on the floor of this place.

The floor is detected and never moves. Contact is computed between the object and the scene's
ground, which is at the height of the detected floor. The object's longest side becomes
`object.size`.
"""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians, join, quaternions, rotation_matrices
from phy124.generators.ply_file import Opened, PlyFile, robust_bounds, unit_transform
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.axes import rotate_gaussians, upright
from phy124.io.content import for_run
from phy124.particles import clean
from phy124.particles.thinning import note_volume, thin
from phy124.pipeline.capture.floor import Floor, find_floor
from phy124.pipeline.capture.place import find_crop, note_stretched
from phy124.progress import Progress, silent
from phy124.scene import Part, Scene
from phy124.schema.region import EVERYWHERE, PartRegion
from phy124.simulation.placing import find_placement

VISIBLE = 0.1
"""Smallest opacity of the Gaussians from which the floor is detected."""
NEIGHBOURS = 8
USUAL = 6.0
"""Smallest distance of a floater from its eighth-nearest neighbour, relative to the median."""
LONG = 3.0
"""Smallest distance of a floater from its eighth-nearest neighbour, relative to the floater's
largest standard deviation.
"""


@dataclass(frozen=True)
class Capture:
    """The Gaussians of a capture, ready to be simulated, and their scene."""

    gaussians: Gaussians
    """Gaussians of the object, followed by the Gaussians of the floor."""
    scene: Scene
    """The scene, with the floor as a static part, and with regions in metres."""
    cleaning: list[str]
    about: dict[str, Any]
    """Entries of the report about the rotation and the floor."""
    notes: tuple[str, ...] = ()
    """Sentences about parts of the file that were ignored or interpreted."""
    crop: Crop = WHOLE
    """Position of the object in the picture on which masks of parts were painted."""


def capture(
    file: PlyFile, scene: Scene, *, count: int | None = None, progress: Progress = silent
) -> Capture:
    """Read Gaussians from a file, and place the object on its floor if there is one.

    Args:
        file: The file, and how to interpret it.
        scene: The scene to prepare.
        count: Largest number of Gaussians; None: all are kept.
        progress: Called as in `phy124.progress`.

    Raises:
        InputError: The file cannot be read, or no floor is found.
    """
    with nullcontext() if count is None else for_run(count):
        opened = file.open(progress)
    reduce, notes = partial(thin, seed=scene.seed), []
    if file.reading.floor:
        has_up = file.reading.up is not None or file.reading.rotate is not None
        read = _on_floor(opened, count, reduce, has_up=has_up)
    else:
        kept = reduce(opened.gaussians, count)
        notes = note_volume(opened.gaussians, kept)
        read = _alone(opened._replace(gaussians=kept), file.path)
    scene = _with_floor(scene, read)
    shift = read.offset - read.scale * read.rotation @ opened.origin
    transform = {"rotation": read.rotation.tolist(), "scale": read.scale, "shift": shift.tolist()}
    about = {"capture": {**transform, "floor": read.floor, "coarse": opened.coarse}}
    metres = _in_metres(scene, read, opened.origin)
    crop = find_crop(file)
    notes = (*opened.notes, *notes, *([] if crop else note_stretched(file, scene)))
    return Capture(read.gaussians, metres, read.cleaning, about, notes, crop or WHOLE)


def adapt_scene(file: PlyFile, scene: Scene, *, count: int | None = None) -> Scene:
    """Return the scene that `capture` would return; the file is read only if necessary.

    Raises:
        InputError: The file cannot be read, or no floor is found.
    """
    if file.reading.floor or in_file_units(scene):
        return capture(file, scene, count=count).scene
    return scene


def in_file_units(scene: Scene) -> bool:
    """Return whether any region is stated in the units of the object's file."""
    return any(part.region and part.region.units == "file" for part in scene.parts)


@dataclass(frozen=True)
class _Read:
    """Upright Gaussians of a file, in the default position and size.

    A position y in the file was mapped to `x = scale * rotation @ (y - origin) + offset`.
    """

    gaussians: Gaussians
    count: int
    """Number of Gaussians of the object; those of the floor come after them."""
    rotation: NDArray[np.float64]
    scale: float
    offset: NDArray[np.float64]
    cleaning: list[str]
    floor: dict[str, Any] | None
    """The detected floor, for the report."""


def _alone(opened: Opened, name: str) -> _Read:
    scale, offset = unit_transform(opened.gaussians, name)
    placed = opened.gaussians.transform(scale, offset)
    return _Read(placed, len(placed), opened.rotation, scale, offset, opened.cleaning, None)


def _on_floor(
    opened: Opened, most: int | None, reduce: Callable[..., Gaussians], *, has_up: bool
) -> _Read:
    """Return the upright object without floaters, on its floor at z = 0.

    `reduce` reduces the number of Gaussians of a set. Object and floor together keep at most `most`
    Gaussians (None: all). Both are reduced separately, so that the floor does not affect the size
    of the object.
    """
    every = opened.gaussians
    visible = every.means[every.opacities >= VISIBLE]
    floor = find_floor(visible, np.array([0.0, 0.0, 1.0]) if has_up else None)
    lies = floor.heights(every.means) <= floor.tolerance
    turn = upright(floor.normal)
    standing = rotate_gaussians(every, turn)
    above, below = standing.select(~lies), standing.select(lies)
    alone = find_floaters(above)
    body, cleaned = clean(above.select(~alone))
    if most is not None:
        body = reduce(body, max(1, round(most * len(body) / (len(body) + len(below)))))
        below = reduce(below, most - len(body))
    low, high = robust_bounds(body)
    scale = 1 / float((high - low).max())
    offset = -scale * (low + high) / 2
    offset[2] = -scale * floor.offset
    both = join([body, below]).transform(scale, offset)
    sentences = [*opened.cleaning, *cleaned.sentences]
    if alone.any():
        count = f"{alone.sum()} of {len(above)} Gaussians above the floor"
        sentences.append(f"{count} floated far from all others and were dropped.")
    about = _describe_floor(floor, opened, lies) | {"gaussians": len(below)}
    return _Read(both, len(body), turn @ opened.rotation, scale, offset, sentences, about)


def find_floaters(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Return a mask [N] of small Gaussians that are far from other Gaussians."""
    few = min(NEIGHBOURS, len(gaussians) - 1)
    means = gaussians.means.astype(np.float64)
    near = scipy.spatial.KDTree(means).query(means, few + 1)[0].reshape(len(means), -1)[:, -1]
    return near > np.maximum(USUAL * np.median(near), LONG * gaussians.scales.max(axis=1))


def _describe_floor(floor: Floor, opened: Opened, lies: NDArray[np.bool_]) -> dict[str, Any]:
    return {
        "normal": (opened.rotation.T @ floor.normal).tolist(),
        "offset": floor.offset + float(floor.normal @ opened.rotation @ opened.origin),
        "tolerance": floor.tolerance,
        "fraction": float(lies.mean()),
        "tilt": float(np.degrees(np.arccos(np.clip(floor.normal[2], -1, 1)))),
    }


def _with_floor(scene: Scene, read: _Read) -> Scene:
    if read.count == len(read.gaussians):
        return scene
    floor = Part(static=True, surroundings=True, gaussians=(read.count, len(read.gaussians)))
    return scene.model_copy(update={"parts": (*scene.parts, floor)})


def _in_metres(scene: Scene, read: _Read, origin: tuple[float, float, float]) -> Scene:
    """Return the scene after converting regions in the file's units to rotated boxes in metres.

    `origin` is the position in the file that was moved to the origin.
    """
    if not in_file_units(scene):
        return scene
    kept, cleaned = clean(read.gaussians)
    assert cleaned.survivors is not None
    belonging = np.flatnonzero(cleaned.survivors) < read.count
    scale, offset = find_placement(kept, scene, belonging)
    offset = offset + scale * read.offset + [*scene.object.place, scene.object.lift]
    scale *= read.scale
    parts = []
    for number, part in enumerate(scene.parts):
        if part.region is not None and part.region.units == "file":
            near = _shift(part.region, origin)
            region = _region_in_metres(near, scale, read.rotation, offset, number)
            part = part.model_copy(update={"region": region})
        parts.append(part)
    return scene.model_copy(update={"parts": tuple(parts)})


def _shift(region: PartRegion, origin: tuple[float, float, float]) -> PartRegion:
    if not any(origin):
        return region
    # The corners are stated in the rotated axes of the region.
    shift = rotation_matrices(np.array([region.turn]))[0].T @ origin
    ends = {name: tuple(getattr(region, name) - shift) for name in ("lower", "upper")}
    return region.model_copy(update=ends)


def _region_in_metres(
    region: PartRegion,
    scale: float,
    rotation: NDArray[np.float64],
    offset: NDArray[np.float64],
    number: int,
) -> PartRegion:
    # The rotation `turn` of the region is applied first: rotation @ (scale * turn @ box) + offset.
    both = rotation @ rotation_matrices(np.array([region.turn]))[0]
    corners = scale * np.array([region.lower, region.upper]) + both.T @ offset
    corners = np.clip(corners, -EVERYWHERE, EVERYWHERE)
    if (corners[0] >= corners[1]).any():
        value, limit = (
            region.model_dump(exclude_defaults=True),
            "the object is not that far away.",
        )
        remedy = "Give corners near the positions of the file's Gaussians."
        raise InputError(f"parts.{number}.region", value, limit, remedy)
    lower, upper = corners.tolist()
    turn = quaternions(both[None])[0].tolist()
    return PartRegion(lower=lower, upper=upper, cylinder=region.cylinder, turn=turn)
