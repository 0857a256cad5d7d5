"""Runs presets on the CPU and on a GPU: seconds of the simulation, and distance between the clips.

The object is a ball of `--count` Gaussians on 24 cells (8 in a trial on the CPU). On each device,
the second of two runs is measured, since the first run compiles the kernels. Distances are between
the Gaussians of all frames, relative to the object's size.
"""

import json
import sys
from pathlib import Path

import numpy as np
from arguments import device_asked

sys.path.insert(0, str(Path(__file__).parents[1]))
from presets import beginning

from phy124.io.clip import Clip
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball

PRESETS = (
    "press",
    "drop",
    "bounce",
    "sway",
    "jelly",
    "water",
    "sand",
    "snow",
    "foam",
    "metal",
    "stack",
)
CELLS, FEW = 24, 8


def clip_and_seconds(scene: Scene, count: int, device: str) -> tuple[Clip, dict[str, float]]:
    """The clip of the second run, and the seconds of its stages."""
    for _ in range(2):
        context = RunContext(device=device)
        clip = Simulation(prepare(surface_of_ball(count), scene, context)).run()
    return clip, context.watch.seconds


def main(count: int, device: str) -> None:
    """A row per preset."""
    cells = CELLS if count > 5000 else FEW
    for name in PRESETS:
        scene = beginning(name).replaced({"accuracy": {"cells": cells}})
        expected, before = clip_and_seconds(scene, count, "cpu")
        clip, after = clip_and_seconds(scene, count, device)
        # A grain of torn material is drawn only from its tear on, which rounding may move.
        shared = min(len(clip), len(expected))
        count_shared = min(clip.means.shape[1], expected.means.shape[1])
        moved, target = (c.means[:shared, :count_shared] for c in (clip, expected))
        apart = np.linalg.norm(moved - target, axis=2)
        row = {"what": "laws", "preset": name, "gaussians": count, "cells": cells}
        row |= {"cpu_s": round(before["simulate"], 3), "device_s": round(after["simulate"], 3)}
        row |= {"cpu_deform_s": round(before["deform"], 3)}
        row |= {"device_deform_s": round(after["deform"], 3)}
        row |= {"substeps_cpu": expected.report["substeps"], "substeps": clip.report["substeps"]}
        size = scene.object.size
        row |= {"rms_sizes": float(f"{np.sqrt((apart**2).mean()) / size:.2g}")}
        row |= {"largest_sizes": float(f"{apart.max() / size:.2g}")}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    asked = device_asked(__doc__, 20_000)
    main(asked.count, asked.device)
