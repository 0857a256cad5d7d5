"""Softer: the same duck under the same plate, with three stiffnesses."""

import phy124
from phy124.pipeline import make_gaussians

duck = make_gaussians("demo/examples/duck.png").gaussians
scene = phy124.Scene.named("press").replaced(
    {"accuracy": "draft", "view.views": ["front"], "view.stage": "studio"}
)
for name, E in {"soft": 1e4, "normal": 4e4, "hard": 4e5}.items():
    clip = phy124.Simulation(phy124.prepare(duck, scene.replaced({"material.E": E}))).run()
    phy124.film(clip, scene.view, f"out/softer/{name}")
    print(f"E = {E:g} Pa: height at the end {clip.means[-1, :, 2].max():.2f} m")
