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

    def geometry(self) -> tuple[Vector, Vector, Vector]:
        """Three vectors that the shape's distance function reads."""
        raise NotImplementedError

    def bounds(self) -> Corners:
        """Corners of a box that holds every node inside the shape at rest [m]."""
        return np.full(3, -np.inf), np.full(3, np.inf)

    def track(self) -> Track | None:
        """Displacement over time [m]; None if it never moves."""
        return None

    def attach(self, solver: Solver) -> list[Stage]:
        """One collider stage."""
        t, track = types(solver.real), self.track()
        slot = 0 if track is None else solver.tracks.add(track)
        moving = track is not None
        kernel = make_collider(self.shape, self.contact, moving, solver.real)
        bounds = self.bounds() if track is None else _swept(self.bounds(), track)
        box = wp.zeros(1, dtype=wp.vec3i, device=solver.device)

        def record() -> wp.Launch:
            start, extent = solver.grid.nodes_within(*bounds)
            box.assign(np.array([start], np.int32))
            inputs = [
                t.mat33(*np.ravel(self.geometry())), self.friction, self.reach(solver.dx), slot,
                box, solver.grid.lattice, solver.grid.window,
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

    def geometry(self) -> tuple[Vector, Vector, Vector]:
        """Point and unit normal."""
        length = math.hypot(*self.normal)
        x, y, z = (component / length for component in self.normal)
        return self.point, (x, y, z), (0.0, 0.0, 0.0)

    def bounds(self) -> Corners:
        """Half of space if the normal lies along an axis, else all of it."""
        return _half_bounds(self.point, self.normal)


class Ground(Boundary):
    """A floor at a height, on which objects stand by default."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["ground"] = "ground"
    height: float = Field(default=0.0, description="Height of the floor [m].")

    def geometry(self) -> tuple[Vector, Vector, Vector]:
        """Point and unit normal."""
        return (0.0, 0.0, self.height), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)

    def bounds(self) -> Corners:
        """Everything below."""
        return _half_bounds((0.0, 0.0, self.height), (0.0, 0.0, 1.0))


class Press(Boundary):
    """A plate that comes down from above to a height, rests and goes back."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["press"] = "press"
    top: float = Field(default=1.05, description="Height of the plate at the start [m].")
    bottom: float = Field(default=0.7, description="Height at which it turns back [m].")
    start: float = Field(default=0.0, ge=0, description="Begins to move [s].")
    down: float = Field(default=0.25, gt=0, description="Time to come down [s].")
    hold: float = Field(default=0.05, ge=0, description="Time at the bottom [s].")
    up: float = Field(default=0.2, gt=0, description="Time to go back [s].")
    contact: Contact = Field(default="separate", description="sticky, slip, or separate.")

    def geometry(self) -> tuple[Vector, Vector, Vector]:
        """Point and unit normal, before displacement."""
        return (0.0, 0.0, self.top), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)

    def bounds(self) -> Corners:
        """Everything above the plate."""
        return _half_bounds((0.0, 0.0, self.top), (0.0, 0.0, -1.0))

    def track(self) -> Track:
        """Down with smooth ends, hold, and up again."""
        depth, parts = self.bottom - self.top, np.linspace(0, 1, 17)
        ease = (1 - np.cos(np.pi * parts)) / 2
        turn = self.start + self.down
        keys = [(0.0, (0.0, 0.0, 0.0), True)]
        keys += [
            (self.start + self.down * s, (0.0, 0.0, depth * e), True)
            for s, e in zip(parts, ease, strict=True)
        ]
        back = turn + self.hold
        keys += [
            (back + self.up * s, (0.0, 0.0, depth * (1 - e)), True)
            for s, e in zip(parts, ease, strict=True)
        ]
        return Track(tuple((float(t), (0.0, 0.0, float(v[2])), a) for t, v, a in keys))


class Held(Boundary):
    """A box of space in which the material is held in place, such as the foot of a stem."""

    shape: ClassVar[str] = "box"
    kind: Literal["held"] = "held"
    lower: Vector = Field(default=(-10.0, -10.0, -10.0), description="Lowest corner [m].")
    upper: Vector = Field(default=(10.0, 10.0, 0.1), description="Highest corner [m].")
    contact: Contact = Field(default="sticky", description="sticky holds all directions.")

    def geometry(self) -> tuple[Vector, Vector, Vector]:
        """Centre and half sizes."""
        lower, upper = np.array(self.lower), np.array(self.upper)
        centre, half = (lower + upper) / 2, (upper - lower) / 2
        return tuple(centre.tolist()), tuple(half.tolist()), (0.0, 0.0, 0.0)

    def bounds(self) -> Corners:
        """The box."""
        return np.array(self.lower), np.array(self.upper)

    def reach(self, dx: float) -> float:
        """The box is a region, not a wall: all its nodes are held."""
        return 0.0


AnyBoundary = Annotated[Ground | HalfSpace | Press | Held, Field(discriminator="kind")]


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
