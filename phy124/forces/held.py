"""Forces on a part of an object: the particles in a ball when the object is at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.errors import InputError
from phy124.forces.base import Force, indices_of, of_object
from phy124.kernels import forces as kernels
from phy124.kernels.reduction import shared_out
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import FOREVER, Track, Tracks, check_times
from phy124.schema.bounds import Instant, Position, Push
from phy124.schema.region import Vector


def weights(rest: NDArray, point: Vector | None, radius: float) -> NDArray[np.float64]:
    """Return the weight of each particle in the part of the object on which a force acts [P].

    At the distance d from `point` [m], the weight is (1 - (d / radius)^2)^2. If `point` is None,
    the part is the whole body, and all weights are 1.
    """
    if point is None:
        return np.ones(len(rest))
    ratio = np.linalg.norm(rest - np.array(point), axis=1) / radius
    weight: NDArray[np.float64] = np.where(ratio < 1, (1 - ratio**2) ** 2, 0.0)
    return weight


class Part(NamedTuple):
    """The particles in a part of an object on which a force acts, with arrays for sums."""

    chosen: wp.array
    share: wp.array
    """Each particle's fraction of the force on the part, w m / sum(w m), in float64."""
    per_force: wp.array
    """Acceleration of each particle if a force of 1 N acts on the part [1/kg]."""
    means: wp.array
    second: wp.array
    mass: float
    """Weighted mass of the part: the sum of w m [kg]."""
    drawn: float
    """Effective mass of the part at the start [kg]: force divided by acceleration of the centre;
    NaN unless a grab pulls the part.
    """
    reach: float
    """Distance between the centre of the part and its farthest particle, at rest [m]."""
    inertia: float
    """Smallest moment of inertia of the part about the part's centre, at rest [kg m^2]."""

    @classmethod
    def of(
        cls,
        model: Model,
        point: Vector | None,
        radius: float,
        field: str,
        name: str | None = None,
        *,
        pulled: bool = True,
    ) -> Part:
        """Return the part of an object that is within a radius of a point at rest.

        Args:
            model: The model, with masses and positions at rest.
            point: Centre of the part [m]; None: the whole body.
            radius: Radius of the part [m].
            field: Name of the point's field in the scene, for messages.
            name: Name of the object; None: the part may belong to any object.
            pulled: Whether a grab pulls the part, so that `drawn` is needed.

        Raises:
            InputError: The part contains no particle.
        """
        weight = weights(model.rest, point, radius) * of_object(model, name)
        index = np.flatnonzero(weight * model.moves)
        if not len(index):
            away = float(np.linalg.norm(model.rest - np.array(point), axis=1).min())
            raise InputError(
                field,
                point,
                f"at rest, no material is within {radius:g} m of this point.",
                f"Choose a point on the object in its initial position (the nearest material is "
                f"{away:.3g} m away), or a larger radius.",
            )
        weight, device = weight[index], model.device
        mass = weight * model.mass.numpy()[index].astype(np.float64)
        total = float(mass.sum())
        share = mass / total
        r = model.rest[index] - share @ model.rest[index]
        drawn = total / float(share @ weight) if pulled else math.nan
        if pulled and model.respond is not None:
            force = np.zeros(len(model))
            force[index] = share
            drawn = 1 / float(share @ model.respond(force)[index])
        second = np.einsum("p,pi,pj->ij", share, r, r)
        moments = np.trace(second) - np.linalg.eigvalsh(second)
        return cls(
            wp.array(index.astype(np.int32), device=device),
            wp.array(share, dtype=wp.float64, device=device),
            wp.array(weight / total, dtype=model.real, device=device),
            wp.zeros(2, dtype=wp.vec3d, device=device),
            wp.zeros(1, dtype=wp.mat33d, device=device),
            total,
            drawn,
            float(np.linalg.norm(r, axis=1).max()),
            total * float(max(moments.min(), 1e-6 * np.trace(second))),
        )

    @property
    def points(self) -> NDArray[np.int64]:
        """Indices of the particles."""
        return indices_of(self.chosen)

    def track_centre(
        self, name: str, slot: int, model: Model, state: State, tracks: Tracks, *, turned: bool
    ) -> Iterator[Stage]:
        """Yield the stages that compute the part's centre and the second moments about the centre.

        Args:
            name: Name of the stages in a report's list of times.
            slot: Slot of the track; nothing is computed while the track is inactive.
            model: The constants of the run.
            state: The particles' positions and velocities.
            tracks: The tracks of the run.
            turned: Whether to compute second moments.
        """
        real, (count, *parted) = model.real, shared_out(len(self.chosen), model.device)

        def forget(grid: Grid) -> wp.Launch | None:
            return model.launch(kernels.forget, 1, [], [self.means, self.second])

        def centre(grid: Grid) -> wp.Launch | None:
            read = [*parted, self.chosen, self.share, slot, tracks.values, state.x, state.v]
            return model.launch(kernels.make_centre(real), count, read, [self.means])

        def second(grid: Grid) -> wp.Launch | None:
            read = [*parted, self.chosen, self.share, slot, tracks.values, state.x, self.means]
            return model.launch(kernels.make_second(real), count, read, [self.second])

        for record in (forget, centre, *([second] if turned else [])):
            yield Stage(name, record, keeps_C=True, points=self.points)


