"""Cameras of a view: on a turntable, on a dolly, or along a path of keys.

Angles are the view's: azimuth 0 is the front, 90 the right, elevation looks down from above.
Distances and targets are in object sizes, so that a camera fits any object. What a camera leaves
out is as the view has it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from phy124.bounds import Instant
from phy124.section import Section

Values = NDArray[np.float64]
Turn = Annotated[float, Field(ge=-3600, le=3600)]
Elevation = Annotated[float, Field(ge=-89, le=89)]
Distance = Annotated[float, Field(ge=0.6, le=100)]
FieldOfView = Annotated[float, Field(ge=1, le=120)]
Offset = Annotated[float, Field(ge=-100, le=100)]
Target = tuple[Offset, Offset, Offset]
Name = Annotated[str, Field(pattern="^[a-z][a-z0-9_-]*$", max_length=40)]


class Poses(NamedTuple):
    """Where a camera stands in each frame, around the middle of the object."""

    azimuth: Values
    """Degrees [T]."""
    elevation: Values
    """Degrees [T]."""
    distance: Values
    """Object sizes [T]."""
    fov: Values
    """Vertical field of view, degrees [T]."""
    target: Values
    """Point looked at, from the middle of the object, object sizes [T,3]."""

    @classmethod
    def still(
        cls, count: int, azimuth: float, elevation: float, distance: float, fov: float
    ) -> Poses:
        """The same for all frames.

        Args:
            count: Number of frames.
            azimuth: Degrees.
            elevation: Degrees.
            distance: Object sizes.
            fov: Vertical field of view, degrees.
        """
        a, e, d, f = (np.full(count, value) for value in (azimuth, elevation, distance, fov))
        return cls(a, e, d, f, np.zeros((count, 3)))

    def changed(self, **values: ArrayLike | None) -> Poses:
        """The same with other values, each a number or an array; None leaves one as it is."""
        given = {name: value for name, value in values.items() if value is not None}
        return self._replace(
            **{n: np.broadcast_to(value, getattr(self, n).shape) for n, value in given.items()}
        )


class _Circling(Section):
    """What cameras have in common that stand around a point."""

    elevation: Elevation | None = Field(
        default=None, examples=[30], description="Height angle [deg]; absent: the view's."
    )
    fov: FieldOfView | None = Field(
        default=None, examples=[40], description="Vertical field of view [deg]; absent: the view's."
    )
    target: Target = Field(
        default=(0.0, 0.0, 0.0),
        description="Point looked at, from the object's middle [object sizes].",
    )

    @property
    def end(self) -> float:
        """When its way ends [s]: it takes the time there is."""
        return 0.0


class TurntableCamera(_Circling):
    """Circles the object at a constant rate, once round in the clip unless told otherwise."""

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
        """Whether what it shows was chosen apart from the view: distance, opening or target."""
        return self.distance is not None or self.fov is not None or any(self.target)

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Where it stands at some instants.

        Args:
            times: Instants since the first frame [T], s.
            length: Length of the clip [s]; a whole turn ends where it began.
            usual: As the view has it.
        """
        azimuth = self.start + 360 * self.turns * times / length
        return usual.changed(
            azimuth=azimuth, elevation=self.elevation, distance=self.distance, fov=self.fov,
            target=self.target,
        )  # fmt: skip


class DollyCamera(_Circling):
    """Moves straight towards the object or away from it; it starts and ends gently."""

    kind: Literal["dolly"] = "dolly"
    name: Name = Field(default="dolly", description="Name of its files.")
    first: Distance = Field(default=3.0, description="Distance at the start, in object sizes.")
    last: Distance = Field(default=1.2, description="Distance at the end, in object sizes.")
    azimuth: Turn = Field(default=0.0, description="Side it stands on [deg].")

    @property
    def chosen(self) -> bool:
        """Its distances always are."""
        return True

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Where it stands at some instants.

        Args:
            times: Instants since the first frame [T], s.
            length: Length of the clip [s]; the way ends with the last frame.
            usual: As the view has it.
        """
        del length
        end = float(times[-1]) or 1.0
        return usual.changed(
            azimuth=self.azimuth, elevation=self.elevation, fov=self.fov, target=self.target,
            distance=smooth(times, (0.0, end), (self.first, self.last)),
        )  # fmt: skip


class CameraKey(Section):
    """Where a camera on a path stands at an instant; what is left out has no key there."""

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
        description="Point looked at, from the object's middle [object sizes].",
    )


class PathCamera(Section):
    """Goes smoothly through keys, without overshooting them, and rests before and after."""

    kind: Literal["path"] = "path"
    name: Name = Field(default="path", description="Name of its files.")
    keys: tuple[CameraKey, ...] = Field(
        default=(CameraKey(),),
        min_length=1,
        max_length=1000,
        description="Where it stands at some instants; with a single one it stands still.",
    )

    @model_validator(mode="after")
    def _in_order(self) -> PathCamera:
        times = [key.time for key in self.keys]
        if any(a >= b for a, b in itertools.pairwise(times)):
            raise ValueError(f"the times of its keys {times} must increase; sort them")
        return self

    @property
    def end(self) -> float:
        """When its way ends [s]."""
        return self.keys[-1].time

    @property
    def chosen(self) -> bool:
        """Whether what it shows was chosen apart from the view: distance, opening or target."""
        return any((key.distance, key.fov, key.target) != (None,) * 3 for key in self.keys)

    def poses(self, times: Values, length: float, usual: Poses) -> Poses:
        """Where it stands at some instants.

        Args:
            times: Instants since the first frame [T], s.
            length: Length of the clip [s].
            usual: As the view has it.
        """
        del length
        return usual.changed(**{name: self._at(times, name) for name in Poses._fields})

    def _at(self, times: Values, name: str) -> Values | None:
        """One quantity at some instants; None if no key has it."""
        keys = [(key.time, getattr(key, name)) for key in self.keys]
        given = [key for key in keys if key[1] is not None]
        return smooth(times, *zip(*given, strict=True)) if given else None


AnyCamera = Annotated[TurntableCamera | DollyCamera | PathCamera, Field(discriminator="kind")]


def smooth(at: Values, times: Sequence[float], values: Sequence[object]) -> Values:
    """Values at some instants, through keys with a continuous rate and without overshoot.

    Monotone cubic (Fritsch and Carlson 1980), at rest at the first key and the last one, where it
    stays before and after; between two keys this is 3 s^2 - 2 s^3.

    Args:
        at: Instants [T], s.
        times: Those of the keys, increasing [s].
        values: A number or vector for each key.
    """
    from scipy.interpolate import PchipInterpolator

    first, last = times[0], times[-1]
    # The same value before and after makes the rate zero at both ends.
    through = PchipInterpolator(
        [first - 1, *times, last + 1], np.array([values[0], *values, values[-1]], float)
    )
    return through(np.clip(at, first, last))
