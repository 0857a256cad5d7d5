"""Solves equations on the cells of liquid by conjugate gradients, in parallel."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import warp as wp

from phy124.kernels.liquid import conjugate, rigid
from phy124.kernels.liquid.conjugate import RESIDUAL, RIGHT, ROWS
from phy124.kernels.liquid.listed import count_liquid, list_liquid
from phy124.liquid.cells import Cells
from phy124.mpm import Model
from phy124.mpm.stage import Recorded

STAGE = "pressure"
PARTS = 512
"""Number of parts of the list of cells on a GPU; on a CPU, each worker handles one part."""
MOST = 400
"""Largest number of iterations for a solution."""
CHECK = 8
"""Number of iterations between two checks on a GPU; each check waits for the GPU."""
MAKERS = conjugate.make_begin, conjugate.make_advance, conjugate.make_improve
"""Factories of the kernels of an iteration."""


class Projection:
    """Records and repeats the kernel launches that solve an equation by conjugate gradients."""

    def __init__(self, model: Model, workers: int, solids: int = 0) -> None:
        self.solids = solids
        self._model, self._workers = model, workers
        self._parts = parts_on(model.device, workers)
        self._form = form_on(model.device)
        device = model.device
        self.counts = wp.zeros(self._parts, dtype=int, device=device)
        """Number of cells of liquid in each part of the list."""
        self.sums = wp.zeros((ROWS + 6 * solids, self._parts), dtype=wp.float64, device=device)
        self.mobility = wp.zeros((solids, 10), dtype=wp.float64, device=device)
        """Motion of each solid per unit impulse; impulses have the units of q = p dt / (rho dx)."""
        shape = (self._parts, 2 * solids)
        self._responses = wp.zeros(shape, dtype=wp.vec3d, device=device)
        """Velocity and angular velocity of each solid that the pressures in each part cause."""

    def part(self, worker: int) -> tuple[int, int]:
        """Return the first part that a worker handles, and the number of its parts."""
        return (worker, 1) if self._parts == self._workers else (0, self._parts)

    @property
    def every(self) -> int:
        """Number of iterations between two checks of the residual."""
        return 1 if self._model.device == "cpu" else CHECK

    def list_cells(
        self, cells: Cells, worker: int, flags: wp.array
    ) -> tuple[list[Recorded], list[Recorded]]:
        """Return the kernel launches that count and then list the active cells whose flag is 1."""
        launch, (part, parts) = self._model.launch, self.part(worker)
        inputs = [part, cells.active, cells.ends, flags]
        count = launch(count_liquid, parts, inputs, [self.counts])
        listed = launch(list_liquid, parts, [*inputs, self.counts], [cells.listed])
        return [(STAGE, count)], [(STAGE, listed)]

    def phases(
        self, cells: Cells, x: wp.array, worker: int, *, rigid: bool = False
    ) -> list[list[Recorded]]:
        """Return a worker's kernel launches that solve an equation.

        The first list of launches begins the solution. Three pairs of lists (advance, improve)
        follow: one pair for the first iteration, one for odd iterations, and one for even
        iterations.

        Args:
            cells: The cells.
            x: The solution; initially the first guess.
            worker: Index of the worker.
            rigid: Whether solids move with the liquid.
        """
        launch, (part, parts) = self._model.launch, self.part(worker)
        begin, advance, improve = (make(self._form) for make in MAKERS)
        row, layer = cells.strides
        listed, equation = [self.counts, cells.listed], [cells.diagonal, cells.links]
        rows, some = [cells.which, cells.jumps, cells.turns], self.solids if rigid else 0
        inputs = [part, row, layer, some, *listed, *equation, cells.right, x, *rows, self.mobility]
        outputs = [
            self._responses,
            cells.inverse,
            cells.residual,
            cells.z,
            cells.directions[1],
            self.sums,
        ]
        phases: list[list[Recorded]] = [[(STAGE, launch(begin, parts, inputs, outputs))]]
        for begun, turn in ((0, 0), (1, 1), (1, 0)):
            before, after = cells.directions[1 - turn], cells.directions[turn]
            inputs = [
                part,
                turn,
                begun,
                row,
                layer,
                some,
                *listed,
                *equation,
                cells.z,
                before,
                *rows,
            ]
            outputs = [after, cells.product, self.sums]
            phases.append([(STAGE, launch(advance, parts, inputs, outputs))])
            inputs = [part, turn, row, layer, some, *listed, cells.links, cells.inverse]
            inputs += [after, *rows, self.mobility]
            outputs = [self._responses, cells.product, x, cells.residual, cells.z, self.sums]
            phases.append([(STAGE, launch(improve, parts, inputs, outputs))])
        return phases

    def project(self, cells: Cells, x: wp.array, worker: int) -> list[Recorded]:
        """Return a worker's kernel launch that sums the impulse of the pressure on each solid."""
        part, parts = self.part(worker)
        inputs = [part, self.solids, self.counts, cells.listed, cells.which]
        inputs += [cells.jumps, cells.turns, x]
        return [(STAGE, self._model.launch(rigid.project, parts, inputs, [self.sums]))]

    def solve(self, run: Callable[[int], None], begin: int, tolerance: float) -> int:
        """Iterate until the residual is small; return the number of iterations.

        Args:
            run: Runs a phase of all workers.
            begin: Index of the first phase of the solution.
            tolerance: Largest residual, relative to the largest right-hand side.
        """
        run(begin)
        pairs = [begin + 1, begin + 3, begin + 5]
        taken = 0
        for k in range(MOST):
            advance = pairs[0] if k == 0 else pairs[2 - k % 2]
            run(advance)
            # All workers have finished the phase before `advance`, so the sums of this phase are
            # complete.
            if k % self.every == 0 and self.small(tolerance):
                break
            run(advance + 1)
            taken = k + 1
        return taken

    def small(self, tolerance: float) -> bool:
        """Return whether the residual is small, relative to the largest right-hand side."""
        sums: Any = self.sums.numpy()
        largest, right = np.max(sums[[RESIDUAL, RIGHT]], axis=1).tolist()
        return largest <= tolerance * right or right == 0.0


def parts_on(device: str, workers: int) -> int:
    """Return the number of parts of the list of cells on a device."""
    return workers if device == "cpu" else PARTS


def form_on(device: str) -> str:
    """Return the implementation on a device: "native" or "plain"."""
    return "native" if device == "cpu" else "plain"


def kernels(device: str) -> Iterator[Any]:
    """Yield the kernels that solve an equation by conjugate gradients."""
    yield from (count_liquid, list_liquid, rigid.project)
    yield from (make(form_on(device)) for make in MAKERS)
