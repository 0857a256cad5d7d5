"""Finds scenes that differ only in the targets of their grabs.

In a live run, the hand that holds an object has a new target in every frame. Binding all forces and
boundaries again would take half as long as the frame.
"""

from phy124.forces import Grab, Gravity
from phy124.mpm.tracks import Track
from phy124.scene import Scene


def find_moved(before: Scene, after: Scene) -> list[tuple[Track, Track]] | None:
    """Return the previous and the new target of each grab whose target differs.

    The result is None if the scenes differ in anything else.
    """
    if after.model_copy(update={"forces": before.forces}) != before:
        return None
    if len(after.forces) != len(before.forces):
        return None
    moved = []
    for old, new in zip(before.forces, after.forces, strict=True):
        # Pushes, of which there may be many, are the same objects in both scenes.
        if old is new or (isinstance(old, Gravity) and old == new):
            continue
        if not (isinstance(old, Grab) and isinstance(new, Grab) and _same_hold(old, new)):
            return None
        moved.append((old.target(), new.target()))
    return moved


def _same_hold(old: Grab, new: Grab) -> bool:
    return old.model_copy(update={"times": new.times, "targets": new.targets}) == new
