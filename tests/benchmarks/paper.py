"""Repeats the paper's three control experiments, as numbers and as a picture for docs/lab/paper.md.

A sunflower is pushed by (-1, 0, 0), (-1.5, 0, 0) and (0, -1, 0) in the paper's axes. Each of its
Gaussians is a particle. With `--docs` the program updates the table and the picture.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.rendering.frames import render_frames
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

sys.path.insert(0, str(Path(__file__).parent))
from tables import DOCS, markdown, renew

PICTURE = Path(__file__).parents[2] / "demo/examples/sunflower.png"
CONTROLS = {
    "push_right": ("(−1, 0, 0)", 1, "right"),
    "push_right_harder": ("(−1.5, 0, 0)", 1, "right"),
    "push_away": ("(0, −1, 0)", 0, "away"),
}
"""Preset -> force in the paper's axes, our axis along which it acts, and in words."""
SIZE = 200


def pushed(gaussians: Gaussians, name: str) -> tuple[Clip, Scene]:
    """The clip of a preset."""
    scene = Scene.named(name).replaced({"binding": "particles"})
    return Simulation(prepare(gaussians, scene)).run(), scene


def row(clip: Clip, scene: Scene, name: str) -> list[str]:
    """Return the path compared with a t^2 / 2, the sideways motion, and the change of the bounding
    box."""
    force, axis, where = CONTROLS[name]
    way = clip.means[-1].astype(float).mean(axis=0) - clip.means[0].astype(float).mean(axis=0)
    a, time = scene.forces[0].a, clip.times[-1]
    exact = np.array(a) * time**2 / 2
    aside = np.delete(way, axis)
    size = np.ptp(clip.means[0], axis=0)
    strain = np.abs(np.ptp(clip.means[-1], axis=0) / size - 1).max()
    return [
        f"`{name}`",
        force,
        f"{where}, {abs(a[axis]):g} m/s²",
        f"{abs(way[axis]):.4f}",
        f"{abs(exact[axis]):.4f}",
        f"{100 * (way[axis] / exact[axis] - 1):+.2f} %",
        f"{np.abs(aside).max():.1e}",
        f"{strain:.1e}",
    ]


def strip(clip: Clip, scene: Scene) -> np.ndarray:
    """Every third frame from the front, side by side."""
    small = scene.view.model_copy(update={"size": (SIZE, SIZE)})
    images = list(render_frames(clip.frames(), pipeline.cameras(clip, small, "front")))
    return np.concatenate(images[::3], axis=1)


def main() -> None:
    """Print the table; renew it and the picture if asked."""
    gaussians = pipeline.make_gaussians(PICTURE).gaussians
    clips = {name: pushed(gaussians, name) for name in CONTROLS}
    heads = [
        "scene",
        "force in the paper",
        "here",
        "way [m]",
        "a t² / 2 [m]",
        "off",
        "aside [m]",
        "change of size",
    ]
    table = markdown(heads, [row(clip, scene, name) for name, (clip, scene) in clips.items()])
    print(table)
    if "--docs" in sys.argv:
        renew(DOCS / "lab/paper.md", "control", table)
        rows = [strip(clip, scene) for clip, scene in clips.values()]
        Image.fromarray(np.concatenate(rows, axis=0)).save(
            DOCS / "images/paper-control.webp", quality=85
        )


if __name__ == "__main__":
    main()
