"""Several objects: a duck falls on a cushion, and a ball follows it."""

import phy124

cushion = {
    "name": "cushion",
    "shape": "box",
    "size": 1.3,
    "sides": [1.0, 1.0, 0.4],
    "colour": "mediumseagreen",
    "material": {"law": "neo_hookean", "density": 700, "E": 3e4, "nu": 0.4, "damping": 60},
}
ball = {"name": "ball", "shape": "sphere", "size": 0.4, "place": [0.0, 0.45], "lift": 1.9}
scene = phy124.Scene.named("drop").replaced(
    {
        "accuracy": "draft",
        "object": {"name": "duck", "on": "cushion", "lift": 0.3},
        "objects": [cushion, {**ball, "colour": "tomato"}],
        "time.frames": 24,
        "view.views": ["front"],
        "view.stage": "studio",
    }
)
result = phy124.generate("demo/examples/duck.png", scene, "out/objects")
clip = phy124.Clip.load(result.folder / "clip.safetensors")
for index, name in enumerate(clip.objects):
    z = clip.means[-1, clip.object_id == index, 2]
    print(f"{name}: from {z.min():.2f} m to {z.max():.2f} m")
