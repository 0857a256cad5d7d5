"""Sums the work on a liquid in every step, for each cause separately."""

from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.liquid import energies as kernels
from phy124.kernels.reduction import shared_out
from phy124.liquid.cells import Cells
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.walls import Walls
from phy124.mpm import Model, State
from phy124.mpm.kept import Kept
from phy124.mpm.model import part_of
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

STAGE = "dissipation"
ROOM = 16
"""Length of each worker's array of sums, chosen so that no two workers write to one cache line."""


class Works(NamedTuple):
    """Work on the liquid since the start [J]; negative if the liquid lost energy."""

    walls: float
    viscous: float
    """Work of viscosity, also at walls to which the liquid sticks."""
    friction: float
    """Work of friction at walls, and of impacts of particles on walls."""
    projection: float
    """Work of the pressure, of solids and of bodies, but not of walls."""
    density: float
    """Work of the uniform acceleration while particles are displaced."""


class Energies(Kept):
    """Records the kernel launches that sum mechanical work, after `start` has been called."""

    kept = ("_sums",)

    def __init__(self, model: Model, state: State, cells: Cells, workers: int) -> None:
        self._model, self._state, self._cells = model, state, cells
        self._sums = wp.zeros((workers, ROOM), dtype=wp.float64, device=model.device)
        self.on = False

    def start(self) -> None:
        """Sum the work of all causes, starting when kernel launches are next recorded."""
        self.on = True

    def fit(
        self, walls: Walls, count: int, tracks: Tracks, impulses: WallImpulses, gains: wp.array
    ) -> None:
        """Store the objects whose work is summed, and allocate the arrays of a window.

        Args:
            walls: The walls, then the freely moving solids and the bodies.
            count: Number of walls without solids and bodies.
            tracks: Quantities that change over time.
            impulses: Sums of the walls' impulses.
            gains: For each worker and cell, the particles' mass and the momentum gained by forces.
        """
        self._walls, self._tracks, self._impulses = walls, tracks, impulses
        self._gains, self._fixed = gains, count
        if self.on:
            self._before = wp.zeros_like(self._cells.velocity)

    def before_pressure(self, worker: int) -> list[Recorded]:
        """Return the kernel launches that store velocities and sum the work of the walls' drag."""
        if not self.on:
            return []
        cells, keep = self._cells, kernels.make_keep(self._model.real)
        copy = cells.record(worker, keep, [cells.velocity], [self._before])
        return [(STAGE, copy), *self.of_walls(kernels.AT_DRAG, worker)]

    def of_walls(self, at: int, worker: int) -> list[Recorded]:
        """Return the kernel launch that sums the work of walls since the start of the step."""
        if not (self.on and self._walls.all):
            return []
        inputs = [at, self._fixed, self._walls.motions, self._impulses.rows(worker)]
        kernel = kernels.make_wall_work(self._model.real)
        return [(STAGE, self._model.launch(kernel, 1, inputs, [self._row(worker)]))]

    def of_faces(self, worker: int, viscosity: float) -> list[Recorded]:
        """Return a worker's kernel launch that sums the work on the faces of cells.

        `viscosity` is 0 if no liquid is viscous.
        """
        if not self.on:
            return []
        cells, tracks = self._cells, self._tracks
        inputs = [viscosity, cells.window, tracks.clock, tracks.values]
        inputs += [cells.open, cells.liquid, cells.known]
        inputs += [part_of(cells.sums, slice(0, cells.count))]
        inputs += [self._gains, self._before, cells.velocity, cells.other]
        kernel = kernels.make_face_work(self._model.real)
        return [(STAGE, cells.record(worker, kernel, inputs, [self._row(worker)]))]

    def of_shifts(self, worker: int, run: slice, sign: float) -> list[Recorded]:
        """Return a worker's kernel launch that sums the work of displacements; `sign` is -1 before
        the particles are displaced, and 1 afterwards.
        """
        if not self.on:
            return []
        threads, *fraction = shared_out(run.stop - run.start, self._model.device)
        inputs = [sign, *fraction, self._model.mass[run], self._tracks.values, self._state.x[run]]
        kernel = kernels.make_shift_work(self._model.real)
        return [(STAGE, self._model.launch(kernel, threads, inputs, [self._row(worker)]))]

    def read(self) -> Works:
        """Return the work on the liquid since the start."""
        total: NDArray[Any] = np.asarray(self._sums.numpy()).sum(axis=0)
        drag, pressure, end = (
            total[at : at + 2] for at in (kernels.AT_DRAG, kernels.AT_PRESSURE, kernels.AT_END)
        )
        return Works(
            walls=float(end[0]),
            viscous=float(total[kernels.VISCOUS] - drag[0]),
            friction=float((end - drag) @ (-1.0, 1.0)),
            projection=float(total[kernels.PRESSED] - (pressure - drag)[0]),
            density=float(total[kernels.SHIFTED]),
        )

    def clear(self) -> None:
        """Set the work to zero."""
        self._sums.zero_()

    def _row(self, worker: int) -> wp.array:
        return cast("wp.array", self._sums[worker])


def energy_kernels(real: Any) -> Iterator[Any]:
    """Yield the kernels that sum the work on a liquid."""
    yield from (kernels.make_keep(real), kernels.make_face_work(real))
    yield from (kernels.make_wall_work(real), kernels.make_shift_work(real))
