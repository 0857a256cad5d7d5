"""Measures time and error for some values of a setting, scene by scene.

Each scene is run on one grid with each value, on one thread. The program prints the processor time
[s] of simulation and shapes, the number of substeps, and two RMS distances in per cent of the size.
They are the distances from runs on a finer grid with the first value and, after a slash, with the
last value. No value is thus compared only with itself. The program also prints `torn`, and the
reason if a run was stopped.

    python tests/benchmarks/setting.py accuracy.cfl 0.6 0.75 0.85 --finer 36
    python tests/benchmarks/setting.py accuracy.particles_per_axis 2 1.5 --scenes "press sand" \\
        --objects ../shared/objects/koala.splat demo/examples/duck.png

A scene is a preset, or a preset and a law that replaces the preset's law. Without `--scenes`, the
program runs every preset of one object, and drops an object with every plastic, granular or fluid
law. An object is a picture or a file of Gaussians (the bottom of those in ../shared/objects is at
-y).
"""

import argparse
import sys
from pathlib import Path

from phy124 import pipeline
from phy124.accuracy.convergence import distances
from phy124.gaussians import Gaussians
from phy124.io.formats import read_gaussians
from phy124.scene import Scene, preset_names

sys.path.insert(0, str(Path(__file__).parent))
from bindings import FLOWING, ROOT, Run, of_law, run
from presets import beginning


def scenes() -> list[str]:
    """Every preset of one object, and every plastic, granular or fluid law, dropped."""
    single = [preset for preset in preset_names() if not Scene.named(preset).objects]
    return [*single, *(f"drop {law}" for law in FLOWING)]


def scene_named(name: str) -> Scene:
    """The beginning of a preset, with another law if the name has a second word."""
    preset, _, law = name.partition(" ")
    return of_law(preset, law) if law else beginning(preset)


def gaussians_of(file: Path) -> Gaussians:
    """The object of a picture or of a file of Gaussians."""
    if file.suffix == ".png":
        return pipeline.make_gaussians(file).gaussians
    return read_gaussians(file, up="-y").gaussians


def row(name: str, gaussians: Gaussians, args: argparse.Namespace) -> str:
    """A row of the table."""
    scene, values = scene_named(name), [float(value) for value in args.values]

    def result(value: float, cells: int) -> Run | None:
        return run(gaussians, scene, {"accuracy.cells": cells, args.setting: value})

    ends = dict.fromkeys((values[0], values[-1]))
    finer = [clip for value in ends if (clip := result(value, args.finer))]

    def cell(value: float) -> str:
        clip = result(value, args.cells)
        if clip is None:
            return "stopped"
        errors = [100 * distances([clip.means, fine.means])[0, 1] for fine in finer]
        error = "/".join(f"{error / scene.object.size:.2f}" for error in errors)
        return f"{clip.seconds:.2f} s, {clip.substeps}, {error}" + (", torn" if clip.torn else "")

    return " | ".join([name, *map(cell, values)])


def main() -> None:
    """The table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("setting", help="accuracy.cfl, for example")
    parser.add_argument("values", nargs="+", help="the usual one first")
    parser.add_argument("--cells", type=int, default=24, help="the grid")
    parser.add_argument("--finer", type=int, default=36, help="the grid that judges")
    parser.add_argument("--scenes", nargs="+", default=scenes())
    parser.add_argument("--objects", nargs="+", default=[ROOT / "demo/examples/duck.png"])
    args = parser.parse_args()
    for file in map(Path, args.objects):
        gaussians = gaussians_of(file)
        for name in args.scenes:
            print(f"{file.stem} {row(name, gaussians, args)}", flush=True)


if __name__ == "__main__":
    main()
