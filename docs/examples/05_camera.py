"""Camera: videos of a clip from behind and above, without a background, and in portrait format."""

import phy124
from phy124.pipeline import make_gaussians

scene = phy124.Scene.named("sway").replaced({"accuracy": "draft"})
clip = phy124.Simulation(
    phy124.prepare(make_gaussians("demo/examples/sunflower.png").gaussians, scene)
).run()

views = {
    "behind": {"views": ["back"], "elevation": 35, "stage": "studio"},
    "transparent": {"azimuths": [45], "views": [], "stage": "transparent", "formats": ["webp"]},
    "portrait": {"views": ["front"], "size": [288, 512], "stage": "studio"},
}
for name, view in views.items():
    changed = scene.replaced({f"view.{key}": value for key, value in view.items()})
    print(*phy124.film(clip, changed.view, f"out/camera/{name}"))
