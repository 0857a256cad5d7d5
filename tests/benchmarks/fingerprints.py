"""Prints a fingerprint of every preset's clip and of every hard case, to compare two commits.

If two fingerprints are equal, the results are equal bit for bit. Run the program before and after a
change that must not change results.
"""

import hashlib
import json
import sys

import numpy as np

from phy124.gaussians import Gaussians
from phy124.materials import LAWS
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation, prepare

WALLS = [
    {"kind": "sphere", "centre": [0, 0.1, 0.1], "motion": {"kind": "swing"}},
    {"kind": "ground"},
]
VARIANTS = {
    **{f"drop {law}": ("drop", {"material.law": law}) for law in LAWS.by_name},
    "press float64": ("press", {"accuracy.precision": "float64"}),
    "sway damped": ("sway", {"material.damping": 5.0}),
    **{
        f"{name} of particles": (name, {"binding": "particles"})
        for name in ("press", "sand", "wind")
    },
    "drop on a moving ball": ("drop", {"boundaries": WALLS}),
    "wind half substep": ("wind", {"accuracy.cfl": 0.3}),
}


def body(count: int = 3000) -> Gaussians:
    """A bar with a knob, so that it bends, turns and touches at a corner."""
    rng = np.random.default_rng(4)
    means = np.concatenate(
        [
            rng.uniform((-0.1, -0.1, 0), (0.1, 0.1, 0.8), (count // 2, 3)),
            rng.uniform((-0.2, -0.3, 0.7), (0.2, 0.3, 1.0), (count // 2, 3)),
        ]
    )
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales = rng.uniform(0.01, 0.03, (count, 3))
    return Gaussians.from_rgb(
        means, quats, scales, np.full(count, 0.9), rng.uniform(size=(count, 3))
    )


def fingerprint(scene: Scene, threads: int) -> str:
    """Return the fingerprint of a clip: positions, orientations, scales and the number of
    substeps."""
    run = Simulation(prepare(body(), scene, RunContext(threads=threads)))
    clip, result = run.run(), hashlib.sha256()
    for array in (clip.means, clip.quats, clip.scales):
        result.update(np.ascontiguousarray(array).tobytes())
    return f"{result.hexdigest()[:16]} {clip.report['substeps']}"


def main() -> None:
    """All of them as one JSON object."""
    results = {}
    presets = {name: (name, {}) for name in preset_names()}
    for name, (preset, changes) in {**presets, **VARIANTS}.items():
        scene = Scene.named(preset).replaced({"accuracy.cells": 16, "time.frames": 8})
        for threads in (1, 2):
            results[f"{name}, {threads}"] = fingerprint(scene.replaced(changes), threads)
            print(name, threads, results[f"{name}, {threads}"], file=sys.stderr)
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
