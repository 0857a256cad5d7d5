"""Forces a scene can name: how each of them pushes particles or the whole body.

A force is its own section of the scene file. `attach` adds what it needs to a run: a track that
holds its strength over time and, if it acts on chosen particles, one stage of the substep.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, cast

import numpy as np
import warp as wp
from pydantic import Field, SerializeAsAny, model_validator

from phy124.bounds import LONGEST, SHORTEST, Position, Push, Velocity
from phy124.errors import InputError
from phy124.kernels import push
from phy124.kernels.transfer import types
from phy124.mpm import Grid, Model, Stage, State
from phy124.plugins import OpenTo
from phy124.region import Region, Vector, cylinder
from phy124.section import Section
from phy124.tracks import FOREVER, AnyProfile, Constant, Track, Tracks

UNIT: Vector = (1.0, 0.0, 0.0)
"""Value of a track that holds nothing but the profile."""


class Force(Section):
    """Base class of all forces: a profile within a window of time, and a region of the body."""

    sudden: ClassVar[bool] = False
    """Whether it may change a velocity abruptly, whatever its strength."""
    in_newtons: ClassVar[bool] = False
    """Whether its track is a force on each particle [N] and not an acceleration [m/s^2]."""
    strengths: ClassVar[tuple[str, ...]] = ()
    """The fields that set its strength."""
    joins: ClassVar[bool] = False
    """Whether, without a region, it is a uniform acceleration of the whole body."""

    start: float = Field(default=0.0, ge=0, le=LONGEST, description="Acts from here on [s].")
    end: float | None = Field(
        default=None,
        gt=0,
        le=LONGEST,
        examples=[0.5],
        description="Time at which it stops acting [s]; absent: never.",
    )
    region: Region | None = Field(
        default=None, description="Particles it acts on, by rest position; all if absent."
    )
    profile: AnyProfile = Field(
        default=Constant(), description="Its strength over time: constant, ramp, sine, keyframes."
    )

    @model_validator(mode="after")
    def _ordered(self) -> Force:
        if self.end is not None and self.start >= self.end:
            raise ValueError(
                f"start {self.start} s must be before end {self.end} s; let it end later"
            )
        return self

    @property
    def idle(self) -> bool:
        """Whether its strength is zero, so that it never pushes; wind of zero speed still drags."""
        strengths = [getattr(self, name) for name in self.strengths]
        return bool(strengths) and not np.any(strengths)

    def gentler(self) -> dict[str, Any]:
        """Its fields with values that push half as hard."""
        values = {name: getattr(self, name) for name in self.strengths}
        return {
            name: [x / 2 for x in value] if isinstance(value, tuple) else value / 2
            for name, value in values.items()
        }

    @property
    def uniform(self) -> bool:
        """Whether it joins the grid update, which costs no launch of its own."""
        return self.joins and self.region is None

    @property
    def varies(self) -> bool:
        """Whether its strength changes over time."""
        return self.start > 0 or self.end is not None or self.profile.kind != "constant"

    def track(self, value: Vector, *, mean: bool = True) -> Track:
        """The value times the profile inside the window of time, zero outside.

        Args:
            value: The force at full strength, in its own units.
            mean: Whether each substep reads the mean over its duration instead of one instant.
        """
        end = FOREVER if self.end is None else self.end
        return Track.scaled(value, self.profile, self.start, end, mean=mean)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """The stages it needs in each substep; none if it joins the uniform acceleration.

        Args:
            model: What stays the same during the run.
            state: The particles' positions, velocities and so on, which its launches change.
            tracks: Where it registers what changes over time.
        """
        raise NotImplementedError

    def chosen(self, model: Model) -> wp.array:
        """Indices of the particles it acts on.

        Raises:
            InputError: The region holds no particle.
        """
        x = model.rest
        inside = np.ones(len(x), bool) if self.region is None else self.region.contains(x)
        if not inside.any():
            raise InputError(
                "forces.region", self.region,
                f"the region of {type(self).__name__} holds no particle.",
                "Make it larger, or move it onto the object as it stands at the start.",
            )  # fmt: skip
        return wp.array(np.flatnonzero(inside).astype(np.int32), device=model.device)


class Gravity(Force):
    """The same acceleration everywhere, downwards by default."""

    kind: Literal["gravity"] = "gravity"
    strengths: ClassVar[tuple[str, ...]] = ("g",)
    joins: ClassVar[bool] = True
    g: Push = Field(default=(0.0, 0.0, -9.81), description="Acceleration [m/s^2].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Add to the uniform acceleration, or push chosen particles."""
        return _accelerate(self, self.g, model, state, tracks)


