"""Measures the time of each preset, and whether its motion has ended at the end of the clip.

    python tests/benchmarks/settling.py [--accuracy draft,standard] [--seconds S] [PRESET ...]

The program prints a row per preset: the length of its clip, and the processor time [s] of
simulation and shapes at each accuracy. For the first accuracy, the row also states how far
Gaussians move from frame to frame at the end, when the object comes to rest, and the largest
fraction of the object outside the front picture. With `--seconds`, all presets have this length.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from phy124 import pipeline
from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.rendering.framing import departures
from phy124.scene import Scene
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation, prepare

EXAMPLES = Path(__file__).parents[2] / "demo/examples"
PLANTS = ("sway", "wind")
"""Presets that show the potted plant; the others show the duck."""


def pace(clip: Clip, size: float) -> float:
    """Displacement of Gaussians between the last two frames: 99th percentile [sizes]."""
    steps = np.linalg.norm(clip.means[-1] - clip.means[-2], axis=1)
    return float(np.quantile(steps, 0.99)) / size


def run(gaussians: Gaussians, scene: Scene) -> tuple[Clip, float]:
    """The clip and its processor seconds."""
    start = time.process_time()
    clip = Simulation(prepare(gaussians, scene)).run()
    return clip, time.process_time() - start


def row(name: str, gaussians: Gaussians, accuracies: list[str], seconds: float | None) -> str:
    """One row of the table."""
    changes = {"view.views": ["front"], **({"time.seconds": seconds} if seconds else {})}
    scenes = [Scene.named(name).replaced({"accuracy": a, **changes}) for a in accuracies]
    made = [run(gaussians, scene) for scene in scenes]
    (clip, _), scene = made[0], scenes[0]
    sleep, left = clip.report["sleep"], departures(clip, scene.view)
    cells = [
        f"{len(clip)} ({len(clip) / scene.time.fps:.2f} s)",
        *(f"{spent:.1f}" for _, spent in made),
        f"{pace(clip, scene.object.size):.1%}",
        f"{sleep['since'] / scene.time.fps:.2f}" if sleep else "no",
        f"{left[0].outside:.0%}" if left else "0%",
    ]
    return f"| {name} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("presets", nargs="*", default=preset_names())
    parser.add_argument("--seconds", type=float)
    parser.add_argument("--accuracy", default="draft,standard")
    arguments = parser.parse_args()
    accuracies = arguments.accuracy.split(",")
    made = {
        n: pipeline.make_gaussians(EXAMPLES / f"{n}.png").gaussians
        for n in ("duck", "potted_plant")
    }
    costs = (f"{accuracy}: s" for accuracy in accuracies)
    heads = ["preset", "clip", *costs, "moves at the end", "sleeps from [s]", "outside"]
    print(f"| {' | '.join(heads)} |\n|---|---|{'--:|' * (len(heads) - 2)}", flush=True)
    for name in arguments.presets:
        body = made["potted_plant" if name in PLANTS else "duck"]
        print(row(name, body, accuracies, arguments.seconds), flush=True)


if __name__ == "__main__":
    main()
