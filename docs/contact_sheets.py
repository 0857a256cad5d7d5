"""Make docs/sheets/*.jpg and docs/duck-press.webp: every preset on the example pictures.

Rows are presets, columns every second frame from the front; the last row of each sheet shows the
orbit of the first preset. Run it as `python docs/contact_sheets.py [PICTURE ...]`.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.clip import Clip
from phy124.cutout import cut_out
from phy124.generators import make
from phy124.render import render_frames
from phy124.scene import Scene, preset_names
from phy124.video import write_animation

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
    cutout = cut_out(picture).picture
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


def banner(path: Path) -> None:
    """The README's picture: the duck pressed, four views and the orbit side by side."""
    cutout = cut_out(HERE / "../demo/examples/duck.png").picture
    gaussians = make("relief")(cutout, seed=0, progress=lambda *_: None)
    scene = Scene.named("press").replaced({"view.views": ["front"], "view.size": 200})
    with tempfile.TemporaryDirectory() as folder:
        pipeline.simulate(gaussians, scene, folder)
        clip = Clip.load(Path(folder) / "clip.safetensors")
        views = [
            list(render_frames(clip.frames(), pipeline.cameras(clip, scene.view, name)))
            for name in ("front", "right", "back", "left", "orbit")
        ]
    write_animation(
        path, [np.concatenate(tiles, axis=1) for tiles in zip(*views, strict=True)], fps=12
    )


if __name__ == "__main__":
    if not sys.argv[1:]:
        banner(HERE / "duck-press.webp")
    (HERE / "sheets").mkdir(exist_ok=True)
    for name in sys.argv[1:] or PICTURES:
        picture = Path(name) if Path(name).exists() else HERE / f"../demo/examples/{name}.png"
        image = Image.fromarray(sheet(picture, preset_names()))
        image.save(HERE / f"sheets/{picture.stem}.jpg", quality=85)
        print(picture.stem)
