"""Solid obstacles: box, sphere and capsule; and a gripper with two pads."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.boundaries.base import Boundary, Corners, Movable, Rest, box_of, vector
from phy124.boundaries.motion import Path
from phy124.mpm import Model, Stage, State
from phy124.mpm.depth import measure_depth
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import LONGEST, SHORTEST, Position
from phy124.schema.region import Vector

Axis = Literal["x", "y"]


class Solid(Movable):
    """A solid of finite size."""

    def measure_depth(self, x: NDArray[np.float64], model: Rest) -> NDArray[np.float64]:
        """Return the depths [P], m, of points [P,3] inside the solid in its initial position."""
        return measure_depth(self.shape, self.geometry(model), x)


class Box(Solid):
    """A box aligned with the axes."""

    shape: ClassVar[str] = "box"
    kind: Literal["box"] = "box"
    lower: Position = (-0.2, -0.2, 0.0)
    """Lowest corner [m]."""
    upper: Position = (0.2, 0.2, 0.2)
    """Highest corner [m]."""

    @model_validator(mode="after")
    def _check_box(self) -> Box:
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"lower {self.lower} must be below upper {self.upper}; swap them")
        return self

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return the centre and the half sizes of the box [m]."""
        return box_of(self.lower, self.upper)

    def extent(self, model: Model) -> Corners:
        """Return the corners of the box [m]."""
        return np.array(self.lower), np.array(self.upper)

    def thickness(self) -> float:
        """Return half of the length of the box's shortest side [m]."""
        return float(np.subtract(self.upper, self.lower).min()) / 2


class Sphere(Solid):
    """A ball."""

    shape: ClassVar[str] = "sphere"
    kind: Literal["sphere"] = "sphere"
    centre: Position = (0.0, 0.0, 0.2)
    """Centre [m]."""
    radius: float = Field(default=0.2, ge=1e-9, le=1e5)
    """Radius [m]."""

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return the centre and the radius of the sphere [m]."""
        return self.centre, (self.radius, 0.0, 0.0), (0.0, 0.0, 0.0)

    def extent(self, model: Model) -> Corners:
        """Return the corners of the sphere's bounding box [m]."""
        return np.array(self.centre) - self.radius, np.array(self.centre) + self.radius

    def thickness(self) -> float:
        """Return half of the solid's thickness, which is its radius [m]."""
        return self.radius


class Capsule(Solid):
    """A rod with round ends."""

    shape: ClassVar[str] = "capsule"
    kind: Literal["capsule"] = "capsule"
    start: Position = (0.0, -0.5, 0.2)
    """Start of the capsule's axis [m]."""
    end: Position = (0.0, 0.5, 0.2)
    """End of the capsule's axis [m]."""
    radius: float = Field(default=0.1, ge=1e-9, le=1e5)
    """Radius [m]."""

    @model_validator(mode="after")
    def _long(self) -> Capsule:
        if math.dist(self.start, self.end) == 0:
            raise ValueError("start and end are the same point; use a sphere")
        return self

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return the two ends of the capsule's axis, and its radius [m]."""
        return self.start, self.end, (self.radius, 0.0, 0.0)

    def extent(self, model: Model) -> Corners:
        """Return the corners of the capsule's bounding box [m]."""
        ends = np.array([self.start, self.end])
        return ends.min(axis=0) - self.radius, ends.max(axis=0) + self.radius

    def thickness(self) -> float:
        """Return half of the solid's thickness, which is its radius [m]."""
        return self.radius


class Gripper(Boundary):
    """Two pads that grip the object from both sides and then lift the object."""

    thing: ClassVar[str] = "each pad (thick, width)"
    kind: Literal["gripper"] = "gripper"
    friction: float = Field(default=1.0, ge=0, le=10)
    """Coulomb friction coefficient."""
    axis: Axis = "y"
    """Direction in which the gripper closes."""
    centre: Position = (0.0, 0.0, 0.5)
    """Point midway between the pads [m]."""
    opening: float = Field(default=1.2, ge=1e-9, le=1e5)
    """Initial gap between the pads [m]."""
    closed: float = Field(default=0.6, ge=1e-9, le=1e5)
    """Gap between the pads when closed [m]."""
    width: float = Field(default=0.4, ge=1e-9, le=1e5)
    """Side length of the square pads [m]."""
    thick: float = Field(default=0.2, ge=1e-9, le=1e5)
    """Thickness of the pads [m]."""
    start: float = Field(default=0.0, ge=0, le=LONGEST)
    """Time at which the gripper starts to close [s]."""
    close: float = Field(default=0.4, ge=SHORTEST, le=LONGEST)
    """Time that the gripper takes to close [s]."""
    lift: float = Field(default=0.3, ge=0, le=1e5)
    """Height by which the gripper rises after closing [m]."""
    rise: float = Field(default=0.5, ge=SHORTEST, le=LONGEST)
    """Time that the gripper takes to rise [s]."""

    @model_validator(mode="after")
    def _closes(self) -> Gripper:
        if self.closed >= self.opening:
            raise ValueError(
                f"closed {self.closed} m must be less than opening {self.opening} m; reduce closed"
            )
        return self

    @property
    def moves(self) -> bool:
        """Always True: a gripper moves."""
        return True

    def thickness(self) -> float:
        """Return half of the shortest side of the pads [m]."""
        return min(self.thick, self.width) / 2

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the speed of the pads."""
        return {"close": 2 * self.close, "rise": 2 * self.rise}

    def parts(self) -> list[Box]:
        """Return the two pads."""
        return self.pads()

    def part_names(self) -> list[str]:
        """Return a name for each pad, made of the axis and the pad's side, for example `y_low`."""
        return [f"{self.axis}_low", f"{self.axis}_high"]

    def pads(self) -> list[Box]:
        """Return the two pads as moving boxes."""
        along = {"x": 0, "y": 1}[self.axis]
        half = np.full(3, self.width / 2)
        half[along] = self.thick / 2
        pads = []
        for side in (-1.0, 1.0):
            middle, inwards = np.array(self.centre), np.zeros(3)
            middle[along] += side * (self.opening + self.thick) / 2
            inwards[along] = -side * (self.opening - self.closed) / 2
            points = ((0.0, 0.0, 0.0), vector(inwards), vector([*inwards[:2], self.lift]))
            times = (0.0, self.close, self.close + self.rise)
            pad = Box.model_construct(lower=vector(middle - half), upper=vector(middle + half))
            path = Path.model_construct(start=self.start, times=times, points=points)
            answer = {"contact": self.contact, "friction": self.friction, "motion": path}
            answer["object"] = self.object
            pads.append(pad.model_copy(update=answer))
        return pads

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return one stage of the substep for each pad."""
        self.refuse_thin(model)
        return [
            stage._replace(name="gripper")
            for pad in self.pads()
            for stage in pad.attach(model, state, tracks)
        ]
