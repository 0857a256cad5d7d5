"""A force and a torque on a part of the object, or on all of it."""

from __future__ import annotations

from typing import ClassVar, Literal

import warp as wp
from pydantic import Field, model_validator

from phy124.forces.base import Force
from phy124.forces.held import Part
from phy124.kernels import held as kernels
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Position, Push

MARGIN = 2.0
"""On the acceleration by a torque: what is deformed may have a smaller moment of inertia."""


class WrenchForce(Force):
    """A force and a torque on what is about a point of the object, or on the whole of it."""

    kind: Literal["wrench"] = "wrench"
    strengths: ClassVar[tuple[str, ...]] = ("force", "torque")
    force: Push = Field(default=(0.0, 1.0, 0.0), description="Force [N].")
    torque: Push = Field(default=(0.0, 0.0, 0.0), description="Torque about the point [N m].")
    point: Position | None = Field(
        default=None,
        examples=[[0.0, 0.0, 0.5]],
        description="Where it acts: this point of the object at rest [m]; absent: on all of it.",
    )
    radius: float = Field(
        default=0.15,
        ge=1e-6,
        le=1e5,
        description="Material so close to the point at rest is pushed [m], less towards the rim.",
    )

    @model_validator(mode="after")
    def _a_ball(self) -> WrenchForce:
        if self.region is not None:
            raise ValueError("a wrench acts within its radius of a point; leave region out")
        return self

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Find the centre of what is pushed, and push and turn it."""
        part = Part.of(model, self.point, self.radius, "forces.point", self.object)
        push = tracks.add(self.track(self.force), limited=True)
        turn = tracks.add(self.track(self.torque), limited=True)
        turned, kernel = any(self.torque), kernels.make_wrench(model.real)

        def record(grid: Grid) -> wp.Launch | None:
            del grid
            given = [part.chosen, part.per_force, wp.float64(part.mass), push, turn]
            given += [tracks.clock, tracks.values, state.x, part.means, part.second]
            return model.launch(kernel, len(part.chosen), given, [state.v])

        def limit(start: float, end: float) -> float:
            pushed = tracks.tracks[push].largest(start, end) / part.mass
            turning = MARGIN * part.reach / part.inertia if part.inertia else 0.0
            return pushed + turning * tracks.tracks[turn].largest(start, end)

        stage = Stage(self.kind, record, keeps_C=True, limit=limit)
        if not turned:
            return [stage]
        found = part.centred(self.kind, turn, model, state, tracks, turned=True)
        return [*found, stage]
