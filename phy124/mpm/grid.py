"""Grid: nodes in a window that follows the particles.

Each body has a separate grid. The nodes of all grids are at common positions.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.mpm.model import Model
from phy124.mpm.timestep import TRAVEL, Maxima

Corners = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Lowest and highest corner of a bounding box [m]."""
MARGIN = 2 * TRAVEL
"""Margin of the grid's window around the particles [cells]: twice the distance that a particle may
travel between two measurements.
"""
CROSSED = "particles crossed more cells than allowed between two measurements"
FARTHEST = 2**30
"""The device can compute indices of nodes up to this distance from the origin [cells]."""


class Unstable(RuntimeError):
    """Particles have left the grid's window, or values are not finite; the state is unusable."""

    def __init__(self, what: str, dt: float = 0.0) -> None:
        self.dt = dt
        """Length of the failed substep [s], of which the next attempt takes at most half; 0: the
        length of the last substep.
        """
        super().__init__(what)


class Grid:
    """A flat array of nodes; node (i, j, k) of the window is at origin + (low + (i, j, k)) dx."""

    def __init__(
        self,
        origin: Sequence[float],
        dx: float,
        *,
        real: Any,
        device: str,
        particles: slice = slice(None),
        apart: bool = False,
    ) -> None:
        t = types(real)
        self.origin, self.dx, self.device, self.vec4 = np.array(origin, float), dx, device, t.vec4
        self.lattice = t.vec4(*origin, dx)
        self.window = wp.zeros(2, dtype=wp.vec3i, device=device)
        self.low, self.size = np.zeros(3, int), np.zeros(3, int)
        self.nodes = wp.zeros(0, dtype=t.vec4, device=device)
        """Velocity and mass of each node after the update of the grid."""
        self.momenta = self.nodes
        """Momentum and mass of each node, to which particles scatter in each substep."""
        self.apart = apart
        """Whether `momenta` and `nodes` are separate arrays; the gather then clears `momenta`."""
        self._changes: wp.array | None = None
        self.particles = particles
        self.stale = True
        """Whether the window may no longer contain all particles."""
        self.layers: tuple[int, int] | None = None
        """Layers of nodes (first <= i < last) that the next recorded launches change; None: all."""
        self.worker, self.workers = 0, 1
        """Index of the worker whose kernel launches are being recorded, and number of workers."""

    @property
    def count(self) -> int:
        """Number of nodes in the grid's window."""
        return int(np.prod(self.size))

    @contextmanager
    def only(
        self, layers: tuple[int, int] | None, worker: int = 0, workers: int = 1
    ) -> Iterator[None]:
        """Record kernel launches for one worker within this context.

        The launches are for the `layers` first <= i < last; None: all layers.
        """
        self.layers, self.worker, self.workers = layers, worker, workers
        try:
            yield
        finally:
            self.layers, self.worker, self.workers = None, 0, 1

    def fit(self, lower: NDArray, upper: NDArray) -> bool:
        """Fit the window to the particles with a margin; return whether the window changed.

        `lower` and `upper` [3], m, are the corners of the particles' bounding box.

        Raises:
            Unstable: Particles were outside the old window, so the grid did not move them; or
                particles are so far away that nodes cannot be numbered.
        """
        if not np.all(np.abs([lower, upper]) < FARTHEST * self.dx):
            raise Unstable(f"particles moved {FARTHEST:.0e} cells away")
        low, high = self.reach(lower, upper)
        if not self.stale:
            spare = [*(low - self.low).tolist(), *(self.low + self.size - high).tolist()]
            if min(spare) < 0:
                raise Unstable(CROSSED)
            if min(spare) >= MARGIN // 2 and max(spare) <= 3 * MARGIN:
                return False
        self.rebase(low - MARGIN, high - low + 2 * MARGIN)
        return True

    def rebase(self, low: NDArray, size: NDArray) -> None:
        """Allocate `size` [3] nodes with zero values; the window's lowest node is `low` [3]."""
        # The array has one additional node, since SIMD code reads four nodes at once.
        count = int(np.prod(size)) + 1
        self.use(low, size, wp.zeros(count, dtype=self.vec4, device=self.device))

    def use(self, low: NDArray, size: NDArray, nodes: wp.array) -> None:
        """Use the window of `size` [3] nodes from `low` [3] on; `nodes` has one additional node."""
        self.low, self.size, self.nodes, self.stale = low, size, nodes, False
        self.momenta = wp.zeros_like(nodes) if self.apart else nodes
        self._changes = None
        self.window.assign(np.stack([low, size]).astype(np.int32))

    @property
    def changes(self) -> wp.array:
        """Change of each node's velocity by the current wall; zero before a wall has acted."""
        if self._changes is None:
            self._changes = wp.zeros_like(self.nodes)
        return self._changes

    def reach(self, lower: NDArray, upper: NDArray) -> tuple[NDArray, NDArray]:
        """Return the first node that particles in a box [m] use, and the node after the last."""
        low = np.floor((lower - self.origin) / self.dx - 0.5).astype(int)
        high = np.floor((upper - self.origin) / self.dx - 0.5).astype(int) + 3
        return low, high

    def run(self, particles: int) -> slice:
        """Return the range of particles to which the current worker applies forces."""
        ends = (self.worker, self.worker + 1)
        return slice(*(particles * end // self.workers for end in ends))

    def nodes_within(self, lower: NDArray, upper: NDArray) -> tuple[NDArray, NDArray]:
        """Return the first node of the window in a box [m], and the number of nodes along each
        axis.
        """
        low, size = self.low, self.size
        start = np.floor(np.clip((lower - self.origin) / self.dx - low, 0, size)).astype(int)
        stop = np.ceil(np.clip((upper - self.origin) / self.dx - low + 1, 0, size)).astype(int)
        if self.layers is not None:
            start[0], stop[0] = max(start[0], self.layers[0]), min(stop[0], self.layers[1])
        return start, np.maximum(stop - start, 0)

    def slab(self, first: int, last: int) -> wp.array:
        """Return the nodes of some layers, first <= i < last, which are contiguous in memory."""
        layer = int(self.size[1] * self.size[2])
        return cast("wp.array", self.nodes[first * layer : last * layer])


def grids_of(model: Model, *, apart: bool = False) -> list[Grid]:
    """Return one grid for each body, all on the same lattice.

    If `apart` is set, momenta and velocities of nodes are stored in two arrays.
    """
    runs = [model.particles(body) for body in range(model.bodies)]
    options: dict[str, Any] = {"real": model.real, "device": model.device, "apart": apart}
    return [Grid(model.origin, model.dx, particles=run, **options) for run in runs]


def fit_all(grids: Sequence[Grid], corners: Sequence[Corners], *, returned: bool) -> bool:
    """Fit the windows of all bodies to their particles; return whether any window has changed.

    Args:
        grids: Grid of each body.
        corners: Corners of the bounding box of each body's particles; infinite if all particles are
            outliers.
        returned: Whether an outlier has come back to the other particles; the outlier may be
            outside the window.

    Raises:
        Unstable: As in `Grid.fit`.
    """
    changed = False
    inside = [bool(np.isfinite(pair).all()) for pair in corners]
    for grid, pair, present in zip(grids, corners, inside, strict=True):
        grid.stale |= returned
        if present or not any(inside):
            changed |= grid.fit(*pair)
        else:
            # When particles return to the grid, the body needs a new window.
            grid.stale = True
    return changed


def corners_of(rows: NDArray[np.float64], bodies: Sequence[int], count: int) -> list[Corners]:
    """Return the lowest and highest corner of each body's bounding box.

    The corners of a body without a row in `rows` are infinite. The rows [R,M] are measured maxima
    of parts of the particles (see `Maxima.of`); `bodies` has the body of each row.
    """
    if count == 1:
        return [Maxima.of(rows.max(axis=0)).corners]
    number = np.array(bodies)
    return [
        Maxima.of(rows[number == body].max(axis=0, initial=-np.inf)).corners
        for body in range(count)
    ]
