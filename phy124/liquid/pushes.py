"""Velocity changes that forces on particles cause in each cell, for the pressure at walls.

Between the centre of a cell and a wall, the pressure changes by the weight of the liquid. A force
on particles acts like a weight, but it may differ between cells.
"""

from __future__ import annotations

from typing import cast

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.liquid.impulses import make_gains
from phy124.liquid.cells import Cells
from phy124.mpm import Model, State
from phy124.mpm.model import part_of
from phy124.mpm.stage import Named, launches

STAGE = "walls"
"""Name of the stages in reports."""


class Pushes:
    """Measures velocity changes; without forces on particles, the arrays are empty."""

    def __init__(self, model: Model, state: State, cells: Cells) -> None:
        """Store the particles and the cells.

        Args:
            model: The particles.
            state: Their positions and velocities.
            cells: The window of the grid.
        """
        self._model, self._state, self._cells = model, state, cells
        self.fit(0)

    def fit(self, copies: int) -> None:
        """Allocate the arrays for a window.

        Args:
            copies: Number of workers; 0 if no force acts on particles.
        """
        model, t, count = self._model, types(self._model.real), copies * self._cells.count
        kept = len(model) if copies else 0
        self._kept = wp.zeros(kept, dtype=t.vec3, device=model.device)
        self._copies = copies
        self.gains = wp.zeros(count, dtype=t.vec4, device=model.device)
        """Momentum that particles gain, and their mass, at each cell; a copy for each worker."""

    def keep(self, run: slice) -> list[Named]:
        """Return the launches that store velocities before forces act on a worker's particles."""
        if not self._copies:
            return []
        kept, v = part_of(self._kept, run), part_of(self._state.v, run)
        return [(STAGE, lambda: wp.copy(kept, v))]

    def add(self, worker: int, run: slice) -> list[Named]:
        """Return the launches that sum what a worker's particles gained."""
        if not self._copies:
            return []
        model, cells, s, count = self._model, self._cells, self._state, self._cells.count
        gains = cast("wp.array", self.gains[worker * count : (worker + 1) * count])
        inputs = [model.mass[run], cells.lattice, cells.window, s.x[run], s.v[run], self._kept[run]]
        launch = model.launch(make_gains(model.real), run.stop - run.start, inputs, [gains])
        return [(STAGE, gains.zero_), *launches([(STAGE, launch)])]
