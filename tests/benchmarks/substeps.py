"""What a longer substep saves and costs: fractions of the stable one, scene by scene.

Each scene is run on one grid with each fraction (`accuracy.cfl`), on one thread. Printed are
processor seconds of dynamics and shapes, substeps, and RMS distances in per cent of the size from
runs on a finer grid with the smallest and with the largest fraction, joined by a stroke, so that
neither is its own judge; `torn` and why a run was stopped, where it was.

    python tests/benchmarks/substeps.py --cells 24 --finer 36 --cfl 0.6,0.75,0.85 "press duck"

Without names: every preset with the duck, and every law that flows, dropped as a cupcake.
"""

import argparse
import sys
from pathlib import Path

from phy124 import pipeline
from phy124.accuracy.convergence import distances
from phy124.gaussians import Gaussians
from phy124.scene import Scene, preset_names

sys.path.insert(0, str(Path(__file__).parent))
from bindings import ROOT, run
from presets import beginning
from promises import FLOWING, scene_of


def scenes() -> dict[str, tuple[str, Scene]]:
    """Name -> picture, scene."""
    single = [preset for preset in preset_names() if not Scene.named(preset).objects]
    found = {f"{preset} duck": ("duck", beginning(preset)) for preset in single}
    for law in FLOWING:
        found[f"drop {law} cupcake"] = ("cupcake", scene_of("drop", law, {}))
    return found


def line(name: str, gaussians: Gaussians, scene: Scene, given: argparse.Namespace) -> str:
    """A row of the table."""
    fractions = [float(fraction) for fraction in given.cfl.split(",")]
    ends = dict.fromkeys((fractions[0], fractions[-1]))
    finer = [each for f in ends if (each := run(gaussians, scene, cells=given.finer, cfl=f))]

    def cell(cfl: float) -> str:
        made = run(gaussians, scene, cells=given.cells, cfl=cfl)
        if made is None:
            return "stopped"
        errors = [100 * distances([made.means, f.means])[0, 1] for f in finer]
        error = "/".join(f"{error / scene.object.size:.2f}" for error in errors)
        return f"{made.seconds:.2f} s, {made.substeps}, {error}" + (", torn" if made.torn else "")

    return " | ".join([name, *map(cell, fractions)])


def main() -> None:
    """The table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cells", type=int, default=24, help="the grid")
    parser.add_argument("--finer", type=int, default=36, help="the grid that judges")
    parser.add_argument("--cfl", default="0.6,0.75,0.85", help="fractions, the usual one first")
    parser.add_argument("names", nargs="*", help="scenes; none: all")
    given, statics = parser.parse_args(), {}
    for name, (picture, scene) in scenes().items():
        if given.names and name not in given.names:
            continue
        if picture not in statics:
            image = ROOT / f"demo/examples/{picture}.png"
            statics[picture] = pipeline.static(image).gaussians
        print(line(name, statics[picture], scene, given), flush=True)


if __name__ == "__main__":
    main()
