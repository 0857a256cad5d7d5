"""A run of the page in which a duck is pressed, and a video of a stiffer duck."""

from pathlib import Path

from demo.jobs import Studio
from demo.source import Choice
from demo.work import Done
from phy124.io.clip import Clip
from phy124.pipeline import make_gaussians
from phy124.rendering.film import film
from phy124.scene import Scene
from support.twins import twin

DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
GROUND = (0.35, 0.5, 0.62)
"""Colour of the background, which differs from all colours of the duck."""


CELLS = 28
"""Cells across the object in the video, whose grid is finer than the grids of a fit."""


def video(folder: Path, truth: float, cells: int = CELLS) -> Path:
    """Make a video of the pressed duck, with a finer grid and other particles than in a fit."""
    folder.mkdir(exist_ok=True)
    scene = Scene.named("press").replaced({"material.E": truth})
    clip: Clip = twin(make_gaussians(DUCK, Scene(), count=5000).gaussians, scene, cells)
    view = scene.view.model_copy(
        update={"views": ("front",), "size": (256, 256), "background": GROUND}
    )
    film(clip, view, folder, device="cpu")
    return folder / "front.mp4"


def pressed(studio: Studio, folder: Path, *, truth: float, guess: float) -> tuple[Done, Path]:
    """Return a visitor's finished run with a guessed stiffness, and the video with the true
    stiffness."""
    studio.visitors.get("a")
    sent = str(studio.visitors.store("a", DUCK.read_bytes(), ".png"))
    cut = studio.cut_out("a", sent)
    assert cut.wait(60)
    changes = {"material.E": guess, "accuracy": "draft", "view.size": 64, "view.views": ["front"]}
    scene = Scene.named("press").replaced(changes)
    run = studio.run(Choice("a", cut.progress.result, scene.data()))
    assert run.wait(300), run.progress.message
    return run.progress.result, video(folder / "truth", truth)
