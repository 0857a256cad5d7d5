"""Measures how often the interval of a fit contains the true value (docs/lab/fitting.md).

    python tests/benchmarks/coverage.py FOLDER --seeds 0 25

The points, the errors and the search depend on the seed. Each seed adds a line to
FOLDER/coverage.csv. If the program was stopped, the same command continues after the last line.
"""

import argparse
import csv
import sys
import time
from pathlib import Path

import numpy as np
from scipy.stats import beta

sys.path.insert(0, str(Path(__file__).parents[1]))

from phy124.io.clip import Clip
from phy124.io.ply import write_ply
from phy124.pipeline import make_gaussians
from phy124.scene import Scene
from phy124.studies.fit import Fit, fit
from support.twins import twin, write_points

DUCK = str(Path(__file__).parents[2] / "demo/examples/duck.png")
TRUTH, CELLS, GRIDS = 4e4, 24, [12, 16]
FRAMES = {"time.frames": 14, "time.fps": 24.0}
COLUMNS: tuple[str, ...] = ("seed", "value", "low", "high", "points_low", "points_high", "cpu")


def ends(held: int, of: int, level: float = 0.95) -> tuple[float, float]:
    """Interval of a fraction of which `held` of `of` are known (Clopper and Pearson 1934)."""
    tail = (1 - level) / 2
    low = beta.ppf(tail, held, of - held + 1) if held else 0.0
    high = beta.ppf(1 - tail, held + 1, of - held) if held < of else 1.0
    return float(low), float(high)


def fit_seed(clip: Clip | None, folder: Path, seed: int) -> dict[str, float]:
    """The fit of a seed."""
    assert clip is not None
    began, out = time.process_time(), folder / str(seed)
    out.mkdir(parents=True, exist_ok=True)
    write_points(out / "points.csv", clip, seed=seed)
    asked = {
        "target": str(out / "points.csv"),
        "object": str(folder / "object.ply"),
        "scene": "press",
        "set": {"accuracy.cells": CELLS},
        "grids": GRIDS,
        "seconds": 1e5,
        "seed": seed,
        "find": {"material.E": "1e4..2e5"},
    }
    entry = fit(Fit.from_data(asked), out).report["found"]["material.E"]
    (low, high), (least, most) = entry["interval"], entry["from_measurements"]
    result = (seed, entry["value"], low, high, least, most, time.process_time() - began)
    return dict(zip(COLUMNS, result, strict=True))


def main() -> None:
    """Run the missing seeds, then print the results of all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs=2, default=(0, 100))
    arguments = parser.parse_args()
    arguments.folder.mkdir(parents=True, exist_ok=True)
    kept = arguments.folder / "coverage.csv"
    if not kept.exists():
        kept.write_text(",".join(COLUMNS) + "\n")
    done = {int(row["seed"]) for row in csv.DictReader(kept.open())}
    left = [seed for seed in range(*arguments.seeds) if seed not in done]
    write_ply(arguments.folder / "object.ply", make_gaussians(DUCK, Scene(), count=2000).gaussians)
    scene = Scene.named("press").replaced({**FRAMES, "material.E": TRUTH})
    clip = twin(make_gaussians(DUCK, Scene(), count=3000).gaussians, scene, CELLS) if left else None
    for seed in left:
        with kept.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS).writerow(fit_seed(clip, arguments.folder, seed))
    tell(kept)


def tell(kept: Path) -> None:
    """Return how many intervals contain the true value, and the spread of the values."""
    texts = csv.DictReader(kept.open())
    rows = [{name: float(text) for name, text in row.items()} for row in texts]
    value = np.array([row["value"] for row in rows])
    for low, high in (("low", "high"), ("points_low", "points_high")):
        held = sum(row[low] <= TRUTH <= row[high] for row in rows)
        least, most = ends(held, len(rows))
        half = np.mean([(row[high] - row[low]) / 2 for row in rows])
        print(f"{low}: {held} of {len(rows)} ({least:.3f} to {most:.3f}); half width {half:.0f}")
    print(
        f"values {value.min():.0f} to {value.max():.0f}, mean {value.mean():.0f}, "
        f"deviation {value.std(ddof=1):.0f}; "
        f"{sum(row['cpu'] for row in rows):.0f} s"
    )


if __name__ == "__main__":
    main()
