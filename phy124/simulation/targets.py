"""Finds scenes that differ only in the targets of their grabs and in the motions of their walls.

In a live run, the hand that holds an object or moves a wall has a new target in every frame.
Binding all forces and boundaries again would take half as long as the frame.
"""

from typing import Any

from phy124.boundaries import Boundary
from phy124.boundaries.motion import Path
from phy124.forces import Grab, Gravity
from phy124.mpm.tracks import Track
from phy124.scene import Scene
from phy124.simulation.bodies import planes_for_free


def find_moved(before: Scene, after: Scene) -> list[tuple[Track, Track]] | None:
    """Return the previous and the new track of each grab and simple wall whose track differs.

    The result is None if the scenes differ in anything else.
    """
    alike = {"forces": before.forces, "boundaries": before.boundaries}
    if after.model_copy(update=alike) != before:
        return None
    counts = [(len(scene.forces), len(scene.boundaries)) for scene in (before, after)]
    if counts[0] != counts[1]:
        return None
    moved = []
    for old, new in zip(before.forces, after.forces, strict=True):
        # Pushes, of which there may be many, are the same objects in both scenes.
        if old is new or (isinstance(old, Gravity) and old == new):
            continue
        if not (isinstance(old, Grab) and isinstance(new, Grab) and _same_hold(old, new)):
            return None
        moved.append((old.target(), new.target()))
    for old, new in zip(before.boundaries, after.boundaries, strict=True):
        if old != new and not _same_wall(old, new):
            return None
    walls = (_simple_walls(scene) for scene in (before, after))
    motions = ((old.motion, new.motion) for old, new in zip(*walls, strict=True))
    return moved + [(old.track(), new.track()) for old, new in motions if old != new]


def _simple_walls(scene: Scene) -> list[Any]:
    """Return all simple walls that follow a path, then again the flat walls that stop solids."""
    parts = [part for wall in scene.boundaries for part in wall.parts()]
    walls = [*parts, *planes_for_free(scene)]
    return [wall for wall in walls if isinstance(getattr(wall, "motion", None), Path)]


def _same_hold(old: Grab, new: Grab) -> bool:
    return old.model_copy(update={"times": new.times, "targets": new.targets}) == new


def _same_wall(old: Boundary, new: Boundary) -> bool:
    motions = [getattr(wall, "motion", None) for wall in (old, new)]
    follow = all(isinstance(motion, Path) for motion in motions)
    return follow and old.model_copy(update={"motion": motions[1]}) == new
