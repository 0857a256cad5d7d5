"""Prescribed velocities."""

from __future__ import annotations

from typing import ClassVar, Literal

import warp as wp
from pydantic import Field

from phy124.forces.base import Force, within
from phy124.kernels import push
from phy124.kernels.arguments import types
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Position, Velocity
from phy124.schema.region import Vector

UNIT: Vector = (1.0, 0.0, 0.0)
"""Value of a track that holds nothing but the profile."""


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
        slot = tracks.add(self.track(UNIT, mean=False), over="drift")
        chosen = self.chosen(model)
        kernel = push.make_set_velocity(model.real)
        motion = [t.vec3(*self.v), t.vec3(*self.centre), t.vec3(*self.spin)]

        def record(grid: Grid) -> wp.Launch | None:
            own = within(chosen, grid.run(len(model)))
            inputs = [own, slot, *motion, tracks.values, state.x]
            return model.launch(kernel, len(own), inputs, [state.v, state.C])

        return [Stage("set_velocity", record, self.sudden, by_run=True)]
