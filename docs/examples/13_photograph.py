"""In the photograph: the object moves in the picture from which it was made."""

import phy124
from phy124.rendering.compose import compose, photograph_of

picture = "demo/examples/mushroom.png"
scene = phy124.Scene.named("press").replaced({"accuracy": "draft", "view.views": ["front"]})
result = phy124.generate(picture, scene, "out/photograph")
clip = phy124.Clip.load(result.folder / "clip.safetensors")
photograph = photograph_of(picture, result.folder)
film, match = compose(clip, scene.view, photograph, result.folder)
print(film, match)
