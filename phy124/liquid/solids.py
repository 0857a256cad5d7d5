"""Free solids in a liquid: the launches that couple a solid's motion with the pressure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import warp as wp

from phy124.kernels.liquid import solids as kernels
from phy124.liquid.cells import Cells
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.projection import Projection
from phy124.liquid.walls import Walls
from phy124.mpm import FreeBodies, Model
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

STAGE = "free"
"""Name of the stages in reports."""


class Solids:
    """Records the launches of the free solid of a scene, if it has one."""

    def __init__(self, model: Model, bodies: FreeBodies, density: float) -> None:
        """Refer to the solids of a run.

        Args:
            model: The particles of the liquid.
            bodies: The solids; at most one.
            density: Density of the liquid [kg/m^3].
        """
        self._model, self.bodies = model, bodies
        self._scale = density * model.dx**3

    @property
    def present(self) -> bool:
        """Whether the scene has a free solid."""
        return bool(self.bodies.all)

    def couple(
        self, cells: Cells, walls: Walls, projection: Projection, tracks: Tracks, worker: int
    ) -> list[list[Recorded]]:
        """Return a worker's launches before the divergence of the velocities is computed.

        Args:
            cells: The cells.
            walls: The walls, of which the solid's surface is the last.
            projection: The solutions, whose sums and mobility the launches write.
            tracks: Quantities that change over time.
            worker: Index of the worker.

        Returns:
            Two lists; workers wait for each other between them. The first worker predicts.
        """
        model, solid = self._model, self.bodies.all[0]
        wall, body = len(walls.all) - 1, self.bodies.numbers[0]
        part, parts = projection.part(worker)
        inputs = [part, projection.counts, cells.listed, cells.lattice, cells.window, tracks.clock]
        inputs += [tracks.values, cells.distances, cells.jumps, body]
        lift = model.launch(kernels.make_lift(model.real), parts, inputs, [projection.sums])
        if worker > 0:
            return [[(STAGE, lift)], []]
        mass = [solid.mass, self._scale, wp.vec3d(*solid.moments), wall]
        outputs = [walls.motions, projection.mobility, body]
        inputs = [*mass, tracks.clock, tracks.values, projection.sums]
        predict = model.launch(kernels.make_predict(model.real), 1, inputs, outputs)
        return [[(STAGE, lift)], [(STAGE, predict)]]

    def jumps(self, cells: Cells, walls: Walls, worker: int, workers: int) -> Recorded:
        """Return a worker's launch that writes the rows of J.

        Args:
            cells: The cells.
            walls: The walls, of which the solid's surface is the last.
            worker: Index of the worker.
            workers: Number of workers.
        """
        model, count = self._model, -(-cells.count // workers)
        inputs = [worker, cells.active, cells.ends, len(walls.all) - 1]
        inputs += [cells.lattice, cells.window, cells.open]
        inputs += [cells.owners, cells.liquid, self.bodies.numbers[0]]
        outputs = [cells.jumps, cells.turns]
        return STAGE, model.launch(kernels.make_jumps(model.real), count, inputs, outputs)

    def respond(self, walls: Walls, impulses: WallImpulses) -> list[Recorded]:
        """Return the launch that gives the solid the opposite of its impulses on the liquid."""
        model, solid = self._model, self.bodies.all[0]
        inputs = [solid.mass, wp.vec3d(*solid.moments), len(walls.all) - 1]
        outputs = [impulses.step, walls.motions, self.bodies.total(0), self.bodies.numbers[0]]
        return [(STAGE, model.launch(kernels.make_respond(model.real), 1, inputs, outputs))]


def solid_kernels(real: Any) -> Iterator[Any]:
    """Yield the kernels that couple a solid with a liquid."""
    yield from (kernels.make_jumps(real), kernels.make_lift(real))
    yield from (kernels.make_predict(real), kernels.make_respond(real))
