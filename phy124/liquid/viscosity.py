"""Kernel launches that solve the implicit viscosity equation for the velocities at the faces."""

from collections.abc import Callable, Iterator
from typing import Any

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.liquid import pressure, slivers, stress, viscous
from phy124.liquid.cells import Cells
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.mixture import Mixture
from phy124.liquid.projection import Projection
from phy124.liquid.walls import Walls
from phy124.mpm import Model
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

STAGE = "viscosity"
TOLERANCE = 1e-4
"""Largest error of a face's momentum, relative to the largest momentum of a face."""
MOST = 1000
"""Largest number of iterations for a solution."""
MAKERS = viscous.make_hold, viscous.make_weigh, viscous.make_resist, viscous.make_bulk
SOLVERS = stress.make_strain, stress.make_start, stress.make_multiply


class Viscosity:
    """Computes viscosity by conjugate gradients."""

    def __init__(
        self, model: Model, cells: Cells, mixture: Mixture, projection: Projection
    ) -> None:
        self._model, self._cells, self._mixture = model, cells, mixture
        self._projection = projection
        self.rate = mixture.viscosity / (mixture.density * model.dx**2)
        """Rate at which viscosity diffuses velocities to a neighbouring face, at the mean density
        [1/s].
        """
        self.carry = wp.ones(1, dtype=wp.float64, device=model.device)
        """The last pressure times this factor is the next initial guess."""

    def fit(self, walls: Walls, solid: int, tracks: Tracks, impulses: WallImpulses) -> None:
        """Allocate the arrays of a window, and set the objects that the kernel launches use.

        Args:
            walls: The walls.
            solid: Index of the first wall that moves freely.
            tracks: Quantities that change over time.
            impulses: Sums of the walls' impulses.
        """
        self._walls, self._solid, self._tracks, self._impulses = walls, solid, tracks, impulses
        if self.rate == 0:
            return
        count, device, t = self._cells.count, self._model.device, types(self._model.real)
        self._masses, self._stretch, self._first, self._second = (
            wp.zeros(count, dtype=t.vec3, device=device) for _ in range(4)
        )
        """Masses of the faces, and weights of the strain rates (viscous.py)."""
        self._u, self._residual, self._inverse, self._product, self._normal, self._shear = (
            wp.zeros(count, dtype=wp.vec3d, device=device) for _ in range(6)
        )
        self._directions = [wp.zeros(count, dtype=wp.vec3d, device=device) for _ in range(2)]
        self._wet = wp.zeros(count, dtype=int, device=device)
        self._excess = wp.zeros(count, dtype=wp.float64, device=device)

    def prepare(self, worker: int) -> Iterator[list[Recorded]]:
        """Yield a worker's kernel launches that set up the equation."""
        cells, walls, real = self._cells, self._walls, self._model.real
        yield [self._anticipate(worker, -1.0)]
        inputs = [self._solid, cells.lattice, cells.window, cells.known, cells.open]
        inputs += [cells.distances, cells.owners, walls.frictions, walls.motions, cells.velocity]
        outputs = [cells.also, self._u, self._product, *self._directions]
        outputs += [self._normal, self._shear]
        yield [(STAGE, cells.record(worker, viscous.make_hold(real), inputs, outputs))]
        inputs = [self.rate, cells.window, self._tracks.clock, self._mixture.densities]
        inputs += [self._mixture.viscosities, cells.open, cells.shares, cells.eighths]
        inputs += [cells.distances, cells.phi, cells.liquid, cells.also]
        outputs = [self._masses, *self._weights, self._wet]
        yield [(STAGE, cells.record(worker, viscous.make_weigh(real), inputs, outputs))]
        yield from self._projection.list_cells(cells, worker, self._wet)

    def phases(self, worker: int) -> Iterator[list[Recorded]]:
        """Yield a worker's kernel launches that solve the equation.

        The first two lists begin the solution. Three lists follow for each even iteration, and
        three for each odd iteration.
        """
        cells, part = self._cells, self._projection.part(worker)
        start, multiply = (make(self._model.real) for make in SOLVERS[1:])
        table, stresses = self._projection.sums, [self._normal, self._shear]
        yield [self._strain(worker)]
        inputs = [*self._list_of(worker), cells.also, self._masses, *self._weights, *stresses]
        outputs = [self._inverse, self._residual, self._product, table]
        yield [self._launch(start, part[1], [*inputs, self._u], outputs)]
        for turn in range(2):
            yield [self._strain(worker, turn)]
            direction = self._directions[turn]
            inputs = [*self._list_of(worker), self._masses, *self._weights[1:], *stresses]
            outputs = [self._product, table]
            yield [self._launch(multiply, part[1], [*inputs, direction], outputs)]
            inputs = [part[0], turn, self._projection.counts, cells.listed, self._inverse]
            outputs = [self._u, self._residual, self._product, table]
            yield [self._launch(stress.relax, part[1], [*inputs, direction], outputs)]

    def finish(self, worker: int, sums: wp.array) -> Iterator[list[Recorded]]:
        """Yield a worker's kernel launches that store the new velocities and sum the impulses on
        walls.

        `sums` contains the momenta and masses of the faces.
        """
        cells, walls, real = self._cells, self._walls, self._model.real
        yield [self._strain(worker)]
        scale = self._mixture.density * self._model.dx**3
        inputs = [scale, cells.lattice, cells.window, cells.known, cells.distances, cells.owners]
        inputs += [cells.also, sums, *self._weights[1:], self._normal, self._shear, self._u]
        outputs = [cells.velocity, self._impulses.rows(worker)]
        yield [(STAGE, cells.record(worker, viscous.make_resist(real), inputs, outputs))]
        inputs = [self.rate, int(walls.move), self._solid, cells.lattice, cells.window]
        inputs += [self._tracks.clock, self._mixture.viscosities, walls.motions, cells.open]
        inputs += [
            cells.covers,
            cells.distances,
            cells.owners,
            cells.liquid,
            cells.also,
            cells.velocity,
        ]
        kernel = viscous.make_bulk(real)
        yield [(STAGE, cells.record(worker, kernel, inputs, [self._excess]))]
        yield [self._anticipate(worker, 1.0)]

    def omit_slivers(self, worker: int) -> list[Recorded]:
        """Return the kernel launch that marks velocities in slivers of liquid for extrapolation."""
        if self.rate == 0:
            return []
        cells, mixture = self._cells, self._mixture
        inputs = [self.rate, cells.window, self._tracks.clock, mixture.densities]
        inputs += [mixture.viscosities, cells.open, cells.phi, cells.liquid, cells.also]
        kernel = slivers.make_slivers(self._model.real)
        return [(STAGE, cells.record(worker, kernel, inputs, [cells.known]))]

    def release(self, worker: int) -> list[Recorded]:
        """Return a worker's kernel launch that subtracts the viscous pressure from the pressure."""
        if self.rate == 0:
            return []
        kernel = viscous.make_release(self._model.real)
        cells = self._cells
        return [(STAGE, cells.record(worker, kernel, [], [cells.pressure, self._excess]))]

    def solve(self, run: Callable[[int], None], begin: int) -> int:
        """Iterate until the residual is small; return the number of iterations.

        Args:
            run: Runs a phase of all workers.
            begin: Index of the first phase of the solution.
        """
        run(begin)
        run(begin + 1)
        for k in range(MOST):
            strain = begin + 2 + 3 * (k % 2)
            run(strain)
            # All workers have finished the phase before `strain`, so the sums are complete.
            if k % self._projection.every == 0 and self._projection.small(TOLERANCE):
                return k
            run(strain + 1)
            run(strain + 2)
        return MOST

    @property
    def _weights(self) -> list[wp.array]:
        return [self._stretch, self._first, self._second]

    def _list_of(self, worker: int) -> list[Any]:
        cells, part = self._cells, self._projection.part(worker)[0]
        return [part, cells.window, self._projection.counts, cells.listed]

    def _launch(self, kernel: Any, parts: int, inputs: list, outputs: list) -> Recorded:
        return STAGE, self._model.launch(kernel, parts, inputs, outputs)

    def _strain(self, worker: int, turn: int = -1) -> Recorded:
        """Return a launch that computes a search direction, or the stresses of u without `turn`."""
        part, window, *listed = self._list_of(worker)
        z, after, before = self._u, self._directions[0], self._directions[1]
        if turn >= 0:
            z, after, before = self._product, *self._directions[:: 1 - 2 * turn]
        inputs = [part, max(turn, 0), int(turn >= 0), window, *listed, *self._weights]
        outputs = [after, self._normal, self._shear]
        kernel, parts = stress.make_strain(self._model.real), self._projection.part(worker)[1]
        return self._launch(kernel, parts, [*inputs, self._projection.sums, z, before], outputs)

    def _anticipate(self, worker: int, factor: float) -> Recorded:
        """Return a launch that adds `factor` times the last pressure differences to velocities."""
        cells = self._cells
        inputs = [factor, cells.window, cells.open, self._mixture.densities]
        inputs += [cells.phi, cells.liquid, self.carry, cells.pressure]
        kernel = pressure.make_anticipate(self._model.real)
        return STAGE, cells.record(worker, kernel, inputs, [cells.velocity])


def viscosity_kernels(real: Any) -> Iterator[Any]:
    """Yield the kernels of viscosity."""
    yield from (make(real) for make in (*MAKERS, *SOLVERS, slivers.make_slivers))
    yield from (stress.relax, viscous.make_release(real), pressure.make_anticipate(real))
