"""Heights: run a simulation frame by frame, measure heights, and make videos of the clip."""

import phy124
from phy124.pipeline import make_gaussians

duck = make_gaussians("demo/examples/duck.png").gaussians
scene = phy124.Scene.named("drop").replaced(
    {"accuracy": "draft", "time.frames": 30, "view.views": ["front"], "view.stage": "studio"}
)

run = phy124.Simulation(phy124.prepare(duck, scene))
heights = []
for frame in run:
    heights.append(frame.gaussians.means[:, 2].mean())
    print(f"{frame.time:.2f} s: {heights[-1]:.3f} m")

phy124.film(run.run(), scene.view, "out/heights")
