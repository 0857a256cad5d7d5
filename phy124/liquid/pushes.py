"""Measures velocity changes by forces on particles, for the pressure at walls and the work.

The pressure at a wall differs from the pressure at the centre of a cell by the weight of the liquid
in between; a force on particles acts like an additional weight. The work of an impulse is the
impulse times the mean of two velocities: before the force acts, and at the end of the step.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any, cast

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.liquid.energies import make_push_work
from phy124.kernels.liquid.impulses import make_gains
from phy124.kernels.reduction import shared_out
from phy124.liquid.cells import Cells
from phy124.mpm import Model, State
from phy124.mpm.model import part_of
from phy124.mpm.stage import Named, Recorded, Stage, launches

STAGE, WORK = "walls", "external work"


class Pushes:
    """Changes of velocities by forces; the arrays are empty if no forces act on particles."""

    def __init__(self, model: Model, state: State, cells: Cells) -> None:
        self._model, self._state, self._cells = model, state, cells
        self.sums: wp.array | None = None
        """Impulse and work of forces on particles, for each worker [W,16]; None: not summed."""
        self.fit(0, (), in_cells=False)

    def fit(self, workers: int, stages: Sequence[Stage], *, in_cells: bool) -> None:
        """Allocate the arrays for the cells of a window.

        Args:
            workers: Number of workers.
            stages: Stages of forces on particles.
            in_cells: Whether the velocity changes in the cells are needed.
        """
        model, t = self._model, types(self._model.real)
        self._in_cells = bool(stages) and in_cells
        self._works = bool(stages) and bool(self.sums)
        keeps = [self._in_cells or self._works, self._works]
        turns = self._works and not all(stage.keeps_C for stage in stages)
        self._v = [self._empty(t.vec3, keep) for keep in keeps]
        self._C = [self._empty(t.mat33, turns) for _ in keeps]
        count = workers * self._cells.count if self._in_cells else 0
        self.gains = wp.zeros(count, dtype=t.vec4, device=model.device)
        """Momentum that particles gained by forces, and mass, in each cell; a copy per worker."""

    def _empty(self, dtype: Any, needed: bool) -> wp.array:
        return wp.zeros(len(self._model) if needed else 0, dtype=dtype, device=self._model.device)

    def keep(self, run: slice) -> list[Named]:
        """Return the kernel launches that store a worker's velocities before forces act."""
        return self._copy(0, run)

    def _copy(self, index: int, run: slice) -> list[Named]:
        s = self._state
        pairs = [(self._v[index], s.v), (self._C[index], s.C)]
        parts = [(part_of(kept, run), part_of(a, run)) for kept, a in pairs if len(kept)]
        return [(STAGE, partial(wp.copy, kept, a)) for kept, a in parts]

    def add(self, worker: int, run: slice) -> list[Named]:
        """Return the kernel launches that sum the momentum that particles gained by forces."""
        if not self._in_cells:
            return self._copy(1, run)
        model, cells, s, count = self._model, self._cells, self._state, self._cells.count
        gains = cast("wp.array", self.gains[worker * count : (worker + 1) * count])
        inputs = [model.mass[run], cells.lattice, cells.window, s.x[run], s.v[run], self._v[0][run]]
        launch = model.launch(make_gains(model.real), run.stop - run.start, inputs, [gains])
        return [*self._copy(1, run), (STAGE, gains.zero_), *launches([(STAGE, launch)])]

    def work(self, worker: int, run: slice) -> list[Recorded]:
        """Return the kernel launch that sums a step's impulse and work of forces on particles."""
        if not self._works:
            return []
        model, s = self._model, self._state
        threads, *fraction = shared_out(run.stop - run.start, model.device)
        before, after = (part_of(v, run) for v in self._v)
        inputs = [*fraction, model.mass[run], model.dx, s.v[run], s.C[run], before, after]
        inputs += [part_of(C, run) for C in self._C]
        row = cast("wp.array", cast("wp.array", self.sums)[worker])
        return [(WORK, model.launch(make_push_work(model.real), threads, inputs, [row]))]
