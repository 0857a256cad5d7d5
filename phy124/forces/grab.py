"""A hand that holds a point of the object and draws it along."""

from __future__ import annotations

from typing import ClassVar, Literal

import warp as wp
from pydantic import Field, model_validator

from phy124.forces.base import Force
from phy124.forces.held import Part
from phy124.kernels import held as kernels
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import FOREVER, Track, Tracks, check_times
from phy124.schema.bounds import Instant, Position


class Grab(Force):
    """A spring and a damper draw a point of the object to a target that moves."""

    kind: Literal["grab"] = "grab"
    strengths: ClassVar[tuple[str, ...]] = ("strength",)
    point: Position = Field(
        default=(0.0, 0.0, 0.5), description="What is held: this point of the object at rest [m]."
    )
    radius: float = Field(
        default=0.15,
        ge=1e-6,
        le=1e5,
        description="Material so close to it at rest is held [m], less firmly towards the rim.",
    )
    times: tuple[Instant, ...] = Field(default=(0.0, 1.0), description="Times since the start [s].")
    targets: tuple[Position, ...] = Field(
        default=((0.0, 0.0, 0.5), (0.0, 0.0, 1.0)), description="Where it is drawn to then [m]."
    )
    stiffness: float = Field(default=1e4, ge=0, le=1e12, description="Of the spring [N/m].")
    damping: float = Field(default=1e3, ge=0, le=1e12, description="Of the damper [N s/m].")
    strength: float = Field(default=1e4, ge=0, le=1e9, description="Largest force [N].")

    @model_validator(mode="after")
    def _fits(self) -> Grab:
        check_times(self.times, len(self.targets), "targets")
        if self.region is not None:
            raise ValueError("a grab holds what is within its radius of a point; leave region out")
        if self.profile.kind != "constant":
            raise ValueError("a grab varies by its targets; leave profile out")
        return self

    @property
    def varies(self) -> bool:
        """Always true, since its target moves."""
        return True

    def target(self) -> Track:
        """Where it draws to over time [m]."""
        start = -FOREVER if self.start <= 0 else self.start
        end = FOREVER if self.end is None else self.end
        return Track(tuple(zip(self.times, self.targets, strict=True)), start, end, self.start)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Find the centre of what is held, and draw it."""
        part = Part.of(model, self.point, self.radius, "forces.point", self.object)
        slot = tracks.add(self.target(), limited=True)
        spring = wp.vec4d(self.stiffness, self.damping, part.drawn, self.strength)
        kernel = kernels.make_draw(model.real)

        def record(grid: Grid) -> wp.Launch | None:
            del grid
            given = [part.chosen, part.per_force, spring, slot]
            given += [tracks.clock, tracks.values, tracks.rates, part.means]
            return model.launch(kernel, len(part.chosen), given, [state.v])

        def limit(start: float, end: float) -> float:
            return self.strength / part.mass if tracks.tracks[slot].acts(start, end) else 0.0

        found = part.centred(self.kind, slot, model, state, tracks, turned=False)
        return [*found, Stage(self.kind, record, keeps_C=True, limit=limit)]
