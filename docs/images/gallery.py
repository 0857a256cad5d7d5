"""Make gallery/*.webp in this folder: all presets, and eight presets with every law.

The sheet `presets` shows every preset with its default material. The sheet of a single preset has a
row for each law, which shows the middle and the last frame for each picture. If a run stops early,
its last good frame is shown, and the standard output names the run. Objects have fewer Gaussians
than usual, and the accuracy is draft.

The sheet `objects` has a row for each real object, in several scenes. docs/gallery.md names the
authors. The files of these objects are not part of the repository. They are read from
$PHY124_OBJECTS or ../shared/objects. Without them the sheet is not made.

Run `python docs/images/gallery.py [presets, water, materials, PRESET or objects]`. `water` shows
the duck as water. `materials` shows sand, snow, plasticine and metal.
"""

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from phy124_demo.make_previews import OBJECTS as PICTURE_OF
from PIL import Image, ImageDraw

from phy124 import pipeline
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.ply_file import PlyFile, Reading
from phy124.generators.relief import relief
from phy124.imaging.cutout import cut_out
from phy124.io.clip import Clip
from phy124.materials import LAWS
from phy124.pipeline.capture import capture
from phy124.rendering.frames import render_frames
from phy124.rendering.shine import make_shine
from phy124.rendering.stage.build import make_stage
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation, prepare

HERE = Path(__file__).parent
COLUMNS = 3
"""Number of presets in a row of the sheet that shows all presets."""
PRESETS = ("bounce", "drop", "press", "push_away", "push_right", "spin", "sway", "wind")
PICTURES = ("duck", "teddy", "sunflower")
EASED = {"rigid": {"material.E": 1e7}}
"""Changed values of a law that would take minutes with its default values."""
SUBSTANCES = (
    ("sand", "sand", "duck", {}),
    ("snow", "snow", "teddy", {}),
    ("plasticine", "press", "chick", {"material.law": "plasticine"}),
    ("metal", "metal", "duck", {}),
)
"""Rows of the sheet `materials`: label, preset, picture and changes."""
GAUSSIANS, SIZE, LABEL = 20_000, 128, 92
OBJECTS = Path(os.environ.get("PHY124_OBJECTS", HERE.parents[2] / "shared/objects"))
REAL = (
    "plant", "spot", "bob", "teapot", "fish", "cat", "penguin", "boat", "boot", "hammer", "tree",
    "sword", "koala", "wingnut", "goathead",
)  # fmt: skip
SCENES = ("sway", "press", "drop", "spin", "jelly", "snow", "sand", "water", "metal", "bury")
"""Presets in which the real objects are shown; each is a column of the sheet."""
SMALL = 96
"""Width and height of a picture of a real object [pixels]."""


def made_of(name: str) -> Gaussians:
    """Return the Gaussians that `relief` makes from an example picture."""
    cutout = cut_out(HERE.parents[1] / f"demo/examples/{name}.png").picture
    return relief(cutout, count=GAUSSIANS)


