"""The paper's external force: newtons on each particle."""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from phy124.forces.base import Force, push
from phy124.mpm import Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.schema.bounds import Push


class ParticleForce(Force):
    """The paper's external force: newtons on each particle, a = f / m (Phy124, sec. 3.2)."""

    kind: Literal["particle_force"] = "particle_force"
    strengths: ClassVar[tuple[str, ...]] = ("f",)
    in_newtons: ClassVar[bool] = True
    f: Push = Field(default=(0.0, 1e-3, 0.0), description="Force on each particle [N].")

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Push each chosen particle."""
        return push(self, self.f, model, state, tracks)
