"""Forces a scene can name: how each pushes particles or the whole body.

A force is its own section of the scene file. `attach` adds what it needs to a solver: a track that
holds its strength over time and, if it acts on chosen particles, one stage of the substep.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import warp as wp
from pydantic import BaseModel, ConfigDict, Field, model_validator

from phy124.kernels import push
from phy124.kernels.transfer import types
from phy124.region import Region, Vector
from phy124.tracks import Track

if TYPE_CHECKING:
    from phy124.mpm import Solver, Stage


class Force(BaseModel):
    """What all forces have: a window in time and an optional region of particles at rest."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    start: float = Field(default=0.0, ge=0, description="Acts from here on [s].")
    end: float | None = Field(
        default=None, gt=0, description="Acts until here [s]; absent: always."
    )
    region: Region | None = Field(default=None, description="Particles it acts on; all if absent.")

    @model_validator(mode="after")
    def _ordered(self) -> Force:
        if self.end is not None and self.start >= self.end:
            raise ValueError(f"start {self.start} s must be before end {self.end} s")
        return self

    def track(self, value: Vector) -> Track:
        """The value inside the window of time, nothing outside."""
        if self.start == 0 and self.end is None:
            return Track.constant(value)
        return Track.window(value, self.start, math.inf if self.end is None else self.end)

    def chosen(self, solver: Solver) -> wp.array:
        """Indices of the particles it acts on; raises ValueError if the region is empty."""
        x = solver.rest
        inside = np.ones(len(x), bool) if self.region is None else self.region.contains(x)
        if not inside.any():
            raise ValueError(f"the region of {type(self).__name__} holds no particle")
        return wp.array(np.flatnonzero(inside).astype(np.int32), device=solver.device)


class Gravity(Force):
    """The same acceleration everywhere, downwards by default."""

    kind: Literal["gravity"] = "gravity"
    g: Vector = Field(default=(0.0, 0.0, -9.81), description="Acceleration [m/s^2].")

    def attach(self, solver: Solver) -> list[Stage]:
        """Add to the uniform acceleration, or push chosen particles."""
        return _accelerate(self, self.g, solver)


class Acceleration(Force):
    """A push per mass: what presets use, since it does not depend on the particle count."""

    kind: Literal["acceleration"] = "acceleration"
    a: Vector = Field(default=(0.0, 1.0, 0.0), description="Acceleration [m/s^2].")

    def attach(self, solver: Solver) -> list[Stage]:
        """Add to the uniform acceleration, or push chosen particles."""
        return _accelerate(self, self.a, solver)


class TotalForce(Force):
    """A force in newtons on a region, spread over its particles by mass."""

    kind: Literal["force"] = "force"
    f: Vector = Field(default=(0.0, 1.0, 0.0), description="Total force [N].")

    def attach(self, solver: Solver) -> list[Stage]:
        """Accelerate the region by f over its mass."""
        total = float(solver.mass.numpy()[self.chosen(solver).numpy()].sum(dtype=np.float64))
        x, y, z = (component / total for component in self.f)
        return _accelerate(self, (x, y, z), solver)


class ParticleForce(Force):
    """The paper's external force: newtons on each particle, a = f / m (Phy124, sec. 3.2)."""

    kind: Literal["particle_force"] = "particle_force"
    f: Vector = Field(default=(0.0, 1e-3, 0.0), description="Force on each particle [N].")

    def attach(self, solver: Solver) -> list[Stage]:
        """Push each chosen particle."""
        return _push(self, self.f, solver, per_mass=True)


class SetVelocity(Force):
    """The paper's first kind of force: the velocity of particles is prescribed."""

    kind: Literal["set_velocity"] = "set_velocity"
    v: Vector = Field(default=(0.0, 0.0, 0.0), description="Velocity [m/s].")
    spin: Vector = Field(default=(0.0, 0.0, 0.0), description="Angular velocity [rad/s].")
    centre: Vector = Field(default=(0.0, 0.0, 0.0), description="Point the spin is about [m].")

    def attach(self, solver: Solver) -> list[Stage]:
        """Overwrite v and C of the chosen particles while active."""
        t, tracks, state = types(solver.real), solver.tracks, solver.state
        slot, chosen = tracks.add(self.track(self.v)), self.chosen(solver)
        kernel = push.make_set_velocity(solver.real)

        def record() -> wp.Launch:
            inputs = [
                chosen,
                slot,
                t.vec3(*self.centre),
                t.vec3(*self.spin),
                state.x,
                tracks.values,
            ]
            return solver.record(kernel, len(chosen), inputs, [state.v, state.C])

        return [("set_velocity", record)]


AnyForce = Annotated[
    Gravity | Acceleration | TotalForce | ParticleForce | SetVelocity, Field(discriminator="kind")
]


def _accelerate(force: Force, a: Vector, solver: Solver) -> list[Stage]:
    """A uniform acceleration joins the grid update; one on a region needs its own launch."""
    if force.region is None:
        solver.tracks.accelerate(force.track(a))
        return []
    return _push(force, a, solver, per_mass=False)


def _push(force: Force, value: Vector, solver: Solver, *, per_mass: bool) -> list[Stage]:
    tracks, chosen = solver.tracks, force.chosen(solver)
    slot = tracks.add(force.track(value))
    kernel = push.make_accelerate(solver.real, per_mass)

    def record() -> wp.Launch:
        inputs = [chosen, slot, solver.mass, solver.clock, tracks.values]
        return solver.record(kernel, len(chosen), inputs, [solver.state.v])

    return [("particle_force" if per_mass else "region_force", record)]
