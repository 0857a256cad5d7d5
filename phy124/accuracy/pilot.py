"""The pilot: the whole motion on a coarse grid, in a fraction of a second.

It tells what a probe at rest cannot: how the stable substep shrinks as the material strains and
moves. The strain at its worst place grows with resolution, so the substeps in excess of those at
rest are extrapolated as cells^1.7 (docs/accuracy.md has the measurements); those at rest and
those limited by speed go with the cells, those limited by a ceiling do not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.mpm import Unstable
from phy124.scene import Scene
from phy124.simulation import Simulation

CELLS = 12
"""Cells across the object in the pilot."""
EXCESS = 0.7
"""Exponent with which excess substeps grow faster than the number of cells."""
LIMITERS = ("elastic", "speed", "gradient", "viscous", "user")


@dataclass(frozen=True)
class Pilot:
    """What the coarse motion needed."""

    cells: int
    counts: dict[str, NDArray[np.float64]]
    """Substeps in each frame before rounding up [T], by limiter."""
    rest: float
    """Substeps per frame if it stayed as it is at the start."""
    growth: float
    """Mean size of the grid window over that at the start."""
    stopped: bool
    """Whether it became unstable; nothing is promised then."""

    def substeps(self, cells: int, *, cfl: float = 1.0) -> tuple[int, dict[str, float]]:
        """Substeps on another grid, and the share of each limiter; `cfl` relative to the pilot's.

        Each frame is a whole number of substeps.
        """
        scale, frames = cells / self.cells, []
        elastic = self.counts.get("elastic", np.zeros(0))
        at_rest = np.minimum(elastic, self.rest)
        frames.append((at_rest * scale + (elastic - at_rest) * scale ** (1 + EXCESS)) / cfl)
        frames.append(self.counts.get("speed", 0 * elastic) * scale)
        others = [n for name, n in self.counts.items() if name not in ("elastic", "speed")]
        total = np.ceil(np.sum([*frames, *others], axis=0))
        sums = {name: float(n.sum()) for name, n in self.counts.items()}
        sums["elastic"], sums["speed"] = float(frames[0].sum()), float(frames[1].sum())
        whole = sum(sums.values()) or 1.0
        return int(total.sum()), {name: n / whole for name, n in sums.items() if n}


def fly(gaussians: Gaussians, scene: Scene, *, device: str = "cpu") -> Pilot:
    """Run the motion coarsely, the Gaussians riding along."""
    cells = min(CELLS, scene.resolution.cells)
    accuracy = scene.resolution.model_copy(update={"cells": cells, "precision": "float32"})
    coarse = scene.model_copy(update={"accuracy": accuracy, "binding": "field"})
    simulation = Simulation(gaussians, coarse, device=device)
    solver, timing = simulation.solver, scene.time
    counts = {name: np.zeros(timing.frames - 1) for name in LIMITERS}
    nodes, rest, frame = [], 0.0, 0

    def after() -> None:
        limit = solver.substep()
        counts[limit.limiter][frame] += solver.last_dt / limit.dt

    stopped = False
    try:
        solver.step(0.0, 0.0)
        stiffness = solver.extremes.stiffness
        rest = math.sqrt(stiffness) / (solver.cfl * solver.dx) / timing.fps
        for frame in range(timing.frames - 1):
            solver.advance((frame + 1) / timing.fps, after=after)
            nodes.append(solver.grid.count)
    except Unstable:
        stopped = True
    used = {name: n for name, n in counts.items() if n.any()}
    growth = float(np.mean(nodes) / nodes[0]) if nodes else 1.0
    return Pilot(cells, used or {"elastic": counts["elastic"]}, rest, growth, stopped)
