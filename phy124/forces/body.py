"""Forces that accelerate the whole body, or a region of the body, uniformly."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from phy124.forces.base import Force, accelerate, per_mass
from phy124.mpm import Model, Stage, State
from phy124.mpm.tracks import Track, Tracks
from phy124.schema.bounds import SHORTEST, Push
from phy124.schema.region import Vector


class Gravity(Force):
    """A uniform acceleration, downwards by default."""

    kind: Literal["gravity"] = "gravity"
    strengths: ClassVar[tuple[str, ...]] = ("g",)
    joins: ClassVar[bool] = True
    g: Push = (0.0, 0.0, -9.81)
    """Acceleration [m/s^2]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Accelerate all material uniformly, or only the chosen particles."""
        return accelerate(self, self.g, model, state, tracks)


class Acceleration(Force):
    """A uniform acceleration. Its effect does not depend on the number of particles."""

    kind: Literal["acceleration"] = "acceleration"
    strengths: ClassVar[tuple[str, ...]] = ("a",)
    joins: ClassVar[bool] = True
    a: Push = (0.0, 1.0, 0.0)
    """Acceleration [m/s^2]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Accelerate all material uniformly, or only the chosen particles."""
        return accelerate(self, self.a, model, state, tracks)


class TotalForce(Force):
    """A force in newtons on a region, distributed over the particles in proportion to mass."""

    kind: Literal["force"] = "force"
    strengths: ClassVar[tuple[str, ...]] = ("f",)
    totals: ClassVar[tuple[str, ...]] = ("f",)
    joins: ClassVar[bool] = True
    f: Push = (0.0, 1.0, 0.0)
    """Total force [N]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Accelerate the region by the force divided by the region's mass."""
        return accelerate(self, per_mass(self, self.f, model), model, state, tracks)


class Impulse(Force):
    """An impact that transfers a momentum to a region, independent of the substeps and of the
    profile.
    """

    kind: Literal["impulse"] = "impulse"
    strengths: ClassVar[tuple[str, ...]] = ("p",)
    totals: ClassVar[tuple[str, ...]] = ("p",)
    joins: ClassVar[bool] = True
    p: Push = (0.0, 1.0, 0.0)
    """Total momentum that the impulse transfers [N s]."""
    duration: float = Field(default=0.01, ge=SHORTEST, le=10)
    """Duration [s]."""

    @model_validator(mode="after")
    def _whole(self) -> Impulse:
        if self.end is not None:
            raise ValueError("an impulse ends after its duration; remove `end`")
        if self.profile.period or self._mean() <= 0:
            raise ValueError(
                "the profile of an impulse must not repeat, and its mean must be positive; "
                "use constant"
            )
        return self

    @property
    def varies(self) -> bool:
        """Always True: an impulse acts for a limited time."""
        return True

    def track(self, value: Vector, *, mean: bool = True) -> Track:
        """Return the force over time: `value` times the profile during the impulse, else zero."""
        end = self.start + self.duration
        track = Track.of_profile(value, self.profile, self.start, end, mean=mean)
        # A force that starts at time 0 is also active before time 0; an impulse at time 0 is not.
        return Track(track.keys, self.start, end, track.origin, track.period, mean)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Accelerate the region by p / (m I), with mass m and time integral I of the profile."""
        x, y, z = per_mass(self, self.p, model)
        time = self.duration * self._mean()
        return accelerate(self, (x / time, y / time, z / time), model, state, tracks)

    def _mean(self) -> float:
        """Return the mean of the profile over the duration of the impulse."""
        times, factors = self.profile.table()
        inside = np.unique(np.clip(np.append(times, [0, self.duration]), 0, self.duration))
        at = np.interp(inside, times, factors)
        return float(((at[1:] + at[:-1]) / 2 * np.diff(inside)).sum()) / self.duration
