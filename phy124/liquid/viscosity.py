"""Launches that diffuse velocities between faces, and reduce velocities by drag at walls."""

import warp as wp

from phy124.kernels.liquid import pressure, viscous
from phy124.liquid.cells import Cells
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.mixture import Mixture
from phy124.liquid.walls import Walls
from phy124.mpm import Model
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

STAGE = "viscosity"


class Viscosity:
    """Computes viscosity by iterations."""

    def __init__(self, model: Model, cells: Cells, mixture: Mixture) -> None:
        self._real, self._cells, self._mixture = model.real, cells, mixture
        self.rate = mixture.viscosity / (mixture.density * model.dx**2)
        """Rate at which viscosity diffuses velocities to a neighbouring face, at the mean density
        [1/s].
        """
        self.fastest = mixture.viscosity / (mixture.lightest * model.dx**2)
        """Largest rate at which viscosity diffuses velocities to a neighbouring face [1/s]."""
        self.carry = wp.ones(1, dtype=wp.float64, device=model.device)
        """The last pressure times this factor is the next initial guess."""

    def fit(self, walls: Walls, tracks: Tracks, impulses: WallImpulses) -> None:
        """Set the objects that the launches use."""
        self._walls, self._tracks, self._impulses = walls, tracks, impulses

    def anticipate(self, worker: int, factor: float) -> Recorded:
        """Record a worker's launch that adds `factor` times the effect of the last pressure to
        velocities.
        """
        cells = self._cells
        inputs = [factor, cells.window, cells.open, self._mixture.densities]
        inputs += [cells.phi, cells.liquid, self.carry, cells.pressure]
        kernel = pressure.make_anticipate(self._real)
        return STAGE, cells.record(worker, kernel, inputs, [cells.velocity])

    def diffuse(self, worker: int, before: wp.array, after: wp.array) -> Recorded:
        """Record a Jacobi iteration over a worker's faces."""
        inputs = [*self._common(), self._cells.velocity, before]
        return STAGE, self._cells.record(worker, viscous.make_diffuse(self._real), inputs, [after])

    def drag(self, worker: int, sums: wp.array) -> Recorded:
        """Record a worker's launch that sums the impulses on walls; `sums` contains the masses of
        faces.
        """
        cells = self._cells
        inputs = [*self._common(), sums, cells.other]
        outputs = [cells.velocity, self._impulses.rows(worker)]
        return STAGE, cells.record(worker, viscous.make_drag(self._real), inputs, outputs)

    def _common(self) -> list:
        cells, walls = self._cells, self._walls
        inputs = [self.rate, cells.lattice, cells.window, self._tracks.clock, cells.known]
        inputs += [self._mixture.densities, self._mixture.viscosities, cells.open]
        return [*inputs, cells.distances, cells.owners, walls.frictions, walls.motions]
