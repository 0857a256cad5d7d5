"""A stream of air or water that drags particles along."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from phy124.forces.base import Force, stage
from phy124.kernels import push
from phy124.mpm import Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Velocity


class Wind(Force):
    """Air or water that streams past and drags particles along: a = rate (wind - v)."""

    kind: Literal["wind"] = "wind"
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
        (drag,) = stage(
            self, "wind", kernel, track, inputs, model, state, tracks, over="kick", limited=True
        )

        def limit(start: float, end: float) -> float:
            """Acceleration of a particle at rest; a faster one is dragged no further than that."""
            return self.rate * track.largest(start, end)

        return [drag._replace(limit=limit, top_speed=track.largest)]
