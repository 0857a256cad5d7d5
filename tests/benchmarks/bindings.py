"""What it costs and brings that every Gaussian is a particle: both bindings, scene by scene.

Each scene is run on a series of grids with the bindings `particles` and `lattice`. Errors are
distances from the limit that the grids of `particles` approach (`phy124.accuracy.convergence`), so
a bias of `lattice` counts against it; "own" is its error from its own limit. Seconds are processor
seconds of dynamics and shapes, of all threads. `lattice` dominates a run of `particles` if one of
its runs has no larger error in less time. Arguments are names of scenes; none: all of them.
"""

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from phy124 import pipeline
from phy124.accuracy.convergence import distances, richardson
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation

sys.path.insert(0, str(Path(__file__).parent))
from promises import FLOWING, SPRINGY, scene_of

ROOT = Path(__file__).parents[2]
PARTICLES = (16, 24, 32, 48)
LATTICE = (16, 20, 24, 28, 32, 48)
PICTURES = ("duck", "sunflower")
LAWS = (*SPRINGY, *FLOWING)
HEADS = [
    "scene", "particles: cells, CPU s, error %", "lattice: cells, CPU s, error %, own %",
    "particles at 32 is dominated by", "PSNR dB",
]  # fmt: skip


def scenes() -> dict[str, tuple[str, Scene]]:
    """Name -> picture, scene: every preset with each picture, and every law that is dropped."""
    found = {f"{preset} {picture}": (picture, Scene.named(preset))
             for preset in preset_names() for picture in PICTURES}  # fmt: skip
    for law in LAWS:
        found[f"drop {law} cupcake"] = ("cupcake", scene_of("drop", law, {}))
    return found


def run(gaussians: Gaussians, scene: Scene, cells: int, binding: str) -> tuple[Clip, float] | None:
    """The clip and its processor seconds; None if the run cannot be made or was stopped."""
    accuracy: dict[str, Any] = {"accuracy.cells": cells, "binding": binding}
    try:
        simulation = Simulation(gaussians, scene.replaced({"time.budget": 1e6, **accuracy}))
    except InputError as error:
        print(f"  D/{cells} {binding}: {error}", file=sys.stderr)
        return None
    start = time.process_time()
    clip = simulation.run()
    seconds = time.process_time() - start
    return (clip, seconds) if clip.report["complete"] else None


def compared(gaussians: Gaussians, scene: Scene) -> list[str] | None:
    """Cells of the table after the name."""
    size = scene.object.size
    ours = {c: found for c in PARTICLES if (found := run(gaussians, scene, c, "particles"))}
    theirs = {c: found for c in LATTICE if (found := run(gaussians, scene, c, "lattice"))}
    levels = [clip.surface.means for clip, _ in ours.values()]
    others = [clip.surface.means for clip, _ in theirs.values()]
    limit = richardson([1 / c for c in ours], distances(levels) / size)
    own = richardson([1 / c for c in theirs], distances(others) / size)
    if not limit.exact:
        return [f"{limit.why_not}", "", "", ""]
    errors = dict(zip(ours, limit.errors, strict=True))
    apart = {
        c: limit.error_of(np.array([distances([other, m])[0, 1] for m in levels]) / size)
        for c, other in zip(theirs, others, strict=True)
    }
    owns = dict(zip(theirs, own.errors or [float("nan")] * len(theirs), strict=True))
    left = "; ".join(f"{c}: {ours[c][1]:.1f}, {100 * errors[c]:.2f}" for c in ours)
    right = "; ".join(
        f"{c}: {theirs[c][1]:.1f}, {100 * apart[c]:.2f}, {100 * owns[c]:.2f}" for c in theirs
    )
    best = min(
        (c for c in theirs if 32 in ours and apart[c] <= errors[32]),
        key=lambda c: theirs[c][1], default=None,
    )  # fmt: skip
    word = "none"
    if best is not None and theirs[best][1] < ours[32][1]:
        word = f"{best} in {theirs[best][1] / ours[32][1]:.2f} of the time"
    return [left, right, word, ""]


def main() -> None:
    """The table, a line as soon as it is known."""
    chosen = [name for name in sys.argv[1:] if not name.startswith("--")]
    statics: dict[str, Gaussians] = {}
    rows = []
    for name, (picture, scene) in scenes().items():
        if chosen and name not in chosen:
            continue
        if picture not in statics:
            image = ROOT / f"demo/examples/{picture}.png"
            statics[picture] = pipeline.static(image).gaussians
        found = compared(statics[picture], scene)
        if found:
            rows.append([name, *found])
            print(" | ".join(rows[-1]), flush=True)


if __name__ == "__main__":
    main()
