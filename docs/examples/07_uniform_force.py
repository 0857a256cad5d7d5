"""A uniform force of your own: the ground shakes faster and faster."""

import math
from typing import Literal

import phy124
from phy124.forces import Force, Gravity
from phy124.mpm.tracks import Track
from phy124.pipeline import make_gaussians


class Quake(Force):
    """A uniform acceleration along y that is interpolated from a table over time."""

    kind: Literal["quake"] = "quake"
    strength: float = 20.0

    def attach(self, model, state, tracks):
        """Add the acceleration to the grid update of the run, without a separate kernel."""
        times = [k / 100 for k in range(151)]
        keys = tuple((t, (0.0, self.strength * math.sin(12 * t * t), 0.0)) for t in times)
        tracks.accelerate(Track(keys, mean=True))
        return []


if __name__ == "__main__":
    scene = phy124.Scene.named("sway").replaced(
        {"accuracy": "draft", "time.frames": 36, "view.views": ["front"], "view.stage": "studio"}
    )
    scene = scene.model_copy(update={"forces": (Gravity(), Quake())})
    plant = make_gaussians("demo/examples/potted_plant.png").gaussians
    clip = phy124.Simulation(phy124.prepare(plant, scene)).run()
    phy124.film(clip, scene.view, "out/uniform_force")
