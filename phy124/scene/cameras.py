"""Cameras of a view: on a turntable, on a dolly, or along a path of keyframes.

Azimuth 0 is the front, 90 the right. Distances and targets are in units of the object's size.
Values that a camera does not set are taken from the view.
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
    """Azimuth [T], degrees."""
    elevation: Values
    """Elevation [T], degrees."""
    distance: Values
    """Distance from the target [T], in object sizes."""
    fov: Values
    """Vertical field of view [T], degrees."""
    target: Values
    """Point at which the camera looks, relative to the object's centre [T,3], in object sizes."""

    @classmethod
    def still(
        cls, count: int, azimuth: float, elevation: float, distance: float, fov: float
    ) -> Poses:
        """Return the poses of a camera that does not move.

        Args:
            count: Number of frames.
            azimuth: Degrees.
            elevation: Degrees.
            distance: Distance from the target, in units of the object's size.
            fov: Vertical field of view, degrees.
        """
        a, e, d, f = (np.full(count, value) for value in (azimuth, elevation, distance, fov))
        return cls(a, e, d, f, np.zeros((count, 3)))

    def replace(self, **values: ArrayLike | None) -> Poses:
        """Return poses with some values replaced; None keeps a value."""
        changes = {
            name: np.broadcast_to(value, getattr(self, name).shape)
            for name, value in values.items()
            if value is not None
        }
        return self._replace(**changes)


class _Circling(Section):
    """Fields of cameras whose position is defined by angles and a distance around a target."""

    elevation: Elevation | None = Field(default=None, examples=[30])
    """Elevation [deg]; if absent, the view's elevation."""
    fov: FieldOfView | None = Field(default=None, examples=[40])
    """Vertical field of view [deg]; if absent, the field of view of the view."""
    target: Target = (0.0, 0.0, 0.0)
    """Point at which the camera looks, relative to the object's centre [object sizes]."""

    @property
    def end(self) -> float:
        """End time of the camera's path [s]; 0 means that the path is as long as the clip."""
        return 0.0


class TurntableCamera(_Circling):
    """Circles the object at a constant angular velocity, by default once during the clip."""

    kind: Literal["turntable"] = "turntable"
    name: Name = "turntable"
    """Name of the camera's files."""
    start: Turn = 0.0
    """Azimuth in the first frame [deg]."""
    turns: float = Field(default=1.0, ge=-100, le=100)
    """Number of turns during the clip; if negative, clockwise."""
    distance: Distance | None = Field(default=None, examples=[1.5])
    """Distance, in object sizes; if absent, the view's distance."""

    @property
    def chosen(self) -> bool:
        """Whether the camera sets its distance, field of view or target."""
        return self.distance is not None or self.fov is not None or any(self.target)

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Return the poses of the camera at some times.

        Args:
            times: Times since the first frame [T], s.
            length: Length of the clip [s], in which the camera makes a full turn.
            usual: Poses of the view, which apply where this camera sets no value.
        """
        return usual.replace(
            azimuth=self.start + 360 * self.turns * times / length,
            elevation=self.elevation,
            distance=self.distance,
            fov=self.fov,
            target=self.target,
        )


class DollyCamera(_Circling):
    """Moves straight towards or away from the object; the speed is zero at start and end."""

    kind: Literal["dolly"] = "dolly"
    name: Name = "dolly"
    """Name of the camera's files."""
    first: Distance = 3.0
    """Distance at the start, in object sizes."""
    last: Distance = 1.2
    """Distance at the end, in object sizes."""
    azimuth: Turn = 0.0
    """Azimuth of the camera [deg]."""

    @property
    def chosen(self) -> bool:
        """Whether the camera sets its distance, which is always true for this kind of camera."""
        return True

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Return the poses of the camera at times [T], s; the path ends at the last time.

        `usual` has the values that this camera does not set; `length` is not used.
        """
        end = float(times[-1]) or 1.0
        return usual.replace(
            azimuth=self.azimuth,
            elevation=self.elevation,
            fov=self.fov,
            target=self.target,
            distance=interpolate(times, (0.0, end), (self.first, self.last)),
        )


class CameraKey(Section):
    """A key of a camera path: a time and the camera's values at this time."""

    time: Instant = 0.0
    """Time since the first frame [s]."""
    azimuth: Turn | None = Field(default=None, examples=[90])
    """Azimuth [deg]: 0 is the front, 90 the right. It may exceed 360: 370 after 350 continues the
    rotation.
    """
    elevation: Elevation | None = Field(default=None, examples=[30])
    """Elevation [deg]."""
    distance: Distance | None = Field(default=None, examples=[1.5])
    """Distance, in object sizes."""
    fov: FieldOfView | None = Field(default=None, examples=[40])
    """Vertical field of view [deg]."""
    target: Target | None = Field(default=None, examples=[[0.0, 0.0, 0.2]])
    """Point at which the camera looks, relative to the object's centre [object sizes]."""


class PathCamera(Section):
    """Moves smoothly through keys without overshoot, and is at rest before and after the path."""

    kind: Literal["path"] = "path"
    name: Name = "path"
    """Name of the camera's files."""
    keys: tuple[CameraKey, ...] = Field(default=(CameraKey(),), min_length=1, max_length=1000)
    """Keys of the path. If there is a single key, the camera does not move."""

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
        """Whether the camera sets its distance, field of view or target."""
        return any((key.distance, key.fov, key.target) != (None,) * 3 for key in self.keys)

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Return the poses of the camera at times [T], s.

        `usual` has the values that this camera does not set; `length` is not used.
        """
        values = {}
        for name in Poses._fields:
            keys = [(key.time, getattr(key, name)) for key in self.keys]
            if keys := [key for key in keys if key[1] is not None]:
                values[name] = interpolate(times, *zip(*keys, strict=True))
        return usual.replace(**values)


AnyCamera = Annotated[TurntableCamera | DollyCamera | PathCamera, Field(discriminator="kind")]


def interpolate(at: Values, times: Sequence[float], values: Sequence[object]) -> Values:
    """Interpolate keys by a monotone cubic (Fritsch and Carlson 1980), without overshoot.

    The derivative is zero at the first and the last key; outside the keys, the value is constant.
    """
    from scipy.interpolate import PchipInterpolator

    first, last = times[0], times[-1]
    # The end values are repeated, so that the derivative is zero at both ends.
    through = PchipInterpolator(
        [first - 1, *times, last + 1], np.array([values[0], *values, values[-1]], float)
    )
    return through(np.clip(at, first, last))
