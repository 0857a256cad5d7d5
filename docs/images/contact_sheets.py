"""Make sheets/*.jpg and duck-press.webp in this folder: every preset with the example pictures.

Each row of a sheet shows a preset at seven instants from the front. The last row shows the first
preset in the view `orbit`. sheets/substances.jpg shows the presets for substances, at draft. Each
of them has a picture that suits it. Run `python docs/images/contact_sheets.py [PICTURE ...]`. With
the argument `substances`, only sheets/substances.jpg is made.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.gaussians import Gaussians
from phy124.generators import make
from phy124.imaging.cutout import cut_out
from phy124.io.clip import Clip
from phy124.io.video import write_animation
from phy124.rendering.frames import render_frames
from phy124.rendering.shine import make_shine
from phy124.rendering.stage.build import make_stage
from phy124.scene import Scene, View, preset_names

HERE = Path(__file__).parent
PICTURES = ("duck", "sunflower", "teddy", "potted_plant")
SUBSTANCES = {
    "sand": "duck",
    "snow": "teddy",
    "water": "pear",
    "jelly": "cupcake",
    "foam": "mushroom",
    "metal": "duck",
    "wind": "potted_plant",
}
"""Presets for substances, each with the name of its picture."""
SIZE, COLUMNS = 160, 7


def filmed(clip: Clip, view: View, side: str, index: list[int]) -> list[np.ndarray]:
    """Draw some frames of a clip from a side, on a stage and with shine, as the page shows them."""
    view = view.model_copy(update={"stage": "studio"})
    seen, stage, shine = (
        pipeline.cameras(clip, view, side),
        make_stage(clip, view),
        make_shine(clip, view),
    )
    frames, chosen = [clip.frame(i) for i in index], [seen[i] for i in index]
    if shine is not None:
        frames = [shine.illuminate(*pair) for pair in zip(frames, chosen, strict=True)]
    pictures = render_frames(frames, chosen, background=view.background, stage=stage and stage.at)
    return list(pictures)


def row(clip: Clip, scene: Scene, side: str) -> np.ndarray:
    """Return the pictures of seven instants of a clip, from first to last, in a row."""
    small = scene.view.model_copy(update={"size": (SIZE, SIZE)})
    index = [round(i) for i in np.linspace(0, len(clip) - 1, COLUMNS)]
    return np.concatenate(filmed(clip, small, side, index), axis=1)


def sheet(picture: Path, names: list[str]) -> np.ndarray:
    """Return the sheet that shows all presets for a picture."""
    gaussians = made_of(picture)
    clips = [(name, moved(gaussians, name)) for name in names]
    rows = [row(clip, Scene.named(name), "front") for name, clip in clips]
    orbit = row(clips[0][1], Scene.named(names[0]), "orbit")
    return np.concatenate([*rows, orbit], axis=0)


def substances() -> np.ndarray:
    """Return the sheet that shows the presets for substances."""
    rows = []
    for name, picture in SUBSTANCES.items():
        clip = moved(made_of(example(picture)), name, accuracy="draft")
        rows.append(row(clip, Scene.named(name), "front"))
    return np.concatenate(rows, axis=0)


def example(name: str) -> Path:
    """Return the path of an example picture."""
    return HERE.parents[1] / f"demo/examples/{name}.png"


def made_of(picture: Path) -> Gaussians:
    """Return the Gaussians that `relief` makes from a picture."""
    cutout = cut_out(picture).picture
    return make("relief")(cutout, seed=0, progress=lambda *_: None)


def moved(gaussians: Gaussians, name: str, *, accuracy: str = "standard") -> Clip:
    """Simulate a preset and return its clip."""
    changes = {"accuracy": accuracy, "view.views": ["front"], "view.size": 16}
    scene = Scene.named(name).replaced(changes)
    with tempfile.TemporaryDirectory() as folder:
        pipeline.simulate(gaussians, scene, folder)
        return Clip.load(Path(folder) / "clip.safetensors")


def banner(path: Path) -> None:
    """Make the README's picture: four views and the orbit of the pressed duck, side by side."""
    scene = Scene.named("press").replaced({"view.size": 200})
    clip = moved(made_of(example("duck")), "press")
    views = [
        filmed(clip, scene.view, name, list(range(len(clip))))
        for name in ("front", "right", "back", "left", "orbit")
    ]
    write_animation(
        path, [np.concatenate(tiles, axis=1) for tiles in zip(*views, strict=True)], fps=12
    )


if __name__ == "__main__":
    if not sys.argv[1:]:
        banner(HERE / "duck-press.webp")
    (HERE / "sheets").mkdir(exist_ok=True)
    for name in sys.argv[1:] or ("substances", *PICTURES):
        if name == "substances":
            pixels, picture = substances(), Path(name)
        else:
            picture = Path(name) if Path(name).exists() else example(name)
            pixels = sheet(picture, [n for n in preset_names() if n not in SUBSTANCES])
        Image.fromarray(pixels).save(HERE / f"sheets/{picture.stem}.jpg", quality=85)
        print(picture.stem)
