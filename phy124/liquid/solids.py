"""Records the kernel launches that couple the motion of solids in a liquid to the pressure."""

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


class Solids:
    """The solids of a scene; solids are the last entries in the list of walls."""

    def __init__(
        self, model: Model, bodies: FreeBodies, density: float, projection: Projection
    ) -> None:
        self._model, self.bodies, self._projection = model, bodies, projection
        self.scale = density * model.dx**3
        """Mass of a cell that is full of liquid [kg]."""
        count = projection.solids
        self.plans = wp.zeros((count, 2), dtype=wp.vec3d, device=model.device)
        """Velocity and angular velocity of each solid before the pressure acts."""
        self.centres = wp.zeros(count, dtype=wp.vec3d, device=model.device)
        """Centre of mass of each solid [m]."""

    @property
    def present(self) -> bool:
        """Whether the scene contains a freely moving solid."""
        return self._projection.solids > 0

    def first(self, walls: Walls) -> int:
        """Return the index of the first solid or body among all walls."""
        return len(walls.all) - self._projection.solids

    def kick(self, tracks: Tracks) -> list[Recorded]:
        """Return the kernel launches that apply gravity to the freely moving solids."""
        records = []
        for index, (solid, body) in enumerate(
            zip(self.bodies.all, self.bodies.numbers, strict=True)
        ):
            inputs = [index, solid.mass, self.scale, wp.vec3d(*solid.moments)]
            inputs += [wp.vec3d(*solid.levers), tracks.clock, tracks.values]
            outputs = [self.plans, self._projection.mobility, self.centres, body]
            kernel = kernels.make_kick(self._model.real)
            records.append((STAGE, self._model.launch(kernel, 1, inputs, outputs)))
        return records

    def couple(
        self,
        cells: Cells,
        weights: tuple[wp.array, wp.array],
        walls: Walls,
        tracks: Tracks,
        worker: int,
    ) -> list[list[Recorded]]:
        """Return a worker's kernel launches that run before the divergence of the velocities is
        computed.

        Args:
            cells: The cells.
            weights: Relative densities of the liquid, and momenta gained by forces
                (`Pushes.gains`).
            walls: The walls.
            tracks: Quantities that change over time.
            worker: Index of the worker.

        Returns:
            Two lists of launches; workers wait for each other between them.
        """
        model, projection = self._model, self._projection
        part, parts = projection.part(worker)
        inputs = [part, projection.counts, cells.listed, cells.lattice, cells.window, tracks.clock]
        inputs += [tracks.values, weights[0], cells.distances, cells.which, cells.jumps]
        inputs += [self.centres, weights[1]]
        lift = model.launch(kernels.make_lift(model.real), parts, inputs, [projection.sums])
        if worker > 0:
            return [[(STAGE, lift)], []]
        inputs = [self.first(walls), self.plans, self.centres, projection.mobility, projection.sums]
        kernel = kernels.make_predict(model.real)
        predict = model.launch(kernel, projection.solids, inputs, [walls.motions])
        return [[(STAGE, lift)], [(STAGE, predict)]]

    def jumps(self, cells: Cells, walls: Walls, worker: int) -> Recorded:
        """Return the kernel launch that writes the matrix J (phy124/kernels/liquid/solids.py)."""
        inputs = [self.first(walls), cells.lattice, cells.window, cells.open]
        inputs += [cells.covers, cells.distances, cells.owners, cells.liquid, self.centres]
        outputs = [cells.which, cells.jumps, cells.turns]
        return STAGE, cells.record(worker, kernels.make_jumps(self._model.real), inputs, outputs)

    def respond(
        self, walls: Walls, impulses: WallImpulses, tracks: Tracks, pulled: bool
    ) -> list[Recorded]:
        """Return the kernel launches that apply the liquid's impulses to freely moving solids.

        Args:
            walls: The walls.
            impulses: Sums of the walls' impulses.
            tracks: Quantities that change over time.
            pulled: Whether gravity has changed the velocities since the last launch.
        """
        records = []
        for index, solid in enumerate(self.bodies.all):
            wall = self.first(walls) + index
            inputs = [solid.mass, wp.vec3d(*solid.moments), wp.vec3d(*solid.levers)]
            inputs += [wall, int(pulled), tracks.clock, tracks.values]
            body = self.bodies.numbers[index]
            outputs = [impulses.step, walls.motions, self.bodies.total(index), body]
            kernel = kernels.make_respond(self._model.real)
            records.append((STAGE, self._model.launch(kernel, 1, inputs, outputs)))
        return records


def solid_kernels(real: Any) -> Iterator[Any]:
    """Yield the kernels that couple solids with a liquid."""
    yield from (kernels.make_jumps(real), kernels.make_lift(real), kernels.make_kick(real))
    yield from (kernels.make_predict(real), kernels.make_respond(real))
