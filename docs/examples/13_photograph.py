"""In the photograph: the object moves in the picture from which it was made."""

import phy124
from phy124.pipeline import into_photograph

picture = "demo/examples/mushroom.png"
scene = phy124.Scene.named("press").replaced({"accuracy": "draft", "view.views": ["front"]})
result = phy124.generate(picture, scene, "out/photograph")
clip = phy124.Clip.load(result.folder / "clip.safetensors")
film, match = into_photograph(clip, scene.view, picture, result.folder, result.folder)
print(film, match)
