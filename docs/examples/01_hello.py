"""Hello: a duck is pressed flat and recovers."""

import phy124

scene = phy124.Scene.named("press").replaced(
    {"accuracy": "draft", "view.views": ["front"], "view.stage": "studio"}
)
result = phy124.generate("demo/examples/duck.png", scene, "out/hello")
print(result.folder / "front.mp4")
