"""Infinite walls: ground, half-space, press, container."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.boundaries.base import Boundary, Corners, Movable, Rest, half_bounds, vector
from phy124.boundaries.motion import Path
from phy124.mpm import Model, Stage, State
from phy124.mpm.depth import measure_depth
from phy124.mpm.tracks import Track, Tracks
from phy124.schema.bounds import FARTHEST, LONGEST, SHORTEST, Direction, Position
from phy124.schema.region import Region, Vector


class Plane(Boundary):
    """Base class of boundaries that are solid everywhere behind a plane."""

    shape: ClassVar[str] = "half_space"

    def extent(self, model: Model) -> Corners:
        """Return the corners [m] of the bounding box; all space if the normal is oblique."""
        point, normal, _ = self.geometry(model)
        return half_bounds(point, normal)

    def measure_depth(self, x: NDArray[np.float64], model: Rest) -> NDArray[np.float64]:
        """Return the depths [P], m, of points [P,3] behind the plane in its initial position."""
        return measure_depth(self.shape, self.geometry(model), x)


class HalfSpace(Plane, Movable):
    """A solid that fills all space behind a plane."""

    kind: Literal["half_space"] = "half_space"
    point: Position = (0.0, 0.0, 0.0)
    """A point on the plane [m]."""
    normal: Direction = (0.0, 0.0, 1.0)
    """Normal of the plane; it points out of the solid."""

    @model_validator(mode="after")
    def _points_somewhere(self) -> HalfSpace:
        if math.hypot(*self.normal) == 0:
            raise ValueError(
                "the normal is zero; set it to the direction that points out of the solid"
            )
        return self

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return a point on the plane and the unit normal."""
        length = math.hypot(*self.normal)
        x, y, z = (component / length for component in self.normal)
        return self.point, (x, y, z), (0.0, 0.0, 0.0)


class Ground(Plane, Movable):
    """A horizontal floor, on which objects stand by default."""

    kind: Literal["ground"] = "ground"
    height: float = Field(default=0.0, ge=-FARTHEST, le=FARTHEST)
    """Height of the floor [m]."""

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return a point on the floor and the unit normal."""
        return (0.0, 0.0, self.height), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)


class Press(Plane):
    """A plate that descends onto the object, rests and goes back up."""

    kind: Literal["press"] = "press"
    top: float | None = Field(default=None, ge=-FARTHEST, le=FARTHEST, examples=[1.2])
    """Initial height of the plate [m]. Default: the top of `object`, or of all objects."""
    depth: float = Field(default=0.35, gt=0, le=0.9)
    """Distance that the plate descends, relative to the object's height."""
    start: float = Field(default=0.0, ge=0, le=LONGEST)
    """Time at which the plate starts to move [s]."""
    down: float = Field(default=0.25, ge=SHORTEST, le=LONGEST)
    """Duration of the descent [s]."""
    hold: float = Field(default=0.05, ge=0, le=LONGEST)
    """Duration of the rest at the lowest position [s]."""
    up: float = Field(default=0.2, ge=SHORTEST, le=LONGEST)
    """Duration of the ascent [s]."""

    @property
    def moves(self) -> bool:
        """Always True: a press moves."""
        return True

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the speed of the plate."""
        return {"down": 2 * self.down, "up": 2 * self.up}

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return a point [m] and the unit normal of the plate's lower side before it moves."""
        height = model.top_of(self.object) if self.top is None else self.top
        return (0.0, 0.0, height), (0.0, 0.0, -1.0), (0.0, 0.0, 0.0)

    def track(self, model: Rest) -> Track:
        """Return the displacement [m]: a smooth descent, a rest, and a smooth ascent."""
        low = (0.0, 0.0, -self.depth * float(np.ptp(model.rest_of(self.object)[:, 2])))
        return there_and_back(low, self.start, self.down, self.hold, self.up)


class Container(Movable):
    """A box that objects cannot leave: the walls of a tank, of a tray, or of the whole domain.

    Each closed side adds one stage to the substep.
    """

    kind: Literal["container"] = "container"
    inside: Region = Region(lower=(-1.0, -1.0, 0.0), upper=(1.0, 1.0, 2.0))
    """Space inside the container. A side is open if its coordinate is beyond 1e5 m, such as 1e9."""

    @model_validator(mode="after")
    def _square(self) -> Container:
        if self.inside.cylinder:
            raise ValueError("the walls of a container are flat; remove `inside.cylinder`")
        return self

    def parts(self) -> list[HalfSpace]:
        """Return the walls on the closed sides."""
        return self.sides()

    def part_names(self) -> list[str]:
        """Return a name for each wall: its axis and "low" or "high" (`z_low` is the floor)."""
        normals = [side.normal for side in self.sides()]
        axes = [int(np.argmax(np.abs(normal))) for normal in normals]
        return [
            f"{'xyz'[axis]}_{'low' if normal[axis] > 0 else 'high'}"
            for axis, normal in zip(axes, normals, strict=True)
        ]

    def sides(self) -> list[HalfSpace]:
        """Return the walls of the closed sides; a side far outside any scene counts as open."""
        walls = []
        for axis in range(3):
            for corner, sign in ((self.inside.lower, 1.0), (self.inside.upper, -1.0)):
                if abs(corner[axis]) <= FARTHEST:
                    normal, point = np.zeros((2, 3))
                    normal[axis], point[axis] = sign, corner[axis]
                    wall = HalfSpace(
                        point=vector(point), normal=vector(normal), contact=self.contact
                    )
                    moves = {
                        "friction": self.friction,
                        "motion": self.motion,
                        "object": self.object,
                    }
                    walls.append(wall.model_copy(update=moves))
        return walls

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return one stage of the substep for each wall."""
        return [
            stage._replace(name="container")
            for wall in self.sides()
            for stage in wall.attach(model, state, tracks)
        ]


def there_and_back(to: Vector, start: float, go: float, stay: float, back: float) -> Track:
    """Return the displacement of a wall that moves smoothly to `to`, rests, and moves smoothly
    back.

    Args:
        to: Displacement during the rest [m].
        start: Time at which the displacement starts [s].
        go: Duration of the displacement [s].
        stay: Duration of the rest [s].
        back: Duration of the return [s].
    """
    here = (0.0, 0.0, 0.0)
    times = [0.0, go, go + stay, go + stay + back] if stay > 0 else [0.0, go, go + back]
    points = (here, to, to, here) if stay > 0 else (here, to, here)
    # The track is built without validation, because the sum of valid durations may exceed the
    # bound.
    return Path.model_construct(start=start, times=tuple(times), points=points).track()
