"""Export: one frame as GLB and SPZ, the whole motion as OpenUSD and as a web page."""

from pathlib import Path

import phy124
from phy124.io.formats.usd import write_usd
from phy124.pipeline import cameras, make_gaussians

scene = phy124.Scene.named("jelly").replaced(
    {"accuracy": "draft", "view.views": ["front"], "view.stage": "studio"}
)
pear = make_gaussians("demo/examples/pear.png").gaussians
clip = phy124.Simulation(phy124.prepare(pear, scene)).run()

folder = Path("out/export")
phy124.film(clip, scene.view, folder)
phy124.write_gaussians(folder / "last.glb", clip.frame(-1).gaussians)  # Blender, three.js
phy124.write_gaussians(folder / "last.spz", clip.frame(-1).gaussians)  # SuperSplat, Niantic
write_usd(folder / "clip.usdc", clip)  # Omniverse, Houdini
phy124.write_html(folder / "clip.html", clip, cameras(clip, scene.view, "front")[0])  # any browser
