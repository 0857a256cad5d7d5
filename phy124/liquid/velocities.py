"""Computes velocities of faces from a solved pressure, and displacements from a solved density.

Splitting a step into advection and pressure takes energy, in first order of the step's length: most
of it from thin layers that hit a wall. The particles of an inviscid liquid therefore keep more than
the divergence-free velocity u with which they drift. They keep u + r (u - u*) + r / (1 + r) g dt,
where u* is the velocity before the pressure acts and r the `REFLECTION`. The pressure's impulse is
thus 1 + r times the one that makes u free of divergence. Only the fraction 1 / (1 + r) of gravity
acts before the pressure, so a liquid at rest stays at rest (Zehnder, Narain and Thomaszewski 2018,
"An advection-reflection solver for detail-preserving fluid simulation", with r = 1).
"""

from __future__ import annotations

from collections.abc import Iterator

import warp as wp

from phy124.kernels.liquid import packing, pressure, spread
from phy124.liquid.cells import Cells
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.mixture import Mixture
from phy124.liquid.walls import Walls
from phy124.mpm import Model
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

REFLECTION = 0.8
"""Fraction of the velocity change by pressure that acts a second time in an inviscid liquid. With
1, nothing damps a divergence that changes its sign in every step, as after a full box was squeezed.
"""
LAYERS, LAYERS_SHIFT = 4, 2
"""Number of layers of faces outside the liquid to which velocities (`LAYERS`) and displacements
(`LAYERS_SHIFT`) are extrapolated. Both are even, so that the last layer's flags are in
`Cells.known`.
"""
STAGE = "spread"
"""Name of the stages in reports."""


class Velocities:
    """Records launches that compute the velocities of faces on which the pressure has acted."""

    def __init__(self, model: Model, cells: Cells, mixture: Mixture, reflection: float) -> None:
        """Store the cells of a run.

        Args:
            model: The particles.
            cells: The cells.
            mixture: Densities and viscosities of the liquids.
            reflection: Fraction of the velocity change by pressure that acts a second time.
        """
        self._model, self._cells, self._mixture = model, cells, mixture
        self.reflection = reflection

    def fit(self, walls: Walls, tracks: Tracks, impulses: WallImpulses) -> None:
        """Store walls and accelerations.

        Args:
            walls: The walls.
            tracks: Quantities that change over time.
            impulses: Sums of the walls' impulses, to which those of friction are added.
        """
        self._walls, self._tracks, self._impulses = walls, tracks, impulses

    @property
    def drifting(self) -> wp.array:
        """Velocities of the low faces with which particles drift; `Cells.other` is kept [m/s]."""
        return self._cells.smooth if self.reflection > 0 else self._cells.other

    def change(self, worker: int) -> Recorded:
        """Return a worker's launch that lets the pressure act."""
        cells, densities = self._cells, self._mixture.densities
        return self._gradient(worker, cells.pressure, densities, 0.0, self.reflection)

    def shift(self, worker: int) -> Recorded:
        """Return a worker's launch that computes displacements along the density's gradient."""
        cells, densities = self._cells, self._mixture.uniform
        return self._gradient(worker, cells.packing, densities, packing.MOST, 0.0)

    def extend(self, worker: int) -> Iterator[list[Recorded]]:
        """Yield a worker's phases that extend velocities beyond the liquid, and apply walls."""
        cells, motions, rubs = self._cells, self._walls.motions, self._walls.rub
        if self.reflection == 0:
            yield from self._spread(worker, LAYERS, [cells.velocity])
            yield [self._slide(worker, motions, cells.velocity, cells.other, rubs=rubs)]
            return
        yield from self._spread(worker, LAYERS, [cells.velocity, cells.smooth])
        factor = 1 + self.reflection
        yield [self._slide(worker, motions, cells.smooth, cells.other, rubs=rubs, factor=factor)]
        sums = False  # the kept velocities have the whole impulse of friction
        yield [self._slide(worker, motions, cells.velocity, cells.smooth, rubs=rubs, sums=sums)]

    def extend_shifts(self, worker: int) -> Iterator[list[Recorded]]:
        """Yield a worker's phases that extend displacements beyond the liquid."""
        cells = self._cells
        yield from self._spread(worker, LAYERS_SHIFT, [cells.velocity])
        yield [self._slide(worker, self._walls.still, cells.velocity, cells.other, rubs=False)]

    def _gradient(
        self,
        worker: int,
        solution: wp.array,
        densities: wp.array,
        shifts: float,
        reflection: float,
    ) -> Recorded:
        cells, tracks = self._cells, self._tracks
        inputs = [shifts, reflection, cells.lattice, cells.window, tracks.clock, tracks.values]
        inputs += [cells.open, densities, cells.phi, cells.liquid, solution]
        outputs = [cells.velocity, cells.smooth, cells.known]
        kernel = pressure.make_gradient(self._model.real)
        return cells.over(worker, STAGE, kernel, inputs, outputs)

    def _spread(self, worker: int, layers: int, fields: list[wp.array]) -> Iterator[list[Recorded]]:
        cells, kernel = self._cells, spread.make_spread(self._model.real)
        known = [cells.known, cells.also]
        for turn in range(layers):
            before, after = known[turn % 2], known[1 - turn % 2]
            inputs = [cells.window, before]
            yield [cells.over(worker, STAGE, kernel, inputs, [field, after]) for field in fields]

    def _slide(
        self,
        worker: int,
        motions: wp.array,
        before: wp.array,
        after: wp.array,
        *,
        rubs: bool,
        factor: float = 1.0,
        sums: bool = True,
    ) -> Recorded:
        cells, walls, mixture = self._cells, self._walls, self._mixture
        mode = 2 if rubs and mixture.viscosity > 0 else int(rubs)
        weight = mixture.density * self._model.dx**3
        inputs = [mode, weight, factor, cells.lattice, cells.window, motions]
        inputs += [walls.frictions, cells.open, cells.shares, cells.distances, cells.owners]
        inputs += [mixture.densities, cells.liquid, cells.known, cells.pressure, before]
        rows = self._impulses.rows(worker)
        kernel = spread.make_slide(self._model.real)
        outputs = [after, rows if sums else rows[:0]]
        return cells.over(worker, STAGE, kernel, inputs, outputs)