class Acceleration(Force):
    """An acceleration; the presets use it, since it does not depend on the particle count."""

    kind: Literal["acceleration"] = "acceleration"
    strengths: ClassVar[tuple[str, ...]] = ("a",)
    joins: ClassVar[bool] = True
    a: Push = Field(default=(0.0, 1.0, 0.0), description="Acceleration [m/s^2].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Add to the uniform acceleration, or push chosen particles."""
        return _accelerate(self, self.a, model, state, tracks)


class TotalForce(Force):
    """A force in newtons on a region, spread over its particles by mass."""

    kind: Literal["force"] = "force"
    strengths: ClassVar[tuple[str, ...]] = ("f",)
    joins: ClassVar[bool] = True
    f: Push = Field(default=(0.0, 1.0, 0.0), description="Total force [N].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Accelerate the region by f divided by its mass."""
        return _accelerate(self, _per_mass(self, self.f, model), model, state, tracks)


class Impulse(Force):
    """A blow: gives a region a total momentum, whatever the substeps and the profile are."""

    kind: Literal["impulse"] = "impulse"
    strengths: ClassVar[tuple[str, ...]] = ("p",)
    joins: ClassVar[bool] = True
    p: Push = Field(default=(0.0, 1.0, 0.0), description="Total momentum it gives [N s].")
    duration: float = Field(default=0.01, ge=SHORTEST, le=10, description="Time it takes [s].")

    @model_validator(mode="after")
    def _whole(self) -> Impulse:
        if self.end is not None:
            raise ValueError("an impulse ends after its duration; leave end out")
        if self.profile.period or self._mean() <= 0:
            raise ValueError(
                "the profile of an impulse must not repeat, and its mean must be positive; "
                "use constant"
            )
        return self

    @property
    def varies(self) -> bool:
        """Always true, since it ends."""
        return True

    def track(self, value: Vector, *, mean: bool = True) -> Track:
        """The value times the profile over its duration, zero outside."""
        end = self.start + self.duration
        track = Track.scaled(value, self.profile, self.start, end, mean=mean)
        # A force that starts at time 0 counts as having acted before; a blow at time 0 does not.
        return Track(track.keys, self.start, end, track.origin, track.period, mean)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Accelerate the region by p divided by its mass and by the profile's integral."""
        x, y, z = _per_mass(self, self.p, model)
        time = self.duration * self._mean()
        return _accelerate(self, (x / time, y / time, z / time), model, state, tracks)

    def _mean(self) -> float:
        """Mean of the profile over the duration."""
        times, factors = self.profile.table()
        inside = np.unique(np.clip(np.append(times, [0, self.duration]), 0, self.duration))
        at = np.interp(inside, times, factors)
        return float(((at[1:] + at[:-1]) / 2 * np.diff(inside)).sum()) / self.duration


class ParticleForce(Force):
    """The paper's external force: newtons on each particle, a = f / m (Phy124, sec. 3.2)."""

    kind: Literal["particle_force"] = "particle_force"
    strengths: ClassVar[tuple[str, ...]] = ("f",)
    in_newtons: ClassVar[bool] = True
    f: Push = Field(default=(0.0, 1e-3, 0.0), description="Force on each particle [N].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Push each chosen particle."""
        return _push(self, self.f, model, state, tracks)


class ZoneForce(Force):
    """A push in a zone of space: it acts on whatever is inside at the moment."""

    kind: Literal["zone"] = "zone"
    strengths: ClassVar[tuple[str, ...]] = ("a",)
    place: Region = Field(default=Region(), description="Where in space it acts.")
    a: Push = Field(default=(0.0, 1.0, 0.0), description="Acceleration [m/s^2].")

    @model_validator(mode="after")
    def _everything(self) -> ZoneForce:
        if self.region is not None:
            raise ValueError("a zone acts on whatever is inside it; leave region out")
        return self

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Push what is inside."""
        t = types(model.real)
        slot, kernel = tracks.add(self.track(self.a)), push.make_zone(model.real)
        place: list[Any] = [t.vec3(*self.place.lower), t.vec3(*self.place.upper), -1, 0.0]
        if self.place.cylinder:
            place[2], _, place[3] = cylinder(
                self.place.lower, self.place.upper, self.place.cylinder
            )

        def record(grid: Grid) -> wp.Launch | None:
            run = grid.run(len(model))
            inputs = [*place, slot, tracks.clock, tracks.values, state.x[run]]
            return model.launch(kernel, run.stop - run.start, inputs, [state.v[run]])

        return [Stage("zone", record, by_run=True)]


class Wind(Force):
    """Air or water that streams past and drags particles along: a = rate (wind - v)."""

    kind: Literal["wind"] = "wind"
    sudden: ClassVar[bool] = True
    v: Velocity = Field(default=(0.0, 3.0, 0.0), description="Velocity of the stream [m/s].")
    rate: float = Field(
        default=1.0,
        ge=1e-6,
        le=1e6,
        description="Fraction of the difference lost per second [1/s].",
    )

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Drag the chosen particles along."""
        track = self.track(self.v, mean=False)
        kernel, inputs = push.make_drag(model.real), [self.rate]
        return _stage(self, "wind", kernel, track, inputs, model, state, tracks)


class Attraction(Force):
    """A point that attracts, or repels if negative: linear inside its radius, 1 / d^2 outside."""

    kind: Literal["attraction"] = "attraction"
    strengths: ClassVar[tuple[str, ...]] = ("g",)
    centre: Position = Field(default=(0.0, 0.0, 1.0), description="The point [m].")
    g: float = Field(
        default=10.0, ge=-1e9, le=1e9, description="Acceleration at the radius [m/s^2]."
    )
    radius: float = Field(default=0.5, ge=1e-6, le=1e5, description="Distance of the maximum [m].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Pull the chosen particles towards the point."""
        track = self.track((self.g, 0.0, 0.0))
        inputs = [types(model.real).vec3(*self.centre), self.radius]
        kernel, read = push.make_attract(model.real), [state.x]
        return _stage(self, "attraction", kernel, track, inputs, model, state, tracks, read=read)


class SetVelocity(Force):
    """The paper's first kind of force: the velocity of particles is prescribed."""

    kind: Literal["set_velocity"] = "set_velocity"
    sudden: ClassVar[bool] = True
    v: Velocity = Field(default=(0.0, 0.0, 0.0), description="Velocity [m/s].")
    spin: Velocity = Field(default=(0.0, 0.0, 0.0), description="Angular velocity [rad/s].")
    centre: Position = Field(default=(0.0, 0.0, 0.0), description="Point the spin is about [m].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Overwrite v and C of the chosen particles while active."""
        t = types(model.real)
        slot, chosen = tracks.add(self.track(UNIT, mean=False)), self.chosen(model)
        kernel = push.make_set_velocity(model.real)
        motion = [t.vec3(*self.v), t.vec3(*self.centre), t.vec3(*self.spin)]

        def record(grid: Grid) -> wp.Launch | None:
            own = _within(chosen, grid.run(len(model)))
            inputs = [own, slot, *motion, tracks.values, state.x]
            return model.launch(kernel, len(own), inputs, [state.v, state.C])

        return [Stage("set_velocity", record, self.sudden, by_run=True)]


OwnForce = (
    Gravity
    | Acceleration
    | TotalForce
    | Impulse
    | ParticleForce
    | ZoneForce
    | Wind
    | Attraction
    | SetVelocity
)
"""The forces that phy124 has."""
AnyForce = SerializeAsAny[
    Annotated[OwnForce, Field(discriminator="kind"), OpenTo(Force, "kind", "forces", OwnForce)]
]
"""One of them, or one from outside (phy124/plugins.py)."""


def _per_mass(force: Force, f: Vector, model: Model) -> Vector:
    """A vector divided by the total mass of the chosen particles."""
    chosen = np.asarray(force.chosen(model).numpy(), dtype=np.int64)
    total = float(np.take(model.mass.numpy(), chosen).sum(dtype=np.float64))
    return f[0] / total, f[1] / total, f[2] / total


def _accelerate(force: Force, a: Vector, model: Model, state: State, tracks: Tracks) -> list[Stage]:
    """A uniform acceleration joins the grid update; one on a region needs its own launch."""
    if force.uniform:
        tracks.accelerate(force.track(a))
        return []
    return _push(force, a, model, state, tracks)


def _push(force: Force, value: Vector, model: Model, state: State, tracks: Tracks) -> list[Stage]:
    kernel = push.make_accelerate(model.real, force.in_newtons)
    name = "particle_force" if force.in_newtons else "region_force"
    track, inputs = force.track(value), [model.mass]
    return _stage(force, name, kernel, track, inputs, model, state, tracks)


def _stage(
    force: Force,
    name: str,
    kernel: Any,
    track: Track,
    inputs: list,
    model: Model,
    state: State,
    tracks: Tracks,
    *,
    read: Sequence[wp.array] = (),
) -> list[Stage]:
    """One launch over the chosen particles that reads a track and changes velocities.

    `inputs` of the kernel are constant, `read` is of the state.
    """
    chosen = force.chosen(model)
    slot = tracks.add(track)

    def record(grid: Grid) -> wp.Launch | None:
        own = _within(chosen, grid.run(len(model)))
        given = [own, slot, *inputs, tracks.clock, tracks.values, *read]
        return model.launch(kernel, len(own), given, [state.v])

    return [Stage(name, record, force.sudden, force.in_newtons, by_run=True)]


def _within(chosen: wp.array, run: slice) -> wp.array:
    """Those of the chosen particles, which are in order, that are in a run of them."""
    first, last = np.searchsorted(chosen.numpy(), [run.start, run.stop]).tolist()
    return cast("wp.array", chosen[first:last])
