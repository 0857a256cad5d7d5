"""A point that attracts or repels."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from phy124.forces.base import Force, stage
from phy124.kernels import push
from phy124.kernels.arguments import types
from phy124.mpm import Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Position


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
        return stage(self, "attraction", kernel, track, inputs, model, state, tracks, read=read)
