"""Measures the cost of recording a run on disk: the same run with and without recording, in turn.

`python tests/benchmarks/recording.py [PAIRS]` prints seconds of each, and the difference.
"""

import statistics
import sys
import tempfile
import time
from pathlib import Path

from phy124 import pipeline
from phy124.gaussians import Gaussians
from phy124.io import files
from phy124.runtime.startup import start
from phy124.scene import Scene

DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
SCENES = {
    "draft, 120 frames": {"accuracy": "draft", "time.frames": 120, "time.sleep": False},
    "standard, 22 frames": {},
}


def seconds(gaussians: Gaussians, scene: Scene, *, kept: bool) -> tuple[float, float]:
    """Seconds of the clock and of the processor that a run without films takes."""
    usual, files.LOCKS_AVAILABLE = files.LOCKS_AVAILABLE, kept and files.LOCKS_AVAILABLE
    try:
        with tempfile.TemporaryDirectory(dir=".") as out:
            clock, processor = time.perf_counter(), time.process_time()
            pipeline.simulate(gaussians, scene, out, films=False, keep=True, threads=1)
            return time.perf_counter() - clock, time.process_time() - processor
    finally:
        files.LOCKS_AVAILABLE = usual


def main() -> None:
    """Print a line for each scene."""
    start()
    pairs = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    for name, changes in SCENES.items():
        scene = Scene.named("press").replaced(changes)
        gaussians = pipeline.make_gaussians(DUCK, scene).gaussians
        seconds(gaussians, scene, kept=True)
        results: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
        for _ in range(pairs):
            for kept in (False, True):
                results[kept].append(seconds(gaussians, scene, kept=kept))
        for place, what in enumerate(("clock", "processor")):
            without, kept = ([row[place] for row in results[k]] for k in (False, True))
            more = [b / a - 1 for a, b in zip(without, kept, strict=True)]
            print(
                f"{name:<22}{what:<10} without {min(without):6.2f} s, with {min(kept):6.2f} s "
                f"(least of {pairs}), median of the pairs {statistics.median(more):+.1%}"
            )


if __name__ == "__main__":
    main()
