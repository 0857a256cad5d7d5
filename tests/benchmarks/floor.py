"""Measures how deep flowing materials end below the floor (docs/lab/physics.md), a JSON line each.

The scene is the preset `drop` with the cupcake. `python tests/benchmarks/floor.py draft standard
fine` runs three accuracies; `fine` takes minutes.
"""

import json
import sys
from pathlib import Path

from phy124.materials import LAWS
from phy124.pipeline import make_gaussians
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

CUPCAKE = Path(__file__).parents[2] / "demo/examples/cupcake.png"
DEEP = 0.2
"""Depth that counts, in cells."""


def measured(law: str, accuracy: str) -> dict[str, object]:
    """Shares of the Gaussians and particles deeper than `DEEP` at the end, and the deepest."""
    scene = Scene.named("drop").replaced({"material.law": law, "accuracy": accuracy})
    made = make_gaussians(CUPCAKE, scene)
    run = Simulation(prepare(made.gaussians, scene, crop=made.crop))
    heights = run.run().means[-1, :, 2] / scene.dx
    particles = run.solver.state.x.numpy()[:, 2] / scene.dx
    return {
        "law": law,
        "accuracy": accuracy,
        "gaussians %": round(100 * float((heights < -DEEP).mean()), 3),
        "particles %": round(100 * float((particles < -DEEP).mean()), 3),
        "deepest": round(float(heights.min()), 2),
    }


if __name__ == "__main__":
    for accuracy in sys.argv[1:] or ["draft"]:
        for law in (name for name, kind in LAWS.by_name.items() if kind().device_law.project):
            print(json.dumps(measured(law, accuracy)), flush=True)
