"""Clamps: regions in which material is fixed."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from phy124.boundaries.base import Contact, Corners, Movable, Rest, box_of, half_bounds, vector
from phy124.mpm import Model
from phy124.mpm.tracks import STILL, Track
from phy124.schema.bounds import LONGEST, SHORTEST, Position
from phy124.schema.region import AxisName, Vector, cylinder


class Clamp(Movable):
    """Fixes material, permanently or until a given time."""

    holds: ClassVar[bool] = True

    contact: Contact = "sticky"
    """Constrained directions of motion: sticky fixes all directions."""
    end: float | None = Field(default=None, examples=[0.5], ge=SHORTEST, le=LONGEST)
    """Time at which the material is released [s]. Default: never."""

    def track(self, model: Rest) -> Track | None:
        """Return the displacement [m] until the release; None for a permanent clamp at rest."""
        track = super().track(model)
        if self.end is None:
            return track
        return replace(track or STILL, end=self.end)

    @property
    def tracked(self) -> bool:
        """Whether the clamp moves or releases its material."""
        return self.moves or self.end is not None

    def at_surface(self, dx: float) -> bool:
        """Return whether the clamp acts exactly up to its surface; only sticky clamps do."""
        return self.contact == "sticky"

    def response(self) -> str:
        """Return the rule by which nodes respond: "held" for sticky clamps, otherwise `contact`."""
        return "held" if self.contact == "sticky" else self.contact

    def reach(self, dx: float) -> float | None:
        """Return 0 m, because only nodes inside the region respond."""
        return 0.0


class Held(Clamp):
    """A box or cylinder in which the material is fixed, such as the foot of a stem."""

    shape: ClassVar[str] = "box"
    kind: Literal["held"] = "held"
    lower: Position = (-10.0, -10.0, -10.0)
    """Lowest corner [m]."""
    upper: Position = (10.0, 10.0, 0.1)
    """Highest corner [m]."""
    cylinder: AxisName | None = None
    """Axis of a cylinder that is inscribed in the box and clamps the material instead of the box.
    Default: the box.
    """

    @model_validator(mode="after")
    def _check_box(self) -> Held:
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"lower {self.lower} must be below upper {self.upper}; swap them")
        return self

    def outline(self) -> str:
        """Return the name of the distance function: cylinder or box."""
        return "cylinder" if self.cylinder else "box"

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return the centre and half sizes [m] of a box, or the centre, the axis and (radius, half
        length) of a cylinder.
        """
        if self.cylinder is None:
            return box_of(self.lower, self.upper)
        axis, middle, radius = cylinder(self.lower, self.upper, self.cylinder)
        half = (self.upper[axis] - self.lower[axis]) / 2
        return middle, vector(np.eye(3)[axis]), (radius, half, 0.0)

    def extent(self, model: Model) -> Corners:
        """Return the corners of the box [m]."""
        return np.array(self.lower), np.array(self.upper)


class Foot(Clamp):
    """Fixes the lowest part of the object, like the part of a plant in a pot."""

    shape: ClassVar[str] = "half_space"
    kind: Literal["foot"] = "foot"
    fraction: float = Field(default=0.15, ge=1e-6, le=1)
    """Fixed fraction of the object's height, from its lowest point."""

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return a point [m] on a plane, and the plane's normal; material below the plane is
        fixed.
        """
        z = model.rest_of(self.object)[:, 2]
        top = float(z.min() + self.fraction * np.ptp(z))
        return (0.0, 0.0, top), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)

    def extent(self, model: Model) -> Corners:
        """Return the corners [m] of a bounding box of the space below the plane."""
        point, normal, _ = self.geometry(model)
        return half_bounds(point, normal)
