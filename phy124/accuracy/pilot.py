"""The pilot: the whole motion on a coarse grid, in a fraction of a second.

It shows what a probe at rest cannot: how the stable substep shrinks as the material strains and
moves. The largest strain grows with the resolution, so the substeps in excess of those at rest are
extrapolated as cells^1.8 (measured in docs/results/accuracy.md). Those at rest and those limited by
speed are proportional to the cells; those limited by a ceiling do not change. Viscosity needs a
minimum number per frame that is proportional to the square of the cells.
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
from phy124.scene import Scene
from phy124.simulation import Simulation
from phy124.simulation.parts import WHOLE, Crop

CELLS = 16
"""Cells across the object in the pilot."""
EXCESS = 0.8
"""Exponent by which excess substeps grow faster than the number of cells."""
LIMITERS = ("elastic", "speed", "gradient", "viscous", "user")


@dataclass(frozen=True)
class Pilot:
    """The substeps that the coarse motion needed."""

    cells: int
    counts: dict[str, NDArray[np.float64]]
    """Limiter -> substeps in each frame before rounding up [T]."""
    rest: float
    """Substeps per frame in the state at the start."""
    growth: float
    """Mean size of the grid's window relative to that at the start."""
    stopped: bool
    """Whether it became unstable, so that nothing is promised."""
    viscous: float = 0.0
    """Smallest number of substeps per frame that viscosity requires."""
    factors: NDArray[np.float64] | float = 1.0
    """Factor on Young's modulus in each frame [T]."""

    def substeps(self, cells: int) -> tuple[int, dict[str, float]]:
        """Number of substeps on another grid, whole in each frame, and fraction of each limiter."""
        scale = cells / self.cells
        at_rest = np.minimum(self.counts["elastic"], self.rest * np.sqrt(self.factors))
        excess = self.counts["elastic"] - at_rest
        grown = {
            **self.counts,
            "elastic": at_rest * scale + excess * scale ** (1 + EXCESS),
            "speed": self.counts["speed"] * scale,
        }
        without = np.sum([n for name, n in grown.items() if name != "viscous"], axis=0)
        ruled = without < self.viscous * scale**2
        grown = {name: np.where(ruled, 0.0, n) for name, n in grown.items()}
        grown["viscous"] = np.where(ruled, self.viscous * scale**2, 0.0)
        total = np.sum(list(grown.values()), axis=0)
        whole = float(total.sum()) or 1.0
        fractions = {name: float(n.sum()) / whole for name, n in grown.items() if n.any()}
        return int(np.ceil(total - 1e-9).sum()), fractions


def coarsened(scene: Scene) -> Scene:
    """The scene as the pilot runs it: on a coarse grid, with the binding `lattice`."""
    # No solid that the scene's own grid resolves may be too thin for the coarse one.
    cells = min(max(CELLS, cells_for(scene)), scene.resolution.cells)
    accuracy = scene.resolution.model_copy(update={"cells": cells, "precision": "float32"})
    return scene.model_copy(update={"accuracy": accuracy, "binding": "lattice"})


def cells_for(scene: Scene) -> int:
    """Fewest cells across the object whose grid nothing solid is too thin for."""
    thin = [wall.thickness() for wall in scene.with_solids().boundaries]
    thin += [float(one.half.min()) for one in scene.objects if one.free]
    finest = THINNEST * scene.object.size / min(thin, default=math.inf)
    return math.ceil(finest * (1 - 1e-9))


def fly(gaussians: Gaussians, scene: Scene, *, device: str = "cpu", crop: Crop = WHOLE) -> Pilot:
    """Run the motion on a coarse grid.

    Args:
        gaussians: The object.
        scene: The scene.
        device: Warp device.
        crop: Where the object is in the picture that the masks of parts were painted on.
    """
    coarse = coarsened(scene)
    cells = coarse.resolution.cells
    simulation = Simulation(gaussians, coarse, device=device, crop=crop)
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
