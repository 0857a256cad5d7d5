"""A material of your own: rubber, whose stiffness is computed from its Shore hardness."""

from typing import Literal

from pydantic import Field

import phy124
from phy124.materials import NeoHookean
from phy124.pipeline import make_gaussians


class Rubber(NeoHookean):
    """Rubber whose Young's modulus is computed from its Shore A hardness (Gent 1958)."""

    law: Literal["rubber"] = "rubber"
    nu: float = Field(default=0.45, ge=0, le=0.4999, description="Poisson's ratio.")
    shore: float = Field(default=30, ge=5, le=90, description="Hardness [Shore A].")

    @property
    def lame(self):
        """Return the Lame parameters mu and lambda [Pa]."""
        E = 0.0981e6 * (56 + 7.62336 * self.shore) / (0.137505 * (254 - 2.54 * self.shore))
        return NeoHookean(E=E, nu=self.nu).lame


if __name__ == "__main__":
    scene = phy124.Scene.named("bounce").replaced(
        {"accuracy": "draft", "time.frames": 30, "view.views": ["front"], "view.stage": "studio"}
    )
    scene = scene.model_copy(update={"material": Rubber(shore=10)})
    chick = make_gaussians("demo/examples/chick.png").gaussians
    clip = phy124.Simulation(phy124.prepare(chick, scene)).run()
    phy124.film(clip, scene.view, "out/material")
