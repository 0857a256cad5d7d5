"""Whether what a preset shows comes to its end: every preset run on for several seconds.

python tests/benchmarks/settling.py [--seconds 4] [--accuracy draft] [PRESET ...]

Prints a table: the preset's own clip (frames, length, seconds to simulate), and of the longer run
the length, the seconds to simulate, the instant of the last visible motion, since when it sleeps,
the largest fraction of the object outside the front picture, and why it stopped, if it did.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from phy124 import pipeline
from phy124.io.clip import Clip
from phy124.rendering.framing import departures
from phy124.scene import Scene
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation
from phy124.simulation.run import Stopped

EXAMPLES = Path(__file__).parents[2] / "demo/examples"
PLANTS = ("sway", "wind")
VISIBLE = 1e-3
"""Displacement between frames 1/24 s apart that still shows, in object sizes: 0.3 px of 300."""


def pace(clip: Clip, fps: float, size: float) -> np.ndarray:
    """How far the Gaussians got from frame to frame, scaled to 1/24 s: 99th percentile [sizes]."""
    steps = np.linalg.norm(np.diff(clip.means[:, ::7], axis=0), axis=2)
    return np.quantile(steps, 0.99, axis=1) * fps / 24 / size


def measured(name: str, gaussians, seconds: float, accuracy: str) -> str:
    """One row of the table."""
    own = Scene.named(name)
    fps = own.time.fps
    frames = max(own.time.frames, round(seconds * fps))
    scene = own.replaced({"accuracy": accuracy, "time.frames": frames, "view.views": ["front"]})
    run, spent, begun, stopped = Simulation(gaussians, scene), [], time.perf_counter(), ""
    try:
        for _ in run:
            spent.append(time.perf_counter() - begun)
    except Stopped as stop:
        stopped = str(stop)
    clip = run.clip()
    moves = np.flatnonzero(pace(clip, fps, scene.object.size) > VISIBLE)
    last = (moves[-1] + 1) / fps if len(moves) else 0.0
    sleep = clip.report["sleep"]
    left = departures(clip, scene.view)
    return " | ".join(
        [
            f"| {name}",
            f"{own.time.frames} ({own.time.frames / fps:.2f} s)",
            f"{spent[min(own.time.frames, len(spent)) - 1]:.1f}",
            f"{len(clip) / fps:.2f}",
            f"{spent[-1]:.1f}",
            f"{last:.2f}",
            f"{sleep['since'] / fps:.2f}" if sleep else "no",
            f"{left[0].outside:.0%} at {left[0].worst_frame / fps:.2f}" if left else "0%",
            (stopped[:80] or "-") + " |",
        ]
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("presets", nargs="*", default=preset_names())
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--accuracy", default="draft")
    given = parser.parse_args()
    made = {n: pipeline.static(EXAMPLES / f"{n}.png").gaussians for n in ("duck", "potted_plant")}
    print(
        "| preset | own clip | s | run on [s] | s | moves until [s] | sleeps from [s] "
        "| outside | stopped |"
    )
    print("|---|---|--:|--:|--:|--:|--:|---|---|", flush=True)
    for name in given.presets:
        body = made["potted_plant" if name in PLANTS else "duck"]
        print(measured(name, body, given.seconds, given.accuracy), flush=True)


if __name__ == "__main__":
    main()
