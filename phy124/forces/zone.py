"""A push in a zone of space."""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar, Literal

import warp as wp
from pydantic import Field, model_validator

from phy124.forces.base import Force
from phy124.kernels import push
from phy124.kernels.arguments import types
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Push
from phy124.schema.region import Region, cylinder


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

        def record(grid: Grid, own: slice) -> wp.Launch | None:
            run = grid.run(len(model))
            run = slice(max(run.start, own.start), min(run.stop, own.stop))
            if run.stop <= run.start:
                return None
            inputs = [*place, slot, tracks.clock, tracks.values, state.x[run]]
            return model.launch(kernel, run.stop - run.start, inputs, [state.v[run]])

        wanted = model.named(self.object)
        moving = [model.particles(b) for b in range(model.bodies) if b not in model.held]
        # Bodies that never move are left out, as they are everywhere.
        runs = [run for run in moving if wanted.start <= run.start and run.stop <= wanted.stop]
        runs = runs if model.held else [wanted]
        return [Stage("zone", partial(record, own=own), keeps_C=True, by_run=True) for own in runs]
