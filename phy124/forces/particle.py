"""Forces that act on individual particles.

The forces are: a force in newtons, wind, attraction to a point, a push inside a zone of space, and
prescribed velocities.
"""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar, Literal

import warp as wp
from pydantic import Field, model_validator

from phy124.forces.base import Force, indices_of, push, stage, within
from phy124.kernels import forces as kernels
from phy124.kernels.arguments import types
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Position, Push, Velocity
from phy124.schema.region import Region, Vector, cylinder


class ParticleForce(Force):
    """The external force of the Phy124 paper (sec. 3.2), in newtons on each particle: a = f / m."""

    kind: Literal["particle_force"] = "particle_force"
    strengths: ClassVar[tuple[str, ...]] = ("f",)
    in_newtons: ClassVar[bool] = True
    f: Push = (0.0, 1e-3, 0.0)
    """Force on each particle [N]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stage that applies the force to each chosen particle."""
        return push(self, self.f, model, state, tracks)


class Wind(Force):
    """A stream of air or water that carries particles along: a = rate (wind - v)."""

    kind: Literal["wind"] = "wind"
    speeds: ClassVar[tuple[str, ...]] = ("v",)
    v: Velocity = (0.0, 3.0, 0.0)
    """Velocity of the stream [m/s]."""
    rate: float = Field(default=1.0, ge=1e-6, le=1e6)
    """Rate at which particles approach the stream's velocity [1/s]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stage that accelerates the chosen particles towards the stream's velocity."""
        track = self.track(self.v, mean=False)
        kernel, inputs = kernels.make_drag(model.real), [self.rate]
        (drag,) = stage(
            self, "wind", kernel, track, inputs, model, state, tracks, over="kick", limited=True
        )

        def limit(start: float, end: float) -> float:
            """Return the largest acceleration of a particle at rest in the stream [m/s^2]."""
            return self.rate * track.largest(start, end)

        return [drag._replace(limit=limit, top_speed=track.largest)]


class Attraction(Force):
    """A point that attracts or repels material. The acceleration is proportional to the distance d
    up to `radius`, and to 1 / d^2 beyond it.
    """

    kind: Literal["attraction"] = "attraction"
    strengths: ClassVar[tuple[str, ...]] = ("g",)
    centre: Position = (0.0, 0.0, 1.0)
    """Position of the attracting point [m]."""
    g: float = Field(default=10.0, ge=-1e9, le=1e9)
    """Acceleration at the distance `radius` from the point [m/s^2]; a negative value repels."""
    radius: float = Field(default=0.5, ge=1e-6, le=1e5)
    """Distance from the point at which the acceleration is largest [m]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stage that pulls the chosen particles towards the point."""
        track = self.track((self.g, 0.0, 0.0))
        inputs = [types(model.real).vec3(*self.centre), self.radius]
        kernel, read = kernels.make_attract(model.real), [state.x]
        return stage(self, "attraction", kernel, track, inputs, model, state, tracks, read=read)


class ZoneForce(Force):
    """A push on all material that is currently inside a zone of space."""

    kind: Literal["zone"] = "zone"
    strengths: ClassVar[tuple[str, ...]] = ("a",)
    place: Region = Region()
    """Region of space in which the force acts."""
    a: Push = (0.0, 1.0, 0.0)
    """Acceleration [m/s^2]."""

    @model_validator(mode="after")
    def _everything(self) -> ZoneForce:
        if self.region is not None:
            raise ValueError("a zone acts on all material inside it; remove `region`")
        return self

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that push the particles inside the zone."""
        t = types(model.real)
        slot, kernel = tracks.add(self.track(self.a)), kernels.make_zone(model.real)
        place: list[Any] = [t.vec3(*self.place.lower), t.vec3(*self.place.upper), -1, 0.0]
        if self.place.cylinder:
            place[2], _, place[3] = cylinder(
                self.place.lower, self.place.upper, self.place.cylinder
            )

        def record(grid: Grid, particles: slice) -> wp.Launch | None:
            run = grid.run(len(model))
            run = slice(max(run.start, particles.start), min(run.stop, particles.stop))
            if run.stop <= run.start:
                return None
            inputs = [*place, slot, tracks.clock, tracks.values, state.x[run]]
            return model.launch(kernel, run.stop - run.start, inputs, [state.v[run]])

        wanted = model.named(self.object)
        moving = [model.particles(b) for b in range(model.bodies) if b not in model.held]
        # Like all forces, this one skips bodies that never move.
        runs = [run for run in moving if wanted.start <= run.start and run.stop <= wanted.stop]
        recorders = [partial(record, particles=run) for run in (runs if model.held else [wanted])]
        return [Stage("zone", recorder, keeps_C=True, by_run=True) for recorder in recorders]


UNIT: Vector = (1.0, 0.0, 0.0)
"""Arbitrary direction of a track. `SetVelocity` uses only the track's strength over time."""


class SetVelocity(Force):
    """Prescribes the velocities of particles (the first kind of force in the Phy124 paper)."""

    kind: Literal["set_velocity"] = "set_velocity"
    sudden: ClassVar[bool] = True
    speeds: ClassVar[tuple[str, ...]] = ("v", "spin")
    v: Velocity = (0.0, 0.0, 0.0)
    """Velocity [m/s]."""
    spin: Velocity = (0.0, 0.0, 0.0)
    """Angular velocity [rad/s]."""
    centre: Position = (0.0, 0.0, 0.0)
    """Point on the axis of rotation [m]."""

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stage that sets the velocity v and the matrix C of the chosen particles."""
        t = types(model.real)
        slot = tracks.add(self.track(UNIT, mean=False), over="drift")
        chosen = self.chosen(model)
        kernel = kernels.make_set_velocity(model.real)
        motion = [t.vec3(*self.v), t.vec3(*self.centre), t.vec3(*self.spin)]

        def record(grid: Grid) -> wp.Launch | None:
            here = within(chosen, grid.run(len(model)))
            inputs = [here, slot, *motion, tracks.values, state.x]
            return model.launch(kernel, len(here), inputs, [state.v, state.C])

        points = indices_of(chosen)
        return [Stage("set_velocity", record, self.sudden, by_run=True, points=points)]
