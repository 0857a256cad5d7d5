"""Computes a motion on a finer grid with other particles, as a camera would track it."""

import csv

import numpy as np

from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.rendering.framing import cameras
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

POINTS = 80
ACROSS = 12
"""Side of squares, in each of which only the nearest Gaussian counts as visible [pixels]."""


def twin(gaussians: Gaussians, scene: Scene, cells: int) -> Clip:
    """Compute the motion with a grid and particles that are not used in fits."""
    finer = {"accuracy.cells": cells, "accuracy.particles_per_axis": 2.3, "wrenches": True}
    made = scene.replaced({**finer, "view.fit": False, "grains": False})
    return Simulation(prepare(gaussians, made, RunContext(threads=1))).run().surface


def write_points(path, clip: Clip, *, seed: int, pixels: float = 1.0) -> None:
    """Track some Gaussians that the front camera sees, with errors of some pixels."""
    random = np.random.default_rng(seed)
    seen = cameras(clip, Scene.from_data(clip.scene).view, "front")
    places, depth = seen[0].project(clip.means[0])
    nearest: dict[tuple, int] = {}
    for number, square in enumerate(map(tuple, (places // ACROSS).astype(int))):
        if square not in nearest or depth[number] < depth[nearest[square]]:
            nearest[square] = number
    chosen = random.choice(sorted(nearest.values()), min(POINTS, len(nearest)), replace=False)
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", "id", "u", "v"])
        for time, camera, means in zip(clip.times, seen, clip.means, strict=True):
            tracked = camera.project(means[chosen])[0]
            tracked += pixels * random.standard_normal(tracked.shape)
            rows.writerows([f"{time:.5f}", n, *uv] for n, uv in zip(chosen, tracked, strict=True))


def write_forces(path, clip: Clip, *, seed: int, part: float = 0.03) -> None:
    """Return the forces on the walls, with relative errors."""
    random = np.random.default_rng(seed)
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time", "wall", "fx", "fy", "fz"])
        for time, wrenches in zip(clip.times, clip.wrenches, strict=True):
            for wall, (force, _) in zip(clip.walls, wrenches, strict=True):
                rows.writerow(
                    [f"{time:.5f}", wall, *force * (1 + part * random.standard_normal(3))]
                )
