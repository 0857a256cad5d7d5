"""Compares cost and error of the bindings `particles` and `lattice`, scene by scene.

Each scene is run on several grids with both bindings, by the material point method on one thread.
The program prints the processor time [s] of simulation and shapes on each grid, and two errors on
all grids except the finest. The errors are RMS distances in per cent of the size: from the finest
run with `particles`, and, after a slash, from the finest run with `lattice`. Neither binding is
thus compared only with itself. If a run was stopped or may be torn, the second grid is missing, and
the program prints the reason.

    python tests/benchmarks/bindings.py --cells 16,24,32 "press sunflower" "drop teddy"

Without names, the program runs every preset with both pictures, and drops a cupcake with every law
that flows.
"""

import argparse
import itertools
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124 import pipeline
from phy124.accuracy.convergence import distances
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.materials import LAWS
from phy124.runtime.context import RunContext
from phy124.scene import Scene, preset_names
from phy124.simulation import Simulation, prepare

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning

ROOT = Path(__file__).parents[2]
PICTURES = ("sunflower", "teddy")
BINDINGS = ("particles", "lattice")
FLOWING = [law for law, material in LAWS.by_name.items() if material().device_law.project]
"""Laws that are plastic, granular or fluid."""


class Run(NamedTuple):
    """The compared results of a run."""

    means: NDArray[np.float32]
    """Centres of the Gaussians of the surface [T,N,3], m."""
    seconds: float
    """Processor seconds of dynamics and shapes."""
    substeps: int
    torn: bool


def scenes() -> dict[str, tuple[str, Scene]]:
    """Name -> picture, scene."""
    results = {
        f"{preset} {picture}": (picture, beginning(preset))
        for preset in preset_names()
        for picture in PICTURES
    }
    for law in FLOWING:
        results[f"drop {law} cupcake"] = ("cupcake", of_law("drop", law))
    return results


def of_law(preset: str, law: str) -> Scene:
    """Return the beginning of a preset with the default material of a law."""
    return beginning(preset).replaced({"material": {"law": law}})


def run(gaussians: Gaussians, scene: Scene, changes: dict[str, Any]) -> Run | None:
    """A run of a changed scene on one thread; None if it cannot be made or was stopped."""
    try:
        scene = scene.replaced({"time.budget": 1e6, **changes})
        simulation = Simulation(prepare(gaussians, scene, RunContext(threads=1)))
    except InputError as error:
        print(f"  {changes}: {error}", file=sys.stderr)
        return None
    start = time.process_time()
    clip = simulation.run()
    seconds = time.process_time() - start
    if not clip.report["complete"]:
        print(f"  {changes}: {simulation.stopped}", file=sys.stderr)
        return None
    torn = clip.report["balance"].get("tearing", {}).get("likely", False)
    return Run(clip.surface.means, seconds, clip.report["substeps"], torn)


def line(name: str, gaussians: Gaussians, scene: Scene, grids: list[int]) -> str:
    """A row of the table."""
    pairs, mpm = itertools.product(grids, BINDINGS), {"accuracy.solver": "mpm"}
    runs = {
        (c, b): run(gaussians, scene, {"accuracy.cells": c, "binding": b, **mpm}) for c, b in pairs
    }
    finest = [each for b in BINDINGS if (each := runs[grids[-1], b])]

    def cell(cells: int, binding: str) -> str:
        made = runs[cells, binding]
        if made is None:
            return "stopped"
        said = f"{made.seconds:.2f} s" + (", torn" if made.torn else "")
        if cells == grids[-1]:
            return said
        errors = [100 * distances([made.means, f.means])[0, 1] for f in finest]
        return f"{said}, " + "/".join(f"{error / scene.object.size:.2f}" for error in errors)

    cells = [f"D/{c}: {cell(c, 'particles')}; {cell(c, 'lattice')}" for c in grids]
    return " | ".join([name, *cells])


def main() -> None:
    """The table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cells", default="16,24,32", help="grids, from coarse to fine")
    parser.add_argument("names", nargs="*", help="scenes; none: all")
    arguments = parser.parse_args()
    grids, statics = [int(c) for c in arguments.cells.split(",")], {}
    for name, (picture, scene) in scenes().items():
        if arguments.names and name not in arguments.names:
            continue
        if picture not in statics:
            image = ROOT / f"demo/examples/{picture}.png"
            statics[picture] = pipeline.make_gaussians(image).gaussians
        print(line(name, statics[picture], scene, grids), flush=True)


if __name__ == "__main__":
    main()
