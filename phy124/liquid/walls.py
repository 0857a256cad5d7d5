"""Walls of a liquid: the boundaries of a scene as shapes, each with its motion and friction."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from phy124.boundaries import Boundary
from phy124.kernels.arguments import types
from phy124.kernels.liquid import walls as kernels
from phy124.liquid.cells import FAR, Cells
from phy124.mpm import Model
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

STAGE = "walls"
"""Name of the stages in reports."""


@dataclass(frozen=True)
class Wall:
    """A single shape that the liquid does not enter."""

    name: str
    """Name of the boundary and, if it has several parts, of the part."""
    shape: str
    """Name of a distance function (phy124/kernels/distance.py)."""
    geometry: Any
    """The three vectors that the distance function reads [m]."""
    slot: int
    """Slot of the wall's displacement; 0 if it never moves."""
    friction: float
    """Coefficient of Coulomb friction."""
    sticky: bool
    """Whether the liquid sticks to it."""


def walls_of(
    boundaries: Iterable[tuple[str, Boundary]], model: Model, tracks: Tracks
) -> Iterator[Wall]:
    """Yield the walls of named boundaries, whose motions are added to the tracks."""
    t = types(model.real)
    for name, boundary in boundaries:
        parts = boundary.parts()
        for label, part in zip(boundary.part_names(), parts, strict=True):
            part.refuse_thin(model)
            track = part.track(model)
            yield Wall(
                name if len(parts) == 1 else f"{name}_{label}",
                part.outline(),
                t.mat33(*np.ravel(part.geometry(model))),
                0 if track is None else tracks.add(track),
                0.0 if part.contact == "slip" else part.friction,
                part.contact == "sticky",
            )


class Walls:
    """Records launches that describe walls to the cells, and that move particles out of walls."""

    def __init__(self, model: Model, tracks: Tracks, walls: Sequence[Wall]) -> None:
        self._model, self._tracks, self.all = model, tracks, tuple(walls)
        t, device = types(model.real), model.device
        rows = [(wall.friction, float(wall.sticky)) for wall in walls] or [(0.0, 0.0)]
        self.frictions = model.array(rows, t.vec2)
        """Friction of each wall, and 1 if it is sticky."""
        slots = [wall.slot for wall in walls] or [0]
        self.slots = wp.array(np.array(slots, np.int32), dtype=int, device=device)
        """Slot of each wall."""
        self.move = any(wall.slot for wall in walls)
        """Whether any wall moves or ends."""
        self.rub = any(wall.friction > 0 or wall.sticky for wall in walls)
        """Whether any wall has friction."""

    def describe(self, cells: Cells, worker: int, workers: int) -> list[list[Recorded]]:
        """Return a worker's launches that compute distances, and from them the shares of cells.

        Args:
            cells: The cells, which the launches write.
            worker: Index of the worker.
            workers: Number of workers.

        Returns:
            Two lists; workers wait for each other between them.
        """
        model, tracks = self._model, self._tracks
        real, lattice, window = model.real, cells.lattice, cells.window
        first, count = span(cells.points, worker, workers)
        distances = []
        for index, wall in enumerate(self.all):
            inputs = [first, index, wall.slot, wall.geometry, lattice, window, tracks.values]
            kernel = kernels.make_wall_distance(wall.shape, real)
            outputs = [cells.distances, cells.owners]
            distances.append((STAGE, model.launch(kernel, count, inputs, outputs)))
        first, count = span(8 * cells.count, worker, workers)
        for wall in self.all:
            inputs = [first, wall.slot, wall.geometry, lattice, window, tracks.values]
            kernel = kernels.make_eighths(wall.shape, real)
            distances.append((STAGE, model.launch(kernel, count, inputs, [cells.eighths])))
        first, count = span(cells.count, worker, workers)
        inputs = [first, window, cells.distances]
        openings = model.launch(kernels.make_openings(real), count, inputs, [cells.open])
        inputs = [first, window, lattice, cells.distances, cells.eighths]
        shares = model.launch(kernels.make_solid_shares(real), count, inputs, [cells.shares])
        return [distances, [(STAGE, openings), (STAGE, shares)]]

    def clear(self, cells: Cells) -> None:
        """Set all distances to a large one, and all eighths of cells to open."""
        cells.distances.fill_(FAR * self._model.dx)
        cells.eighths.fill_(1.0)
        cells.owners.fill_(-1)

    def push_out(
        self, cells: Cells, run: slice, x: wp.array, v: wp.array, sums: wp.array, *, stops: bool
    ) -> list[Recorded]:
        """Return the launches that move particles out of every wall.

        Args:
            cells: The cells.
            run: The particles of the worker.
            x: Positions of all particles [P,3].
            v: Velocities of all particles [P,3].
            sums: Sums of impulse, moment and work of each wall.
            stops: Whether the particles lose their velocity towards the wall.
        """
        model, tracks = self._model, self._tracks
        launches = []
        for index, wall in enumerate(self.all):
            kernel = kernels.make_push_out(wall.shape, model.real)
            inputs = [index, wall.slot, wall.geometry, wall.friction, int(stops), model.mass[run]]
            inputs += [cells.lattice, cells.window, tracks.values, tracks.rates, cells.distances]
            outputs = [x[run], v[run], sums]
            launch = model.launch(kernel, run.stop - run.start, inputs, outputs)
            launches.append((STAGE, launch))
        return launches


def span(count: int, worker: int, workers: int) -> tuple[int, int]:
    """Return the first item of a worker, and its number of items."""
    first, last = (count * index // workers for index in (worker, worker + 1))
    return first, last - first


def wall_kernels(boundaries: Iterable[Boundary], real: Any) -> Iterator[Any]:
    """Yield the kernels of the walls of some boundaries."""
    yield from (kernels.make_openings(real), kernels.make_solid_shares(real))
    for shape in sorted({part.outline() for wall in boundaries for part in wall.parts()}):
        yield kernels.make_wall_distance(shape, real)
        yield kernels.make_eighths(shape, real)
        yield kernels.make_push_out(shape, real)
