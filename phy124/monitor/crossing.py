"""Crossing: reports if a body on a lattice is deep inside a wall."""

from collections.abc import Sequence
from typing import Any

from phy124.boundaries import Boundary
from phy124.monitor.observer import Observer, Subject, Violation
from phy124.monitor.wrenches import simple_wall_names
from phy124.mpm import Attachable

DEEP = 0.5
"""A note names points that are deeper inside a wall than this [cells]."""


class LatticeCrossing(Observer):
    """Measures the depths of points inside walls."""

    kept = ("_deepest", "_between")

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether any boundary of the scene stops material instead of holding it."""
        return not all(wall.holds for wall in subject.scene.boundaries)

    def __init__(self) -> None:
        self._deepest, self._between = 0.0, ("", "")

    def wrap_walls(self, walls: Sequence[Boundary], inner: Sequence[Attachable]) -> Any:
        """Return the walls unchanged; store the name of each simple wall."""
        parts = [(wall.holds, part.contact) for wall in walls for part in wall.parts()]
        named = zip(simple_wall_names(walls), parts, strict=True)
        self._contacts = {name: contact for name, (holds, contact) in named if not holds}
        self._names = list(self._contacts)
        return inner

    def after_attempt(self) -> Violation | None:
        """Measure the depths of points inside walls; a large depth is not treated as an error."""
        depth, inside = self._solver.walls.depth()
        if depth > max(DEEP, self._deepest):
            pinched, first, second = self._solver.pinch()
            if pinched > DEEP:
                self._deepest, self._between = pinched, (self._names[first], self._names[second])
            else:
                self._deepest, self._between = depth, (self._names[inside], "")
        return None

    def notes(self) -> list[str]:
        """Return a note about the deepest point."""
        if not self._deepest:
            return []
        inside, touching = self._between
        if not touching:
            return [
                f"Material was up to {self._deepest:.1f} cells inside the boundary {inside}. Start "
                "the boundary outside the object, move it slowly, and keep it away from clamps."
            ]
        remedy = "Move them so that they keep more distance"
        if {self._contacts.get(name) for name in self._between} != {"separate"}:
            remedy += ', or use contact = "separate", so that the material can escape'
        return [
            f"The boundaries {inside} and {touching} left too little space: material between them "
            f"is up to {self._deepest:.1f} cells inside {inside}. {remedy}."
        ]
