"""Regions in which the material is held: no walls, so every node inside answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from pydantic import Field

from phy124.boundaries.base import Contact, Corners, Movable, box_of, half_bounds
from phy124.bounds import Position
from phy124.region import Vector

if TYPE_CHECKING:
    from phy124.mpm import Solver


class Held(Movable):
    """A box of space in which the material is held in place, such as the foot of a stem."""

    shape: ClassVar[str] = "box"
    kind: Literal["held"] = "held"
    lower: Position = Field(default=(-10.0, -10.0, -10.0), description="Lowest corner [m].")
    upper: Position = Field(default=(10.0, 10.0, 0.1), description="Highest corner [m].")
    contact: Contact = Field(default="sticky", description="sticky holds all directions.")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Centre and half sizes."""
        return box_of(self.lower, self.upper)

    def extent(self, solver: Solver) -> Corners:
        """The box."""
        return np.array(self.lower), np.array(self.upper)

    def reach(self, dx: float) -> float | None:
        """The box is a region, not a wall: all its nodes are held."""
        return 0.0


class Foot(Movable):
    """The lowest part of the object is held in place, as a plant is by its pot."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["foot"] = "foot"
    share: float = Field(default=0.15, ge=1e-6, le=1, description="Held share of its height.")
    contact: Contact = Field(default="sticky", description="sticky holds all directions.")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Point and normal of the plane below which material is held."""
        z = solver.rest[:, 2]
        top = float(z.min() + self.share * np.ptp(z))
        return (0.0, 0.0, top), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)

    def extent(self, solver: Solver) -> Corners:
        """Everything below."""
        point, normal, _ = self.geometry(solver)
        return half_bounds(point, normal)

    def reach(self, dx: float) -> float | None:
        """A region, not a wall: all its nodes are held."""
        return 0.0
