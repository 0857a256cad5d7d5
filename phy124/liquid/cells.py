"""Arrays of a liquid in a window of the staggered grid that follows the particles."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.liquid.active import EMPTY
from phy124.kernels.liquid.faces import sums
from phy124.mpm import Model, Unstable
from phy124.mpm.grid import FARTHEST
from phy124.mpm.stage import Repeatable

MARGIN = 10
"""Margin between the particles and the border of a new window [cells]."""
LEAST = 5
"""Smallest margin around the particles before a larger window is allocated [cells]. A step moves
particles by up to two cells, and B-splines reach two cells further.
"""
LARGEST = 32
"""Largest margin around the particles before a smaller window is allocated [cells]."""
MOST_CELLS = 2**22
"""Largest number of cells in a window."""
BULK = 0.01
"""If the number of cells is limited, the window is placed around the particles without this
fraction at each end of each axis.
"""
FAR = 1e3
"""Distance that is stored if no wall is near [cells]."""


ROOM = 4
"""A solid changes the cells up to this distance from its surface [cells]."""


def needed_cells(lower: NDArray, upper: NDArray, dx: float) -> NDArray:
    """Return the sides [3] of a window around a box, including the margins [cells]."""
    return (upper - lower) / dx + 2 * MARGIN


def restrict(x: NDArray, dx: float, most: float) -> tuple[NDArray, NDArray, int]:
    """Return the lower and the upper corner [3], m, of a box, and the number of particles outside
    the window around the box. The window has at most `most` cells.
    """
    x = x.astype(np.float64)
    lower, upper = np.quantile(x, (BULK, 1 - BULK), axis=0)
    half = dx * (_shorten(needed_cells(lower, upper, dx), most) / 2 - MARGIN)
    middle = np.median(x, axis=0)
    lower, upper = np.maximum(lower, middle - half), np.minimum(upper, middle + half)
    inside = (x > lower - MARGIN * dx) & (x < upper + MARGIN * dx)
    return lower, upper, int((~inside.all(axis=1)).sum())


def _shorten(sides: NDArray, most: float) -> NDArray:
    """Shorten the longest sides of a box to a common length, so that their product is at most
    `most`.
    """
    ordered = np.sort(sides)
    for kept in range(3):
        length = (most / ordered[:kept].prod()) ** (1 / (3 - kept))
        if length <= ordered[kept]:
            return np.minimum(sides, length)
    return sides


class Region:
    """A movable box of cells in a window."""

    def __init__(self, size: NDArray, device: Any) -> None:
        self.size = size
        corners = np.stack([np.zeros(3, int), size]).astype(np.int32)
        self.box = wp.array(corners, dtype=wp.vec3i, device=device)
        """First cell of the box in the window, and the size of the box."""

    def place(self, low: NDArray) -> None:
        """Move the box so that its first cell is `low` [3]."""
        self.box.assign(np.stack([low, self.size]).astype(np.int32))


class OverActive:
    """A kernel launch on the CPU with one thread per active cell of a worker.

    In a cheap kernel, a thread without work takes as long as a thread that processes a cell.
    """

    def __init__(self, launch: wp.Launch, ends: NDArray[np.int32]) -> None:
        self.recorded, self._ends = launch, ends

    def launch(self) -> None:
        """Repeat the kernel launch for the active cells."""
        count = int(self._ends[1] - self._ends[0])
        if count != self.recorded.bounds.size:
            self.recorded.set_dim(count)
        if count:
            self.recorded.launch()


class Cells:
    """The arrays of a window: sums, velocities, walls, and the pressure equation."""

    def __init__(self, model: Model, copies: int) -> None:
        self._model, self._copies = model, copies
        self._t = types(model.real)
        self.lattice = self._t.vec4(*model.origin, model.dx)
        self.origin, self.dx = np.array(model.origin), model.dx
        self.window = wp.zeros(2, dtype=wp.vec3i, device=model.device)
        self.low, self.size = np.zeros(3, int), np.zeros(3, int)
        self.pressure = self._zeros(0, wp.float64)
        self._regions: dict[int, Region] = {}
        self._kept: list[wp.array] = []

    @property
    def count(self) -> int:
        """Number of cells in the window."""
        return int(np.prod(self.size))

    @property
    def strides(self) -> tuple[int, int]:
        """Memory strides between neighbouring rows and layers of cells."""
        return int(self.size[2]), int(self.size[1] * self.size[2])

    @property
    def points(self) -> int:
        """Number of points, half a cell apart, at which distances are computed."""
        return int(np.prod(2 * self.size + 1))

    def fit(self, lower: NDArray, upper: NDArray) -> bool:
        """Fit the window to the particles and a margin; return whether the window changed.

        Raises:
            Unstable: The particles are so far away that cells cannot be numbered.
        """
        model = self._model
        if not np.all(np.abs([lower, upper]) < FARTHEST * model.dx):
            raise Unstable(f"particles flew {FARTHEST:.0e} cells away")
        low = np.floor((lower - model.origin) / model.dx).astype(int)
        high = np.floor((upper - model.origin) / model.dx).astype(int) + 1
        spare = [*(low - self.low).tolist(), *(self.low + self.size - high).tolist()]
        if self.count and min(spare) >= LEAST and max(spare) <= LARGEST:
            return False
        self.rebase(low - MARGIN, high - low + 2 * MARGIN)
        return True

    def rebase(self, low: NDArray, size: NDArray) -> None:
        """Set the window to `size` [3] cells from the cell `low` [3] on; old pressures are kept."""
        kept = self.pressure.numpy().reshape(self.size) if self.count else np.zeros((0, 0, 0))
        before = self.low
        self.low, self.size = np.array(low, int), np.array(size, int)
        self.window.assign(np.stack([self.low, self.size]).astype(np.int32))
        self._allocate(int(np.prod(self.size)))
        self.whole, self._regions = Region(self.size, self._model.device), {}
        pressure = np.zeros(self.size)
        first = np.maximum(before, self.low)
        last = np.minimum(before + kept.shape, self.low + self.size)
        if (last > first).all():
            pressure[_span(first - self.low, last - self.low)] = kept[
                _span(first - before, last - before)
            ]
        self.pressure.assign(pressure.reshape(-1))

    def _allocate(self, count: int) -> None:
        t, real = self._t, self._model.real
        self.sums = self._zeros(self._copies * count, sums(real))
        """Momentum, mass and volume of the particles in each cell; a copy per worker."""
        self.fills = self._zeros(self._copies * count, t.vec2)
        """Particle volumes in each cell, with quadratic and with linear weights; a copy per worker.
        """
        self.velocity, self.other = (self._zeros(count, t.vec4) for _ in range(2))
        """Velocities at the low faces of each cell [m/s], and filled fraction of the cell."""
        self.known, self.also = (self._zeros(count, int) for _ in range(2))
        self.open, self.shares = self._zeros(count, t.vec4), self._zeros(count, t.vec2)
        """For each cell, `open` has the open fractions of the low faces, and `shares` has the
        fractions of two B-splines inside walls.
        """
        self.covers = self._zeros(count, t.vec3)
        """Fractions of the low faces of each cell that a freely moving solid closes."""
        self.hats, self.phi = self._zeros(count, real), self._zeros(count, real)
        self.phi.fill_(float(EMPTY))
        self.liquid = self._zeros(count, int)
        self.distances = self._zeros(self.points, real)
        self.owners = self._zeros(self.points, int)
        self.eighths = self._zeros(8 * count, real)
        self.diagonal, self.inverse, self.right = (self._zeros(count, wp.float64) for _ in range(3))
        self.links = self._zeros(count, wp.vec3d)
        self.pressure, self.packing = (self._zeros(count, wp.float64) for _ in range(2))
        """Solutions in each cell: p dt / (rho dx) for the pressure p [m/s], and the potential of
        the displacements that correct the density.
        """
        self.residual, self.z, self.product = (self._zeros(count, wp.float64) for _ in range(3))
        self.directions = [self._zeros(count, wp.float64) for _ in range(2)]
        self.which = self._zeros(count, int)
        """For each cell, the index of the solid whose surface is in the cell; -1: none."""
        self.jumps, self.turns = (self._zeros(count, wp.vec3d) for _ in range(2))
        """For each cell, the flux out of the cell per unit velocity, and per unit angular velocity,
        of the solid in `which`.
        """
        self.active, self.listed = (self._zeros(count, int) for _ in range(2))
        self.ends = self._zeros(self._copies + 1, int)
        """For each worker, the index of its first active cell; then the number of active cells."""
        columns = int(self.size[0] * self.size[1])
        self.lowest, self.highest = (self._zeros(self._copies * columns, int) for _ in range(2))
        """Lowest and highest cell with particles in each column of cells; a copy per worker."""
        self.below, self.above = (self._zeros(columns, int) for _ in range(2))
        """Lowest and highest cell with particles in each column or in its neighbours along y."""
        self.begins, self.tops = (self._zeros(columns, int) for _ in range(2))
        """For each column, the index of its first active cell, and the index after its last."""

    def record(
        self, worker: int, kernel: Any, inputs: list[Any], outputs: list[Any]
    ) -> Repeatable | None:
        """Record the launch of a kernel over a worker's active cells.

        Args:
            worker: Index of the worker.
            kernel: A kernel whose first arguments are the worker and the list of active cells.
            inputs: Further arguments that the kernel reads.
            outputs: Arguments that the kernel writes.
        """
        most = -(-self.count // self._copies)
        inputs = [worker, self.active, self.ends, *inputs]
        launch = self._model.launch(kernel, most, inputs, outputs)
        if launch is None or self._model.device != "cpu":
            return launch
        ends = np.asarray(self.ends.numpy(), np.int32)
        return OverActive(launch, ends[worker : worker + 2])

    def region(self, reach: float, wall: int) -> Region:
        """Return the region of cells within `reach` [m] of the centre of a wall."""
        if not math.isfinite(reach):
            return self.whole
        if wall not in self._regions:
            count = 2 * math.ceil(reach / self.dx + ROOM)
            self._regions[wall] = Region(np.full(3, count), self._model.device)
        return self._regions[wall]

    def clear_walls(self) -> None:
        """Remove all walls from the cells."""
        self.distances.fill_(FAR * self.dx)
        self.owners.fill_(-1)
        self.eighths.fill_(1.0)
        self.open.fill_(1.0)
        self.shares.zero_()

    @property
    def still(self) -> tuple[wp.array, wp.array, wp.array]:
        """Distance of each cell from the nearest fixed wall, index of this wall, and open fraction
        of each face.
        """
        distances, owners, _, fractions, _ = self._kept
        return distances, owners, fractions

    def keep_walls(self) -> None:
        """Copy the fixed walls."""
        self._kept = [wp.clone(array) for array in self._walls]

    def restore_walls(self) -> None:
        """Restore the copied fixed walls, and remove all other walls."""
        self.covers.zero_()
        for array, kept in zip(self._walls, self._kept, strict=True):
            wp.copy(array, kept)

    @property
    def _walls(self) -> list[wp.array]:
        return [self.distances, self.owners, self.eighths, self.open, self.shares]

    def _zeros(self, count: int, dtype: Any) -> wp.array:
        return wp.zeros(count, dtype=dtype, device=self._model.device)

    def snapshot(self) -> dict[str, Any]:
        """Return the window, and the pressure as the next initial guess."""
        window = [self.low.tolist(), self.size.tolist()]
        return {"window": window, "pressure": wp.clone(self.pressure)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        low, size = (np.array(corner) for corner in snapshot["window"])
        if not (np.array_equal(low, self.low) and np.array_equal(size, self.size)):
            self.rebase(low, size)
        self.pressure.assign(snapshot["pressure"])


def _span(first: Sequence[int] | NDArray, last: Sequence[int] | NDArray) -> tuple[slice, ...]:
    return tuple(slice(int(a), int(b)) for a, b in zip(first, last, strict=True))
