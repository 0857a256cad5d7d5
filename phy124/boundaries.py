"""Boundaries a scene can name: shapes that answer to grid velocities.

A boundary is its own section of the scene file. It becomes one stage of the substep, launched
over the nodes its shape can reach and nothing else.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
import warp as wp
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from phy124.kernels.grid import make_collider
from phy124.kernels.transfer import types
from phy124.region import Vector
from phy124.tracks import Track

if TYPE_CHECKING:
    from phy124.mpm import Solver, Stage

Contact = Literal["sticky", "slip", "separate"]
REACH = -0.25
"""A node answers to a wall below this signed distance, in cells.

Material rests 0.6 to 0.9 cells above the last free-moving node plane, so the plane that stops it
must lie about 0.75 cells inside the wall for the body to touch the wall itself.
"""
Corners = tuple[NDArray[np.float64], NDArray[np.float64]]


class Boundary(BaseModel):
    """What all boundaries have: how they answer to what touches them."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shape: ClassVar[str]

    contact: Contact = Field(
        default="separate", description="sticky, slip, or separate (may leave, with friction)."
    )
    friction: float = Field(default=0.4, ge=0, le=10, description="Coulomb friction coefficient.")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Three vectors that the shape's distance function reads."""
        raise NotImplementedError

    def bounds(self, solver: Solver) -> Corners:
        """Corners of a box that holds every node inside the shape at rest [m]."""
        return np.full(3, -np.inf), np.full(3, np.inf)

    def track(self, solver: Solver) -> Track | None:
        """Displacement over time [m]; None if it never moves."""
        return None

    def attach(self, solver: Solver) -> list[Stage]:
        """One collider stage."""
        t, track = types(solver.real), self.track(solver)
        slot = 0 if track is None else solver.tracks.add(track)
        moving = track is not None
        kernel = make_collider(self.shape, self.contact, moving, solver.real)
        bounds = self.bounds(solver)
        if track is not None:
            bounds = _swept(bounds, track)

        def record() -> wp.Launch | None:
            start, extent = solver.grid.nodes_within(*bounds)
            inputs = [
                t.mat33(*np.ravel(self.geometry(solver))), self.friction, self.reach(solver.dx), slot,
                wp.vec3i(*start.tolist()), solver.grid.lattice, solver.grid.window,
                solver.tracks.values, solver.tracks.rates,
            ]  # fmt: skip
            return solver.record(kernel, tuple(extent), inputs, [solver.grid.nodes])

        return [(type(self).__name__.lower(), record)]

    def reach(self, dx: float) -> float:
        """Signed distance below which a node answers [m]."""
        return REACH * dx


class HalfSpace(Boundary):
    """Everything behind a plane is solid."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["half_space"] = "half_space"
    point: Vector = Field(default=(0.0, 0.0, 0.0), description="A point on the plane [m].")
    normal: Vector = Field(default=(0.0, 0.0, 1.0), description="Direction out of the solid.")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Point and unit normal."""
        length = math.hypot(*self.normal)
        x, y, z = (component / length for component in self.normal)
        return self.point, (x, y, z), (0.0, 0.0, 0.0)

    def bounds(self, solver: Solver) -> Corners:
        """Half of space if the normal lies along an axis, else all of it."""
        return _half_bounds(self.point, self.normal)


class Ground(Boundary):
    """A floor at a height, on which objects stand by default."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["ground"] = "ground"
    height: float = Field(default=0.0, description="Height of the floor [m].")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Point and unit normal."""
        return (0.0, 0.0, self.height), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)

    def bounds(self, solver: Solver) -> Corners:
        """Everything below."""
        return _half_bounds((0.0, 0.0, self.height), (0.0, 0.0, 1.0))


class Press(Boundary):
    """A plate that comes down on the object, rests and goes back."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["press"] = "press"
    top: float | None = Field(
        default=None, description="Height of the plate at the start [m]; absent: on the object."
    )
    depth: float = Field(
        default=0.35, gt=0, le=0.9, description="How far it comes down, in object heights."
    )
    start: float = Field(default=0.0, ge=0, description="Begins to move [s].")
    down: float = Field(default=0.25, gt=0, description="Time to come down [s].")
    hold: float = Field(default=0.05, ge=0, description="Time at the bottom [s].")
    up: float = Field(default=0.2, gt=0, description="Time to go back [s].")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Point and unit normal, before displacement."""
        height = solver.rest[:, 2].max() if self.top is None else self.top
        return (0.0, 0.0, float(height)), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)

    def bounds(self, solver: Solver) -> Corners:
        """Everything above the plate."""
        point, normal, _ = self.geometry(solver)
        return _half_bounds(point, normal)

    def track(self, solver: Solver) -> Track:
        """Down with smooth ends, hold, and up again."""
        depth = self.depth * float(np.ptp(solver.rest[:, 2]))
        parts = np.linspace(0, 1, 17)
        ease = (1 - np.cos(np.pi * parts)) / 2
        begin, back = self.start, self.start + self.down + self.hold
        times = np.concatenate([[0.0], begin + self.down * parts, back + self.up * parts])
        heights = -depth * np.concatenate([[0.0], ease, 1 - ease])
        return Track(
            tuple(
                (t, (0.0, 0.0, h), True)
                for t, h in zip(times.tolist(), heights.tolist(), strict=True)
            )
        )


class Held(Boundary):
    """A box of space in which the material is held in place, such as the foot of a stem."""

    shape: ClassVar[str] = "box"
    kind: Literal["held"] = "held"
    lower: Vector = Field(default=(-10.0, -10.0, -10.0), description="Lowest corner [m].")
    upper: Vector = Field(default=(10.0, 10.0, 0.1), description="Highest corner [m].")
    contact: Contact = Field(default="sticky", description="sticky holds all directions.")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Centre and half sizes."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        centre, half = (lower + upper) / 2, (upper - lower) / 2
        return tuple(centre.tolist()), tuple(half.tolist()), (0.0, 0.0, 0.0)

    def bounds(self, solver: Solver) -> Corners:
        """The box."""
        return np.array(self.lower), np.array(self.upper)

    def reach(self, dx: float) -> float:
        """The box is a region, not a wall: all its nodes are held."""
        return 0.0


class Foot(Boundary):
    """The lowest part of the object is held in place, as a plant is by its pot."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["foot"] = "foot"
    share: float = Field(default=0.15, gt=0, le=1, description="Held share of its height.")
    contact: Contact = Field(default="sticky", description="sticky holds all directions.")

    def geometry(self, solver: Solver) -> tuple[Vector, Vector, Vector]:
        """Point and normal of the plane below which material is held."""
        z = solver.rest[:, 2]
        return (0.0, 0.0, float(z.min() + self.share * np.ptp(z))), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)

    def bounds(self, solver: Solver) -> Corners:
        """Everything below."""
        point, normal, _ = self.geometry(solver)
        return _half_bounds(point, normal)

    def reach(self, dx: float) -> float:
        """A region, not a wall: all its nodes are held."""
        return 0.0


AnyBoundary = Annotated[Ground | HalfSpace | Press | Held | Foot, Field(discriminator="kind")]


def _half_bounds(point: Vector, normal: Vector) -> Corners:
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    across = np.flatnonzero(np.abs(normal) > 1e-9)
    if len(across) == 1:
        axis = across[0]
        (upper if normal[axis] > 0 else lower)[axis] = point[axis]
    return lower, upper


def _swept(corners: Corners, track: Track) -> Corners:
    """A box that holds the moving box at all times."""
    moves = np.array([key[1] for key in track.keys])
    return corners[0] + moves.min(axis=0), corners[1] + moves.max(axis=0)
