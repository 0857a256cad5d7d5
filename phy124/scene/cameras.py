"""Cameras of a view: on a turntable, on a dolly, or along a path of keys.

Angles are those of the view: azimuth 0 is the front, 90 the right; positive elevation looks down.
Distances and targets are in object sizes, so that a camera fits any object. Values that a camera
leaves out come from the view.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from phy124.schema.bounds import Instant
from phy124.schema.section import Section

Values = NDArray[np.float64]
Turn = Annotated[float, Field(ge=-3600, le=3600)]
Elevation = Annotated[float, Field(ge=-89, le=89)]
Distance = Annotated[float, Field(ge=0.6, le=100)]
FieldOfView = Annotated[float, Field(ge=1, le=120)]
Offset = Annotated[float, Field(ge=-100, le=100)]
Target = tuple[Offset, Offset, Offset]
Name = Annotated[str, Field(pattern="^[a-z][a-z0-9_-]*$", max_length=40)]


class Poses(NamedTuple):
    """Camera poses for all frames, relative to the object's centre."""

    azimuth: Values
    """Degrees [T]."""
    elevation: Values
    """Degrees [T]."""
    distance: Values
    """Object sizes [T]."""
    fov: Values
    """Vertical field of view, degrees [T]."""
    target: Values
    """Point looked at, relative to the object's centre, object sizes [T,3]."""

    @classmethod
    def still(
        cls, count: int, azimuth: float, elevation: float, distance: float, fov: float
    ) -> Poses:
        """Return poses of a camera that does not move.

        Args:
            count: Number of frames.
            azimuth: Degrees.
            elevation: Degrees.
            distance: Object sizes.
            fov: Vertical field of view, degrees.
        """
        a, e, d, f = (np.full(count, value) for value in (azimuth, elevation, distance, fov))
        return cls(a, e, d, f, np.zeros((count, 3)))

    def replace(self, **values: ArrayLike | None) -> Poses:
        """Return poses with other values, each a number or an array; None changes nothing."""
        changes = {
            name: np.broadcast_to(value, getattr(self, name).shape)
            for name, value in values.items()
            if value is not None
        }
        return self._replace(**changes)


class _Circling(Section):
    """Fields shared by the cameras that stand around a point."""

    elevation: Elevation | None = Field(
        default=None, examples=[30], description="Height angle [deg]; absent: the view's."
    )
    fov: FieldOfView | None = Field(
        default=None, examples=[40], description="Vertical field of view [deg]; absent: the view's."
    )
    target: Target = Field(
        default=(0.0, 0.0, 0.0),
        description="Point looked at, relative to the object's centre [object sizes].",
    )

    @property
    def end(self) -> float:
        """Time at which its path ends [s]; 0, since it adapts to the clip's length."""
        return 0.0


class TurntableCamera(_Circling):
    """Circles the object at a constant rate, by default once in the clip."""

    kind: Literal["turntable"] = "turntable"
    name: Name = Field(default="turntable", description="Name of its files.")
    start: Turn = Field(default=0.0, description="Azimuth in the first frame [deg].")
    turns: float = Field(
        default=1.0, ge=-100, le=100, description="Turns in the whole clip; negative: clockwise."
    )
    distance: Distance | None = Field(
        default=None, examples=[1.5], description="Distance, in object sizes; absent: the view's."
    )

    @property
    def chosen(self) -> bool:
        """Whether distance, field of view or target differ from the view's."""
        return self.distance is not None or self.fov is not None or any(self.target)

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Return the camera's poses at some times.

        Args:
            times: Times since the first frame [T], s.
            length: Length of the clip [s]; a whole turn ends where it began.
            usual: Poses of the view, for the values that this camera leaves out.
        """
        return usual.replace(
            azimuth=self.start + 360 * self.turns * times / length,
            elevation=self.elevation,
            distance=self.distance,
            fov=self.fov,
            target=self.target,
        )


class DollyCamera(_Circling):
    """Moves straight towards the object or away from it; it starts and ends gently."""

    kind: Literal["dolly"] = "dolly"
    name: Name = Field(default="dolly", description="Name of its files.")
    first: Distance = Field(default=3.0, description="Distance at the start, in object sizes.")
    last: Distance = Field(default=1.2, description="Distance at the end, in object sizes.")
    azimuth: Turn = Field(default=0.0, description="Side on which it stands [deg].")

    @property
    def chosen(self) -> bool:
        """True: its distances are always set."""
        return True

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Return the camera's poses at some times.

        Args:
            times: Times since the first frame [T], s; the path ends with the last one.
            length: Length of the clip [s], not used.
            usual: Poses of the view, for the values that this camera leaves out.
        """
        del length
        end = float(times[-1]) or 1.0
        return usual.replace(
            azimuth=self.azimuth,
            elevation=self.elevation,
            fov=self.fov,
            target=self.target,
            distance=interpolate(times, (0.0, end), (self.first, self.last)),
        )