class Grab(Force):
    """A spring and a damper that pull a point of the object towards a moving target."""

    kind: Literal["grab"] = "grab"
    strengths: ClassVar[tuple[str, ...]] = ("strength",)
    totals: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "strength")
    point: Position = (0.0, 0.0, 0.5)
    """Point of the object that is pulled, at the object's rest position [m]."""
    radius: float = Field(default=0.15, ge=1e-6, le=1e5)
    """Material within this distance of the point is pulled [m]; the force decreases towards the
    rim.
    """
    times: tuple[Instant, ...] = (0.0, 1.0)
    """Times at which the target reaches the positions in `targets` [s]."""
    targets: tuple[Position, ...] = ((0.0, 0.0, 0.5), (0.0, 0.0, 1.0))
    """Positions of the target at `times` [m]."""
    stiffness: float = Field(default=1e4, ge=0, le=1e12)
    """Stiffness of the spring [N/m]."""
    damping: float = Field(default=1e3, ge=0, le=1e12)
    """Coefficient of the damper [N s/m]."""
    strength: float = Field(default=1e4, ge=0, le=1e9)
    """Largest force [N]."""

    @model_validator(mode="after")
    def _fits(self) -> Grab:
        check_times(self.times, len(self.targets), "targets")
        if self.region is not None:
            raise ValueError("a grab acts on the material within its radius; remove `region`")
        if self.profile.kind != "constant":
            raise ValueError(
                "the targets of a grab define how it varies over time; remove `profile`"
            )
        return self

    def shares(self, rest: NDArray) -> NDArray[np.float64]:
        """Return the weight of each particle [P] in the part of the object that is pulled."""
        return weights(rest, self.point, self.radius)

    @property
    def varies(self) -> bool:
        """Always True: the target moves."""
        return True

    def target(self) -> Track:
        """Return the target position over time [m]."""
        start = -FOREVER if self.start <= 0 else self.start
        end = FOREVER if self.end is None else self.end
        return Track(tuple(zip(self.times, self.targets, strict=True)), start, end, self.start)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that compute the centre of the pulled part, and pull the part."""
        part = Part.of(model, self.point, self.radius, "forces.point", self.object)
        slot = tracks.add(self.target(), limited=True)
        spring = wp.vec4d(self.stiffness, self.damping, part.drawn, self.strength)
        kernel = kernels.make_draw(model.real)

        def record(grid: Grid) -> wp.Launch | None:
            inputs = [part.chosen, part.per_force, spring, slot]
            inputs += [tracks.clock, tracks.values, tracks.rates, part.means]
            return model.launch(kernel, len(part.chosen), inputs, [state.v])

        def limit(start: float, end: float) -> float:
            return self.strength / part.mass if tracks.tracks[slot].acts(start, end) else 0.0

        stages = part.track_centre(self.kind, slot, model, state, tracks, turned=False)
        pull = Stage(self.kind, record, keeps_C=True, limit=limit, points=part.points)
        return [*stages, pull]


MARGIN = 2.0
"""Safety factor on the acceleration by a torque, because deformation may reduce the inertia."""


class WrenchForce(Force):
    """A force and a torque on the material around a point of the object, or on the whole object."""

    kind: Literal["wrench"] = "wrench"
    strengths: ClassVar[tuple[str, ...]] = ("force", "torque")
    totals: ClassVar[tuple[str, ...]] = ("force", "torque")
    force: Push = (0.0, 1.0, 0.0)
    """Force [N]."""
    torque: Push = (0.0, 0.0, 0.0)
    """Torque about the point [N m]."""
    point: Position | None = Field(default=None, examples=[[0.0, 0.0, 0.5]])
    """Point at which the wrench acts, at the object's rest position [m]. Default: it acts on the
    whole object.
    """
    radius: float = Field(default=0.15, ge=1e-6, le=1e5)
    """Material within this distance of the point is pushed [m]; the force decreases towards the
    rim.
    """

    @model_validator(mode="after")
    def _a_ball(self) -> WrenchForce:
        if self.region is not None:
            raise ValueError("a wrench acts on the material within its radius; remove `region`")
        return self

    def shares(self, rest: NDArray) -> NDArray[np.float64]:
        """Return the weight of each particle [P] in the part of the object that is pushed."""
        return weights(rest, self.point, self.radius)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that compute the part's centre, and apply the force and the torque."""
        place = self.point, self.radius, "forces.point", self.object
        part = Part.of(model, *place, pulled=False)
        push = tracks.add(self.track(self.force), limited=True)
        turn = tracks.add(self.track(self.torque), limited=True)
        turned, kernel = any(self.torque), kernels.make_wrench(model.real)

        def record(grid: Grid) -> wp.Launch | None:
            inputs = [part.chosen, part.per_force, wp.float64(part.mass), push, turn]
            inputs += [tracks.clock, tracks.values, state.x, part.means, part.second]
            return model.launch(kernel, len(part.chosen), inputs, [state.v])

        def limit(start: float, end: float) -> float:
            pushed = tracks.tracks[push].largest(start, end) / part.mass
            turning = MARGIN * part.reach / part.inertia if part.inertia else 0.0
            return pushed + turning * tracks.tracks[turn].largest(start, end)

        stage = Stage(self.kind, record, keeps_C=True, limit=limit, points=part.points)
        if not turned:
            return [stage]
        stages = part.track_centre(self.kind, turn, model, state, tracks, turned=True)
        return [*stages, stage]
