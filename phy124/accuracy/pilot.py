"""The pilot: a run of the whole motion on a coarse grid, in a fraction of a second.

It shows how the stable substep shrinks as the material strains and moves, which a probe at rest
cannot. The largest strain grows with the resolution, so the substeps in excess of those at rest are
extrapolated as cells^1.8 (measured in docs/lab/forecasts.md). Numbers of substeps at rest, and
of substeps limited by speed, are proportional to the cells; that of substeps limited by
`time.substep` is constant. Viscosity needs a minimum number per frame that is proportional to the
square of the cells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries.base import THINNEST
from phy124.gaussians import Gaussians
from phy124.monitor.softening import Softening
from phy124.mpm import Unstable
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.parts import WHOLE, Crop

CELLS = 16
"""Cells across the object in the pilot."""
EXCESS = 0.8
"""Excess substeps grow as cells^(1 + EXCESS)."""
LIMITERS = ("elastic", "speed", "gradient", "viscous", "user")


@dataclass(frozen=True)
class Pilot:
    """The substeps of the motion on the coarse grid."""

    cells: int
    counts: dict[str, NDArray[np.float64]]
    """Limiter -> substeps in each frame before rounding up [T]."""
    rest: float
    """Substeps per frame in the state at the start."""
    growth: float
    """Mean size of the grid's window relative to that at the start."""
    stopped: bool
    """Whether the run became unstable, so that nothing is promised."""
    viscous: float = 0.0
    """Smallest number of substeps per frame that viscosity requires."""
    factors: NDArray[np.float64] | float = 1.0
    """Factor on Young's modulus in each frame [T]."""

    def substeps(self, cells: int) -> tuple[int, dict[str, float]]:
        """Return the number of substeps on another grid, and the fraction of each limiter.

        Each frame has a whole number of substeps.
        """
        scale = cells / self.cells
        at_rest = np.minimum(self.counts["elastic"], self.rest * np.sqrt(self.factors))
        excess = self.counts["elastic"] - at_rest
        counts = {
            **self.counts,
            "elastic": at_rest * scale + excess * scale ** (1 + EXCESS),
            "speed": self.counts["speed"] * scale,
        }
        others = np.sum([n for name, n in counts.items() if name != "viscous"], axis=0)
        is_viscous = others < self.viscous * scale**2
        counts = {name: np.where(is_viscous, 0.0, n) for name, n in counts.items()}
        counts["viscous"] = np.where(is_viscous, self.viscous * scale**2, 0.0)
        total = np.sum(list(counts.values()), axis=0)
        whole = float(total.sum()) or 1.0
        fractions = {name: float(n.sum()) / whole for name, n in counts.items() if n.any()}
        return int(np.ceil(total - 1e-9).sum()), fractions


def coarsen(scene: Scene) -> Scene:
    """Return the scene that the pilot runs: a coarse grid and the binding `lattice`."""
    # Solids that the scene's grid resolves must not be too thin for the coarse one.
    cells = min(max(CELLS, min_cells(scene)), scene.resolution.cells)
    accuracy = scene.resolution.model_copy(update={"cells": cells, "precision": "float32"})
    return scene.model_copy(update={"accuracy": accuracy, "binding": "lattice"})


def min_cells(scene: Scene) -> int:
    """Return the smallest number of cells across the object that resolves all solids."""
    thicknesses = [wall.thickness() for wall in scene.with_solids().boundaries]
    thicknesses += [float(body.half.min()) for body in scene.objects if body.free]
    cells = THINNEST * scene.object.size / min(thicknesses, default=math.inf)
    return math.ceil(cells * (1 - 1e-9))


def run_pilot(
    gaussians: Gaussians, scene: Scene, *, device: str = "cpu", crop: Crop = WHOLE
) -> Pilot:
    """Run the motion on a coarse grid.

    Args:
        gaussians: The object.
        scene: The scene.
        device: Warp device.
        crop: Rectangle of the object in the picture on which masks of parts were painted.
    """
    coarse = coarsen(scene)
    cells = coarse.resolution.cells
    simulation = Simulation(prepare(gaussians, coarse, RunContext(device=device), crop=crop))
    solver, timing = simulation.solver, scene.time
    softening = simulation.find(Softening)
    counts = {name: np.zeros(timing.frames - 1) for name in LIMITERS}
    factors = scene.softnesses(np.arange(timing.frames - 1) / timing.fps)
    nodes, rest = [], 0.0
    stopped = False
    try:
        solver.step(0.0, 0.0)
        stiffness = solver.clock.extremes.stiffness
        rest = math.sqrt(stiffness) / (solver.clock.cfl * solver.model.dx) / timing.fps
        for frame in range(timing.frames - 1):
            before = dict(solver.clock.needed)
            if softening is not None:
                softening.follow(float(factors[frame]))
            solver.advance((frame + 1) / timing.fps)
            for name, needed in solver.clock.needed.items():
                counts[name][frame] = needed - before.get(name, 0.0)
            nodes.append(solver.grid.count)
    except Unstable:
        stopped = True
    growth = float(np.mean(nodes) / nodes[0]) if nodes else 1.0
    viscous = 1 / (solver.clock.viscous * timing.fps)
    return Pilot(cells, counts, rest, growth, stopped, viscous, factors)
