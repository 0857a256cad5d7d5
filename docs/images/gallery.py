"""Make gallery/*.webp beside this file: presets with every law on three pictures, for the eye.

A sheet shows one preset: a row for each law, and of each picture the middle and the last frame. A
run that stops is shown with its last good frame and named on the standard output. Objects have
fewer Gaussians than usual and the accuracy is draft. Run `python docs/images/gallery.py [PRESET]`.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from phy124 import pipeline
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.relief import relief
from phy124.imaging.cutout import cut_out
from phy124.io.clip import Clip
from phy124.rendering.frames import render_frames
from phy124.rendering.shine import shine_of
from phy124.rendering.stage.build import stage_of
from phy124.scene import Scene
from phy124.simulation import Simulation

HERE = Path(__file__).parent
PRESETS = ("bounce", "drop", "press", "push_away", "push_right", "spin", "sway", "wind")
PICTURES = ("duck", "teddy", "sunflower")
LAWS = (
    "neo_hookean", "fixed_corotated", "hencky", "rigid", "metal", "plasticine", "foam", "sand",
    "snow", "fluid",
)  # fmt: skip
EASED = {"rigid": {"material.E": 1e7}}
"""Changes to a law that takes minutes with its defaults."""
GAUSSIANS, SIZE, LABEL = 20_000, 128, 92


def made_of(name: str) -> Gaussians:
    """What `relief` makes of an example."""
    cutout = cut_out(HERE.parents[1] / f"demo/examples/{name}.png").picture
    return relief(cutout, count=GAUSSIANS)


def shown(clip: Clip, scene: Scene) -> list[np.ndarray]:
    """The middle frame and the last one, on a stage."""
    view = scene.view.model_copy(update={"size": (SIZE, SIZE), "stage": "studio"})
    index, seen = [len(clip) // 2, len(clip) - 1], pipeline.cameras(clip, view, "front")
    stage, shine = stage_of(clip, view), shine_of(clip, view)
    frames, chosen = [clip.frame(i) for i in index], [seen[i] for i in index]
    return list(
        render_frames(
            frames if shine is None else shine.frames(frames, chosen),
            chosen,
            background=view.background,
            stage=stage and stage.at,
        )
    )


def row(preset: str, law: str, objects: list[Gaussians]) -> np.ndarray:
    """One law on all pictures, with its name in front."""
    changes = {"material.law": law, **EASED.get(law, {})}
    scene = Scene.named(preset).replaced({"accuracy": "draft", "time.budget": 30.0, **changes})
    cells = [labelled(law)]
    for name, gaussians in zip(PICTURES, objects, strict=True):
        try:
            clip = Simulation(gaussians, scene).run()
        except InputError as refusal:
            print(f"{preset}, {law}, {name}: refused: {refusal}", flush=True)
            cells += 2 * [np.full((SIZE, SIZE, 3), 200, np.uint8)]
            continue
        if clip.report["stopped"]:
            print(f"{preset}, {law}, {name}: stopped: {clip.report['stopped']}", flush=True)
        cells += shown(clip, scene)
    return np.concatenate(cells, axis=1)


def labelled(law: str) -> np.ndarray:
    """A white cell that names a law."""
    cell = Image.new("RGB", (LABEL, SIZE), "white")
    ImageDraw.Draw(cell).text((4, SIZE // 2), law, fill="black")
    return np.asarray(cell)


def sheet(preset: str) -> str:
    """Make the sheet of a preset; returns its name."""
    objects = [made_of(name) for name in PICTURES]
    rows = [row(preset, law, objects) for law in LAWS]
    (HERE / "gallery").mkdir(exist_ok=True)
    picture = Image.fromarray(np.concatenate(rows, axis=0))
    picture.save(HERE / f"gallery/{preset}.webp", quality=80)
    return preset


if __name__ == "__main__":
    with ProcessPoolExecutor(2) as pool:
        for done in pool.map(sheet, sys.argv[1:] or PRESETS):
            print(done, flush=True)
