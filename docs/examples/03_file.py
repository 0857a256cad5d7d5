"""A file of Gaussians: read it, let the object wobble, and write its last frame as a file."""

from pathlib import Path

import phy124
from phy124.pipeline import make_gaussians

folder = Path("out/file")
folder.mkdir(parents=True, exist_ok=True)
# This program makes its own file. You can use any other file of Gaussians.
phy124.write_gaussians(folder / "teddy.spz", make_gaussians("demo/examples/teddy.png").gaussians)

teddy = phy124.read_gaussians(folder / "teddy.spz").gaussians
scene = phy124.Scene.named("jelly").replaced(
    {"accuracy": "draft", "view.views": ["front"], "view.stage": "studio"}
)
clip = phy124.Simulation(phy124.prepare(teddy, scene)).run()
phy124.film(clip, scene.view, folder)
phy124.write_gaussians(folder / "last.ply", clip.frame(-1).gaussians)