class CameraKey(Section):
    """A key of a camera path: a time and the values that the camera has then."""

    time: Instant = Field(default=0.0, description="Motion since the first frame [s].")
    azimuth: Turn | None = Field(
        default=None,
        examples=[90],
        description="0 is the front, 90 the right; 370 goes on from 350 [deg].",
    )
    elevation: Elevation | None = Field(
        default=None, examples=[30], description="Height angle [deg]."
    )
    distance: Distance | None = Field(
        default=None, examples=[1.5], description="Distance, in object sizes."
    )
    fov: FieldOfView | None = Field(
        default=None, examples=[40], description="Vertical field of view [deg]."
    )
    target: Target | None = Field(
        default=None,
        examples=[[0.0, 0.0, 0.2]],
        description="Point looked at, relative to the object's centre [object sizes].",
    )


class PathCamera(Section):
    """Moves smoothly through keys without overshoot, and stands still before and after them."""

    kind: Literal["path"] = "path"
    name: Name = Field(default="path", description="Name of its files.")
    keys: tuple[CameraKey, ...] = Field(
        default=(CameraKey(),),
        min_length=1,
        max_length=1000,
        description="Keys of the path; with a single one the camera stands still.",
    )

    @model_validator(mode="after")
    def _check_order(self) -> PathCamera:
        times = [key.time for key in self.keys]
        if any(a >= b for a, b in itertools.pairwise(times)):
            raise ValueError(f"the times of its keys {times} must increase; sort them")
        return self

    @property
    def end(self) -> float:
        """Time of the last key [s]."""
        return self.keys[-1].time

    @property
    def chosen(self) -> bool:
        """Whether distance, field of view or target differ from the view's."""
        return any((key.distance, key.fov, key.target) != (None,) * 3 for key in self.keys)

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Return the camera's poses at some times.

        Args:
            times: Times since the first frame [T], s.
            length: Length of the clip [s], not used.
            usual: Poses of the view, for the values that this camera leaves out.
        """
        del length
        values = {}
        for name in Poses._fields:
            keys = [(key.time, getattr(key, name)) for key in self.keys]
            if keys := [key for key in keys if key[1] is not None]:
                values[name] = interpolate(times, *zip(*keys, strict=True))
        return usual.replace(**values)


AnyCamera = Annotated[TurntableCamera | DollyCamera | PathCamera, Field(discriminator="kind")]


def interpolate(at: Values, times: Sequence[float], values: Sequence[object]) -> Values:
    """Interpolate keys by a monotone cubic (Fritsch and Carlson 1980), without overshoot.

    The rate is continuous, and zero at the first and last key; the value is constant outside them.
    Between two keys alone this is 3 s^2 - 2 s^3.

    Args:
        at: Times at which to interpolate [T], s.
        times: Times of the keys, increasing [s].
        values: A number or vector for each key.
    """
    from scipy.interpolate import PchipInterpolator

    first, last = times[0], times[-1]
    # Repeating the end values makes the rate zero at both ends.
    through = PchipInterpolator(
        [first - 1, *times, last + 1], np.array([values[0], *values, values[-1]], float)
    )
    return through(np.clip(at, first, last))
