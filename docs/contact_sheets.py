"""Make docs/sheets/*.jpg: every preset on the example pictures, as `make sheets` does.

Rows are presets, columns every second frame from the front; the last row of each sheet shows the
orbit of the first preset.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.clip import Clip
from phy124.generators import make
from phy124.image import foreground, open_image
from phy124.render import render_frames
from phy124.scene import Scene, preset_names

HERE = Path(__file__).parent
PICTURES = ("duck", "sunflower", "teddy", "potted_plant")
SIZE = 160


def row(clip: Clip, scene: Scene, view: str) -> np.ndarray:
    """Every second frame, side by side."""
    small = scene.view.model_copy(update={"size": SIZE})
    images = list(render_frames(clip.frames(), pipeline.cameras(clip, small, view)))
    return np.concatenate(images[::2], axis=1)


def sheet(picture: Path, names: list[str]) -> np.ndarray:
    """All presets of one picture."""
    cutout, _ = foreground(open_image(picture))
    gaussians = make("relief")(cutout, seed=0, progress=lambda *_: None)
    rows = []
    for name in names:
        scene = Scene.named(name).replaced({"view.views": ["front"], "view.size": 16})
        with tempfile.TemporaryDirectory() as folder:
            pipeline.simulate(gaussians, scene, folder)
            clip = Clip.load(Path(folder) / "clip.safetensors")
            rows.append(row(clip, scene, "front"))
            if name == names[0]:
                orbit = row(clip, scene, "orbit")
    return np.concatenate([*rows, orbit], axis=0)


if __name__ == "__main__":
    (HERE / "sheets").mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        picture = Path(name) if Path(name).exists() else HERE / f"../demo/examples/{name}.png"
        image = Image.fromarray(sheet(picture, preset_names()))
        image.save(HERE / f"sheets/{picture.stem}.jpg", quality=85)
        print(picture.stem)
