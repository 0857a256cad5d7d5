"""Base class of all forces, and functions that turn forces into stages of a substep."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.errors import InputError
from phy124.kernels import forces as kernels
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import FOREVER, AnyProfile, Constant, Over, Track, Tracks
from phy124.schema.bounds import LONGEST, Name
from phy124.schema.region import Region, Vector
from phy124.schema.section import Section, omit_default


class Force(Section):
    """Base class of all forces. A force acts on a region of the body from time `start` to `end`."""

    sudden: ClassVar[bool] = False
    """Whether the force may change velocities abruptly even if its strength is small."""
    in_newtons: ClassVar[bool] = False
    """Whether the force's vector is a force on each particle [N] instead of an acceleration
    [m/s^2].
    """
    strengths: ClassVar[tuple[str, ...]] = ()
    """Names of the fields that determine the strength of the force."""
    speeds: ClassVar[tuple[str, ...]] = ()
    """Names of the fields that prescribe a velocity."""
    totals: ClassVar[tuple[str, ...]] = ()
    """Names of the fields that are sums over all particles on which the force acts."""
    joins: ClassVar[bool] = False
    """Whether the force accelerates the whole body uniformly if no region is set."""

    start: float = Field(default=0.0, ge=0, le=LONGEST)
    """Time at which the force starts to act [s]."""
    end: float | None = Field(default=None, gt=0, le=LONGEST, examples=[0.5])
    """Time at which the force stops acting [s]. Default: never."""
    region: Region | None = None
    """The force acts on the particles that are in this region at rest. Default: all particles."""
    object: Name | None = omit_default(None, examples=["object"])
    """Name of the object on which the force acts. Default: all objects."""
    profile: AnyProfile = Constant()
    """How the strength of the force varies over time: constant, ramp, sine or keyframes."""

    @model_validator(mode="after")
    def _check_times(self) -> Force:
        if self.end is not None and self.start >= self.end:
            raise ValueError(
                f"start {self.start} s must be before end {self.end} s; set a later end"
            )
        return self

    @property
    def idle(self) -> bool:
        """Whether the strength is zero; always False for wind, because still air slows objects."""
        strengths = [getattr(self, name) for name in self.strengths]
        return bool(strengths) and not np.any(strengths)

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the force's strength or prescribed speed."""
        values = {name: getattr(self, name) for name in (*self.strengths, *self.speeds)}
        return {
            name: [x / 2 for x in value] if isinstance(value, tuple) else value / 2
            for name, value in values.items()
        }

    @property
    def uniform(self) -> bool:
        """Whether the grid update adds the force, so that no separate kernel launch is needed."""
        return self.joins and self.region is None and self.object is None

    @property
    def varies(self) -> bool:
        """Whether the strength changes over time."""
        return self.start > 0 or self.end is not None or self.profile.kind != "constant"

    def track(self, value: Vector, *, mean: bool = True) -> Track:
        """Return the force over time: `value` times the profile from `start` to `end`, else zero.

        If `mean` is set, a substep uses the track's mean over the substep, not its current value.
        """
        end = FOREVER if self.end is None else self.end
        return Track.of_profile(value, self.profile, self.start, end, mean=mean)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that the force adds to a substep; none for a uniform acceleration."""
        raise NotImplementedError

    def mass_in(self, model: Model) -> float:
        """Return the movable mass of a model on which the force acts [kg]."""
        if self.object is not None and self.object not in model.names:
            return 0.0
        share = self.shares(model.rest) * (model.moves & of_object(model, self.object))
        return float(share @ np.asarray(model.mass.numpy(), np.float64)) + self.free_mass_in(model)

    def free_mass_in(self, model: Model) -> float:
        """Return the mass of the free solids of a model on which the force acts [kg]."""
        return model.free_mass if self.uniform else 0.0

    def shares(self, rest: NDArray) -> NDArray[np.float64]:
        """Return the weight of the force on each particle, 0 to 1 [P]; `rest` [P,3] are rest
        positions [m].
        """
        inside = np.ones(len(rest)) if self.region is None else self.region.contains(rest)
        return np.asarray(inside, np.float64)

    def in_part(self, part: Model, whole: Model) -> Force | None:
        """Return the force for one part of a divided model; None if the force does not act there.

        A sum over particles, such as a total force, is multiplied by the part's mass divided by the
        model's mass. A uniform acceleration acts in every part.
        """
        if self.uniform and not self.totals:
            return self
        total = self.mass_in(whole)
        share = self.mass_in(part) / total if total > 0 else 1.0
        if share in (0.0, 1.0) or not self.totals:
            return self if share > 0 else None
        values = {name: getattr(self, name) for name in self.totals}
        part_of = {
            name: tuple(share * x for x in value) if isinstance(value, tuple) else share * value
            for name, value in values.items()
        }
        return self.model_copy(update=part_of)

    def chosen(self, model: Model, field: str = "forces.region") -> wp.array:
        """Return the indices of the movable particles in the force's region.

        `field` is the path of the region in the scene, for messages.

        Raises:
            InputError: The region contains no particle.
        """
        x = model.rest
        inside = model.moves if self.region is None else self.region.contains(x) & model.moves
        inside = inside & of_object(model, self.object)
        if not inside.any():
            raise InputError(
                field,
                self.region,
                "it holds no particle.",
                "Enlarge the region, or move it onto the object's initial position.",
            )
        return wp.array(np.flatnonzero(inside).astype(np.int32), device=model.device)


def of_object(model: Model, name: str | None) -> NDArray[np.bool_]:
    """Return a mask [P] of the particles of the named object; None: of all objects."""
    mask = np.zeros(len(model), bool)
    mask[model.named(name)] = True
    return mask


def accelerate(force: Force, a: Vector, model: Model, state: State, tracks: Tracks) -> list[Stage]:
    """Return the stages of a substep that accelerate the chosen particles.

    A uniform acceleration has no stage, because the grid update adds this acceleration.

    Args:
        force: The force, with its region and its strength over time.
        a: Acceleration at full strength [m/s^2].
        model: The constants of the run.
        state: The particles, whose velocities change.
        tracks: The tracks to which the strength is added.
    """
    if force.uniform:
        tracks.accelerate(force.track(a))
        return []
    return push(force, a, model, state, tracks)


def push(force: Force, value: Vector, model: Model, state: State, tracks: Tracks) -> list[Stage]:
    """Return the stage that accelerates the chosen particles or applies a force to each.

    Args:
        force: The force, with its region and its strength over time.
        value: Acceleration [m/s^2] or force on each particle [N] at full strength.
        model: The constants of the run.
        state: The particles, whose velocities change.
        tracks: The tracks to which the strength is added.
    """
    kernel = kernels.make_accelerate(model.real, force.in_newtons)
    name = "particle_force" if force.in_newtons else "region_force"
    track, inputs = force.track(value), [model.mass]
    return stage(force, name, kernel, track, inputs, model, state, tracks)


def per_mass(force: Force, f: Vector, model: Model) -> Vector:
    """Divide a vector by the total mass of the chosen particles and the free solids."""
    chosen = np.asarray(force.chosen(model).numpy(), dtype=np.int64)
    total = float(np.take(model.mass.numpy(), chosen).sum(dtype=np.float64))
    total += force.free_mass_in(model)
    return f[0] / total, f[1] / total, f[2] / total


def stage(
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
    over: Over = "",
    limited: bool = False,
) -> list[Stage]:
    """Return a stage of the substep whose kernel changes the velocities of the chosen particles.

    Args:
        force: The force, with its region.
        name: Name of the stage in a report's list of times.
        kernel: Kernel with the arguments: chosen particles, slot of the track, `inputs`, clock,
            values of the tracks, `read`.
        track: The strength over time.
        inputs: Constant arguments of the kernel.
        model: The constants of the run.
        state: The particles, whose velocities change.
        tracks: The tracks to which the strength is added.
        read: Arrays of the state that the kernel reads.
        over: If the track's `mean` is false: the interval over which the track is averaged (the
            kick or the drift).
        limited: Whether the force has its own limit of the substep, instead of the limit from the
            track's values.
    """
    chosen = force.chosen(model)
    slot = tracks.add(track, over=over, limited=limited)

    def record(grid: Grid) -> wp.Launch | None:
        here = within(chosen, grid.run(len(model)))
        arguments = [here, slot, *inputs, tracks.clock, tracks.values, *read]
        return model.launch(kernel, len(here), arguments, [state.v])

    points = indices_of(chosen)
    return [
        Stage(
            name, record, force.sudden, force.in_newtons, keeps_C=True, by_run=True, points=points
        )
    ]


def indices_of(chosen: wp.array) -> NDArray[np.int64]:
    """Return the particle indices in an array on a device."""
    return np.asarray(chosen.numpy(), np.int64)


def within(chosen: wp.array, run: slice) -> wp.array:
    """Return the particle indices within a range, from a sorted list of indices."""
    first, last = np.searchsorted(chosen.numpy(), [run.start, run.stop]).tolist()
    return cast("wp.array", chosen[first:last])
