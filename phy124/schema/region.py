"""Region: a box or cylinder in which a force, a boundary or a material acts."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.gaussians import rotation_matrices
from phy124.schema.section import Section

Vector = tuple[float, float, float]
EVERYWHERE = 1e9
"""Coordinate outside any scene [m]; finite, because JSON has no infinity."""
_Side = Annotated[float, Field(ge=-EVERYWHERE, le=EVERYWHERE)]
_Fraction = Annotated[float, Field(ge=-1, le=1)]
_Corner = tuple[_Side, _Side, _Side]
AxisName = Literal["x", "y", "z"]


class Region(Section):
    """An axis-aligned box [m] or the cylinder inscribed in it; a side without a value is open."""

    lower: _Corner = (-EVERYWHERE, -EVERYWHERE, -EVERYWHERE)
    """Lowest corner [m]."""
    upper: _Corner = (EVERYWHERE, EVERYWHERE, EVERYWHERE)
    """Highest corner [m]."""
    cylinder: AxisName | None = None
    """Replace the box by the cylinder inscribed in it along this axis; if absent, the box is kept.
    """

    @model_validator(mode="after")
    def _check_corners(self) -> Region:
        if any(low >= high for low, high in zip(self.lower, self.upper, strict=True)):
            raise ValueError(
                f"lower {self.lower} must be below upper {self.upper} on each axis; swap them"
            )
        sides = zip("xyz", self.lower, self.upper, strict=True)
        if self.cylinder and any(
            name != self.cylinder and max(-low, high) >= EVERYWHERE for name, low, high in sides
        ):
            raise ValueError(
                f"for a cylinder along {self.cylinder}, the extent on the two other axes must be "
                "given; set lower and upper of both axes"
            )
        return self

    def contains(self, x: NDArray) -> NDArray[np.bool_]:
        """Return a mask [N] of the points x [N,3], m, that lie inside the region."""
        inside: NDArray[np.bool_] = np.all((x >= self.lower) & (x <= self.upper), axis=1)
        if self.cylinder:
            axis, middle, radius = cylinder(self.lower, self.upper, self.cylinder)
            across = np.delete(x - middle, axis, axis=1)
            inside &= (across**2).sum(axis=1) <= radius**2
        return inside


def cylinder(lower: Vector, upper: Vector, along: AxisName) -> tuple[int, Vector, float]:
    """Return the axis, the centre [m] and the radius [m] of the cylinder inscribed in a box.

    The diameter is the shorter of the two sides perpendicular to the axis. If the box is open along
    the axis, the coordinate of the centre along the axis is meaningless.
    """
    axis = "xyz".index(along)
    x, y, z = ((low + high) / 2 for low, high in zip(lower, upper, strict=True))
    sides = [upper[i] - lower[i] for i in range(3) if i != axis]
    return axis, (x, y, z), min(sides) / 2


class PartRegion(Region):
    """A region that selects a part of the object.

    The region may be rotated, and may have the coordinates of a file.
    """

    units: Literal["metres", "file"] = "metres"
    """metres: coordinates in the scene; file: coordinates in the object's file."""
    turn: tuple[_Fraction, _Fraction, _Fraction, _Fraction] = (1.0, 0.0, 0.0, 0.0)
    """Rotation of the box about the origin, a unit quaternion w, x, y, z."""

    @model_validator(mode="before")
    @classmethod
    def _convert(cls, data: Any) -> Any:
        return data.model_dump() if type(data) is Region else data

    @model_validator(mode="after")
    def _check_turn(self) -> PartRegion:
        if abs(np.linalg.norm(self.turn) - 1) > 1e-3:
            raise ValueError("turn is not a unit quaternion; write [1, 0, 0, 0] for no rotation")
        return self

    def contains(self, x: NDArray) -> NDArray[np.bool_]:
        """Return a mask [N] of the points x [N,3], m, that lie inside the region."""
        return super().contains(x @ rotation_matrices(np.array([self.turn]))[0])
