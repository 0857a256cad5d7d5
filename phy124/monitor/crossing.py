"""Crossing: notes that two walls leave too little space for a body on a lattice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phy124.boundaries import Boundary
from phy124.monitor.observer import Observer, Subject, Violation
from phy124.monitor.wrenches import wall_names
from phy124.mpm import Attachable

DEEP = 0.5
"""Depth inside a wall above which there is a note [cells]."""


class LatticeCrossing(Observer):
    """Finds points that two walls touch, and measures once per frame how deep they are in a
    wall.
    """

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether there are walls that may move towards each other."""
        walls = [wall for wall in subject.scene.boundaries if not wall.holds]
        return len(walls) > 1 and any(part.tracked for wall in walls for part in wall.parts())

    def __init__(self) -> None:
        """Assume that no point is inside a wall."""
        self._deepest, self._between = 0.0, ("", "")

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable] | None = None
    ) -> Any:
        """Return the walls unchanged, and store the name of each simple wall."""
        named = zip(wall_names(walls), walls, strict=True)
        self._names = [name for name, wall in named if not wall.holds for _ in wall.parts()]
        return walls if inner is None else inner

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Bind to the solver; its walls measure the depth."""
        self._solver = solver

    def after_attempt(self) -> Violation | None:
        """Measure the depth; a large depth is not a violation."""
        depth, inside, touching = self._solver.walls.pinch()
        if depth > max(DEEP, self._deepest):
            self._deepest, self._between = depth, (self._names[inside], self._names[touching])
        return None

    def notes(self) -> list[str]:
        """Return the note about the deepest point."""
        if not self._deepest:
            return []
        inside, touching = self._between
        return [
            f"The boundaries {inside} and {touching} left too little space: material between them "
            f"is up to {self._deepest:.1f} cells inside {inside}. Move them so that they keep more "
            'distance, or use contact = "separate", so that the material can escape.'
        ]

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot: the largest depth, and the names of the walls."""
        return {"deepest": self._deepest, "between": list(self._between)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        self._deepest, self._between = snapshot["deepest"], tuple(snapshot["between"])
