"""Make the looping pictures on the preset cards from the pipeline itself.

Run `python -m demo.make_previews` again when presets or their physics have
changed; it takes some seconds per preset.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from phy124.clip import Clip
from phy124.cutout import cut_out
from phy124.gaussians import Frame
from phy124.generators import make
from phy124.pipeline import cameras
from phy124.progress import silent
from phy124.render import render_frames
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation
from phy124.video import write_animation

FOLDER = Path(__file__).parent
OBJECTS = {
    "sway": "potted_plant", "drop": "pear", "bounce": "chick", "spin": "cupcake", "sand": "cupcake",
    "snow": "teddy", "water": "pear", "jelly": "cupcake", "wind": "sunflower", "foam": "mushroom",
}  # fmt: skip
"""Which example suits a preset; all others take the duck."""
SIZE = 200


def main() -> None:
    """Make the previews of the presets named, or of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("presets", nargs="*", default=preset_names())
    for name in parser.parse_args().presets:
        make_preview(name, FOLDER / "previews" / f"{name}.webp")


def make_preview(name: str, path: Path) -> None:
    """Simulate a preset at draft accuracy and film it from the front and slightly above."""
    picture = FOLDER / "examples" / f"{OBJECTS.get(name, 'duck')}.png"
    cutout = cut_out(picture).picture
    scene = Scene.named(name).replaced({"accuracy": "draft"})
    clip = Simulation(make("relief")(cutout, seed=0, progress=silent), scene).run()
    path.parent.mkdir(exist_ok=True)
    closer = {"size": (SIZE, SIZE), "distance": scene.view.distance - 0.2}
    view = scene.view.model_copy(update=closer)
    images = render_frames(_there_and_back(clip), cameras(clip, view, "front")[0], device="cpu")
    write_animation(path, images, fps=scene.time.fps * 0.6)


def _there_and_back(clip: Clip) -> list[Frame]:
    """The frames, held at the end for a moment, so that the loop has a rhythm."""
    frames = list(clip.frames())
    return [*frames, *[frames[-1]] * 4]


if __name__ == "__main__":
    main()
