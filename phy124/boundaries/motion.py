"""Motions of boundaries: along a path, in an oscillation, or freely."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from phy124.mpm.tracks import Key, Sine, Track, check_times
from phy124.schema.bounds import LONGEST, Instant, Position
from phy124.schema.section import Section

EASE = 16
"""Number of straight segments between two points of a smooth path."""


class Motion(Section):
    """Base class of all prescribed motions: displacements over time."""

    start: float = Field(default=0.0, ge=0, le=LONGEST)
    """Time at which the motion starts [s]."""

    def track(self) -> Track:
        """Return the displacement [m] over time; its derivative is the wall's velocity [m/s]."""
        raise NotImplementedError

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the speed of the motion."""
        raise NotImplementedError


class Path(Motion):
    """A displacement along a path through several points."""

    kind: Literal["path"] = "path"
    times: tuple[Instant, ...] = (0.0, 1.0)
    """Times at which the boundary reaches the displacements in `points` [s]."""
    points: tuple[Position, ...] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    """Displacements at `times` [m]."""
    smooth: bool = True
    """Whether the motion slows down to a stop at each point."""
    repeat: bool = False
    """Whether the path repeats after the last point."""

    @model_validator(mode="after")
    def _fits(self) -> Path:
        check_times(self.times, len(self.points), "points")
        if self.repeat and self.points[0] != self.points[-1]:
            raise ValueError(
                "a repeating path must end where it begins; make the last point equal to the first"
            )
        return self

    def track(self) -> Track:
        """Return the displacement along the path over time, with cosine easing if `smooth`."""
        times, points = np.array(self.times), np.array(self.points)
        if self.smooth:
            times, points = ease(times, points)
        period = self.times[-1] if self.repeat else 0.0
        return Track(to_keys(times, points), origin=self.start, period=period)

    def gentler(self) -> dict[str, Any]:
        """Return new field values that double the duration of the motion along the path."""
        return {"times": [2 * time for time in self.times]}


class Swing(Motion):
    """A sinusoidal displacement, for example of a shaking base."""

    kind: Literal["swing"] = "swing"
    amplitude: Position = (0.0, 0.05, 0.0)
    """Largest displacement [m]."""
    frequency: float = Field(default=2.0, ge=1e-5, le=1e4)
    """Frequency of the oscillation [Hz]."""

    def track(self) -> Track:
        """Return the displacement over one period, which is repeated and starts at zero."""
        sine = Sine(frequency=self.frequency)
        times, factors = sine.table()
        return Track(
            to_keys(times, np.outer(factors, self.amplitude)), origin=self.start, period=sine.period
        )

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the frequency."""
        return {"frequency": self.frequency / 2}


class Free(Section):
    """Free motion of a rigid solid under gravity and in contact with other bodies."""

    kind: Literal["free"] = "free"
    density: float = Field(default=1000.0, ge=1, le=1e5)
    """Mass per volume [kg/m^3]."""


AnyMotion = Annotated[Path | Swing, Field(discriminator="kind")]
OwnMotion = Annotated[Path | Swing | Free, Field(discriminator="kind")]
"""The kinds of motion that a rigid object of a scene may have."""


def to_keys(times: np.ndarray, points: np.ndarray) -> tuple[Key, ...]:
    """Return the (time, displacement) pairs of a track from times [N], s, and points [N,3], m."""
    return tuple(
        (t, (x, y, z)) for t, (x, y, z) in zip(times.tolist(), points.tolist(), strict=True)
    )


def ease(times: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Divide each motion between points into `EASE` segments with a smooth start and stop."""
    parts = np.linspace(0, 1, EASE + 1)[1:]
    fractions = (1 - np.cos(math.pi * parts)) / 2
    new_times, new_points = [times[0]], [points[0]]
    for a, b in itertools.pairwise(range(len(times))):
        new_times += list(times[a] + parts * (times[b] - times[a]))
        new_points += list(points[a] + fractions[:, None] * (points[b] - points[a]))
    return np.array(new_times), np.array(new_points)