def shown(
    clip: Clip, scene: Scene, size: int = SIZE, index: Sequence[int] = ()
) -> list[np.ndarray]:
    """Draw some frames of a clip on a stage: by default the middle frame and the last frame."""
    view = scene.view.model_copy(update={"size": (size, size), "stage": "studio"})
    seen = pipeline.cameras(clip, view, "front")
    index = index or (len(clip) // 2, len(clip) - 1)
    stage, shine = make_stage(clip, view), make_shine(clip, view)
    frames, chosen = [clip.frame(i) for i in index], [seen[i] for i in index]
    if shine is not None:
        frames = [shine.illuminate(*pair) for pair in zip(frames, chosen, strict=True)]
    return list(
        render_frames(
            frames,
            chosen,
            background=view.background,
            stage=stage and stage.at,
        )
    )


def row(preset: str, law: str, objects: list[Gaussians]) -> np.ndarray:
    """Return the row of a law: its name, then the frames for each picture."""
    changes = {"material.law": law, **EASED.get(law, {})}
    scene = Scene.named(preset).replaced({"accuracy": "draft", "time.budget": 30.0, **changes})
    cells = [labelled(law)]
    for name, gaussians in zip(PICTURES, objects, strict=True):
        try:
            clip = Simulation(prepare(gaussians, scene)).run()
        except InputError as refusal:
            print(f"{preset}, {law}, {name}: refused: {refusal}", flush=True)
            cells += 2 * [np.full((SIZE, SIZE, 3), 200, np.uint8)]
            continue
        if clip.report["stopped"]:
            print(f"{preset}, {law}, {name}: stopped: {clip.report['stopped']}", flush=True)
        cells += shown(clip, scene)
    return np.concatenate(cells, axis=1)


def all_presets() -> list[np.ndarray]:
    """Return the rows of the sheet that shows all presets, each with its default material."""
    cells = [preset_cell(name) for name in preset_names()]
    cells += [np.full_like(cells[0], 255)] * (-len(cells) % COLUMNS)
    return [np.concatenate(cells[i : i + COLUMNS], 1) for i in range(0, len(cells), COLUMNS)]


def preset_cell(name: str) -> np.ndarray:
    """Return a cell with a preset's name above the middle and the last frame."""
    scene = Scene.named(name).replaced({"accuracy": "draft"})
    clip = Simulation(prepare(made_of(PICTURE_OF.get(name, "duck")), scene)).run()
    print(name, flush=True)
    frames = np.concatenate(shown(clip, scene), axis=1)
    return np.concatenate([labelled(name, 2 * SIZE, 16), frames])


def labelled(words: str, width: int = LABEL, height: int = SIZE) -> np.ndarray:
    """Return a white cell with a word on it."""
    cell = Image.new("RGB", (width, height), "white")
    ImageDraw.Draw(cell).text((4, height // 2 - 6), words, fill="black")
    return np.asarray(cell)


def water() -> list[np.ndarray]:
    """Return eight instants of the duck as water, at standard accuracy, in two rows."""
    scene = Scene.named("water")
    duck = relief(cut_out(HERE.parents[1] / "demo/examples/duck.png").picture, count=2 * GAUSSIANS)
    clip = Simulation(prepare(duck, scene)).run()
    cells = shown(clip, scene, 400, (0, 5, 8, 11, 15, 20, 30, 47))
    return [np.concatenate(cells[k : k + 4], axis=1) for k in (0, 4)]


def materials() -> list[np.ndarray]:
    """Return rows of six instants for sand, snow, plasticine and metal, at standard accuracy."""
    rows = []
    for label, preset, picture, changes in SUBSTANCES:
        scene = Scene.named(preset).replaced({"accuracy": "standard", **changes})
        clip = Simulation(prepare(made_of(picture), scene)).run()
        instants = np.linspace(0, len(clip) - 1, 6).round().astype(int).tolist()
        cells = shown(clip, scene, 200, instants)
        rows.append(np.concatenate([labelled(label, height=200), *cells], axis=1))
        print(label, flush=True)
    return rows


def real(name: str) -> np.ndarray:
    """Return the row of a real object: its name, then the middle frame of each scene."""
    cells = [labelled(name, height=SMALL)]
    for preset in SCENES:
        scene = Scene.named(preset).replaced({"accuracy": "draft"})
        file = PlyFile(str(OBJECTS / f"{name}.splat"), Reading(up="-y"))
        read = capture(file, scene, count=GAUSSIANS)
        clip = Simulation(prepare(read.gaussians, read.scene)).run()
        cells.append(shown(clip, scene, SMALL)[0])
    return np.concatenate(cells, axis=1)


def real_objects() -> list[np.ndarray]:
    """Return the rows of the sheet that shows real objects."""
    heads = [labelled("", height=16), *(labelled(scene, SMALL, 16) for scene in SCENES)]
    return [np.concatenate(heads, axis=1), *(real(name) for name in REAL)]


def sheet(preset: str) -> str:
    """Make a sheet of all presets, of a single preset or of real objects, and return its name."""
    if preset == "objects" and not OBJECTS.is_dir():
        return f"objects: left as it is, there is no {OBJECTS}"
    if preset == "objects":
        rows = real_objects()
    elif preset == "presets":
        rows = all_presets()
    elif preset == "water":
        rows = water()
    elif preset == "materials":
        rows = materials()
    else:
        objects = [made_of(name) for name in PICTURES]
        rows = [row(preset, law, objects) for law in LAWS.by_name]
    (HERE / "gallery").mkdir(exist_ok=True)
    picture = Image.fromarray(np.concatenate(rows, axis=0))
    picture.save(HERE / f"gallery/{preset}.webp", quality=80)
    return preset


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as pool:
        for done in pool.map(
            sheet, sys.argv[1:] or ("presets", "water", "materials", *PRESETS, "objects")
        ):
            print(done, flush=True)
