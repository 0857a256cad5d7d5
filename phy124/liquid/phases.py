"""Phases: records the kernel launches of a liquid's step for the current window of cells.

All workers run a phase in parallel, and wait for each other between phases.
"""

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.liquid import (
    active,
    faces,
    impulses,
    mixture,
    packing,
    pressure,
    spread,
    surface,
    transfer,
)
from phy124.kernels.liquid.energies import AT_END, AT_PRESSURE
from phy124.kernels.reduction import shared_out
from phy124.liquid.bodies import STAGE as BODIES
from phy124.liquid.bodies import Bodies
from phy124.liquid.cells import Cells
from phy124.liquid.energies import Energies
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.mixture import Mixture
from phy124.liquid.projection import Projection
from phy124.liquid.pushes import Pushes
from phy124.liquid.solids import Solids
from phy124.liquid.viscosity import Viscosity
from phy124.liquid.walls import Walls, span
from phy124.mpm import FreeBodies, Grid, Model, Stage, State
from phy124.mpm.model import part_of
from phy124.mpm.stage import Named, Recorded, launches, push_launches
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Worker

LAYERS = 4
"""Layers of faces beyond the liquid to which velocities are extrapolated; even (`Cells.known`)."""
LAYERS_SHIFT = 2
"""Layers of faces beyond the liquid to which displacements are extrapolated; even."""
EXTENT = 7
"""Number of values of an extent: the lowest corner with a negative sign, the highest corner, and
the largest squared speed.
"""


class Phases:
    """Records the phases of all workers, in named groups."""

    def __init__(
        self,
        model: Model,
        state: State,
        cells: Cells,
        projection: Projection,
        workers: Sequence[Worker],
        missed: wp.array,
        free: FreeBodies,
        bodies: Bodies | None,
        liquids: Sequence[slice],
    ) -> None:
        """Store the arrays. `missed` [W,1] is 1 for each worker with a particle outside the window;
        `liquids` are the slices of the liquids' particles.
        """
        self._model, self._state, self._cells = model, state, cells
        self._projection, self._workers, self._missed = projection, workers, missed
        device = model.device
        self._form = "simd" if model.form == "simd" else "plain"
        shape = (len(workers), EXTENT)
        self._no_sums = wp.zeros(0, dtype=faces.sums(model.real), device=device)
        self.extents = wp.zeros(shape, dtype=model.real, device=device)
        self.stray = wp.zeros(1, dtype=int, device=device)
        """Number of particles with values that are not finite."""
        self._mixture = Mixture(model, liquids, len(workers))
        self.viscosity = Viscosity(model, cells, self._mixture, projection)
        density = self._mixture.density
        self._solids = Solids(model, free, density, projection)
        self._bodies = bodies
        self.pushes = Pushes(model, state, cells)
        if bodies is not None:
            bodies.join(self._solids, projection.mobility)
        self.energies = Energies(model, state, cells, len(workers))

    @property
    def densities(self) -> wp.array | None:
        """Relative densities in the cells; None if all liquids have equal densities."""
        return self._mixture.densities if self._mixture.differ[0] else None

    def take_impulses(self) -> Iterator[tuple[int, int, NDArray]]:
        """Yield for each pair of liquids the impulse and moment [6] of the first on the second
        since the last call.
        """
        if self._mixture.pairs:
            rows = self._mixture.take_impulses()
            yield from ((*pair, row) for pair, row in zip(self._mixture.pairs, rows, strict=True))

    def record(
        self,
        pushes: Sequence[Stage],
        walls: Walls,
        tracks: Tracks,
        impulses_of_walls: WallImpulses,
        grid: Grid,
    ) -> None:
        """Record the kernel launches of every worker's phases.

        Args:
            pushes: Stages of forces on particles.
            walls: The walls.
            tracks: Quantities that change over time.
            impulses_of_walls: Sums of the walls' impulses.
            grid: A grid without nodes, since stages of forces expect a grid.
        """
        self._tracks, self._walls, self._impulses_of_walls = tracks, walls, impulses_of_walls
        self._mixture.fit(self._cells.count)
        in_cells = bool(walls.all) or self.energies.on
        self.pushes.fit(len(self._workers), pushes, in_cells=in_cells)
        fixed = self._solids.first(walls)
        self.viscosity.fit(walls, fixed, tracks, impulses_of_walls)
        self.energies.fit(walls, fixed, tracks, impulses_of_walls, self.pushes.gains)
        names: list[str] = []
        for index, worker in enumerate(self._workers):
            named = list(self._phases(pushes, index, grid))
            worker.phases = [phase for _, phase in named]
            names = [name for name, _ in named]
        self._first = {name: names.index(name) for name in names}
        self._last = {name: place + 1 for place, name in enumerate(names)}

    def group(self, name: str) -> range:
        """Return the indices of the phases in a group."""
        return range(self._first[name], self._last[name])

    def extent(self, worker: int) -> list[Named]:
        """Return the kernel launches that measure the extent of a worker's particles."""
        model, s, run = self._model, self._state, self._run(worker)
        threads, *fraction = shared_out(run.stop - run.start, model.device)
        row = cast("wp.array", self.extents[worker])
        inputs = [*fraction, run.stop - run.start, s.x[run], s.v[run]]
        kernel = faces.make_extent(model.real)
        launch = model.launch(kernel, threads, inputs, [row, self.stray])
        return [("measure", lambda: row.fill_(-np.inf)), *launches([("measure", launch)])]

    def _phases(
        self, pushes: Sequence[Stage], worker: int, grid: Grid
    ) -> Iterator[tuple[str, list[Named]]]:
        cells, solve, solids = self._cells, self._projection, self._solids.present
        for phase in self._walls.describe(cells, worker, len(self._workers), move=False):
            yield "walls", launches(phase)
        for phase in self._walls.describe(cells, worker, len(self._workers), move=True):
            yield "move", launches(phase)
        yield "leave walls", launches(self._push_out(worker, stops=False))
        alone = worker == 0 and self._bodies is None
        yield "scatter", self.pushes.keep(self._run(worker))
        yield "scatter", push_launches(pushes, grid, worker, len(self._workers))
        yield "scatter", launches(self._solids.kick(self._tracks) if alone else [])
        yield "scatter", [*self._scatter(worker), *self.pushes.add(worker, self._run(worker))]
        yield from self._before_pressure(worker)
        for phase in solve.phases(cells, cells.pressure, worker, rigid=solids):
            yield "pressure", launches(phase)
        for records in self._follow(worker):
            yield "gather", launches(records)
        if solids:
            drift = self._solids.bodies.drift() if alone else []
            yield "drift", launches(drift)
            yield "fill", launches(self._sum_shifts(worker, self._push_out(worker, stops=False)))
        yield "fill", self._fill(worker, self._model.volume)
        for records in self._density_equation(worker):
            yield "fill", launches(records)
        for phase in solve.phases(cells, cells.packing, worker):
            yield "packing", launches(phase)
        gradient = self._gradient(cells.packing, worker, shifts=packing.MOST)
        yield "displace", launches([gradient, *self.viscosity.release(worker)])
        for records in self._displacements(worker):
            yield "displace", launches(records)

    def _before_pressure(self, worker: int) -> Iterator[tuple[str, list[Named]]]:
        for records in self._activate(worker):
            yield "scatter", launches(records)
        yield "scatter", launches([self._sum_copies(worker, "levels", self._cells.sums, 8)])
        yield "scatter", launches([self._levels(worker)])
        for weights, mixed in zip(self._mixture.weights, self._mixture.mixed, strict=True):
            yield "scatter", self._fill(worker, weights)
            yield "scatter", launches([self._sum_copies(worker, "density", self._cells.fills, 2)])
            yield "scatter", launches([self._mix(worker, mixed)])
        if self.viscosity.rate > 0:
            sums = self._copy(self._cells.sums, 0)
            for records in self.viscosity.prepare(worker):
                yield "scatter", launches(records)
            for records in self.viscosity.phases(worker):
                yield "viscosity", launches(records)
            for records in self.viscosity.finish(worker, sums):
                yield "equation", launches(records)
        for records in self._equation(worker):
            yield "equation", launches(records)
        if records := self.energies.before_pressure(worker):
            yield "equation", launches(records)

    def _equation(self, worker: int) -> Iterator[list[Recorded]]:
        cells, solve = self._cells, self._projection
        yield [self._assemble(worker, self._mixture.densities), *self._jumps(worker)]
        yield from solve.list_cells(cells, worker, cells.liquid)
        yield from self._couple(worker)
        yield [self._divergence(worker), *self._yields(worker)]
        if self._solids.present:
            yield solve.project(cells, cells.pressure, worker)

    def _follow(self, worker: int) -> Iterator[list[Recorded]]:
        energies = self.energies
        pressed = energies.of_walls(AT_PRESSURE, worker)
        met = self._meet(worker)
        gradient = [
            self._gradient(self._cells.pressure, worker),
            *self.viscosity.omit_slivers(worker),
        ]
        yield [*gradient, self._impulses(worker), *met, *pressed]
        yield self._respond(worker, pulled=True)
        for turn in range(LAYERS):
            yield [self._spread(worker, turn, self._copy(self._cells.sums, 0))]
        slide = self._slide(worker, self._walls.motions, rubs=self._walls.rub)
        yield [slide, *energies.of_faces(worker, self.viscosity.rate)]
        stop = [*self._push_out(worker, stops=True), *energies.of_walls(AT_END, worker)]
        yield [self._gather(worker), *stop]
        yield self._respond(worker, pulled=False)

    def _density_equation(self, worker: int) -> Iterator[list[Recorded]]:
        yield [self._sum_copies(worker, "density", self._cells.fills, 2)]
        yield [self._refill(worker)]
        yield [self._assemble(worker, self._mixture.uniform), self._excess(worker)]
        yield from self._projection.list_cells(self._cells, worker, self._cells.liquid)

    def _displacements(self, worker: int) -> Iterator[list[Recorded]]:
        for turn in range(LAYERS_SHIFT):
            yield [self._spread(worker, turn, self._no_sums)]
        yield [self._slide(worker, self._walls.still, rubs=False)]
        moves = [self._displace(worker), *self._push_out(worker, stops=False)]
        yield [*self._sum_shifts(worker, moves), *self.pushes.work(worker, self._run(worker))]

    def _sum_shifts(self, worker: int, moves: list[Recorded]) -> list[Recorded]:
        run = self._run(worker)
        first, last = (self.energies.of_shifts(worker, run, sign) for sign in (-1, 1))
        return [*first, *moves, *last]

    def _run(self, worker: int) -> slice:
        first, count = span(len(self._model), worker, len(self._workers))
        return slice(first, first + count)

    def _over_cells(self, worker: int, name: str, kernel: Any, inputs: list, outputs: list) -> Any:
        return name, self._cells.record(worker, kernel, inputs, outputs)

    def _copy(self, sums: wp.array, worker: int) -> wp.array:
        count = len(sums) // len(self._workers)
        return cast("wp.array", sums[worker * count : (worker + 1) * count])

    def _activate(self, worker: int) -> list[list[Recorded]]:
        cells, launch = self._cells, self._model.launch
        part, parts = self._projection.part(worker)
        counts = self._projection.counts
        ends = [cells.begins, cells.tops]
        outputs = [cells.phi, cells.known, cells.also, cells.liquid]
        kernel = active.make_forget(self._model.real)
        forget = self._over_cells(worker, "active", kernel, [], outputs)
        inputs = [part, len(self._workers), cells.window, cells.lowest, cells.highest, counts]
        widen = launch(active.widen, parts, inputs, [cells.below, cells.above])
        where = [int(self._walls.move), cells.window, cells.shares]
        kernel = active.make_count_active(self._model.real)
        inputs = [part, *where, cells.below, cells.above]
        count = launch(kernel, parts, inputs, [*ends, counts])
        kernel = active.make_list_active(self._model.real)
        listed = launch(kernel, parts, [part, *where, *ends, counts], [cells.active, cells.ends])
        return [[forget, ("active", widen)], [("active", count)], [("active", listed)]]

    def _scatter(self, worker: int) -> list[Named]:
        model, s, run, cells = self._model, self._state, self._run(worker), self._cells
        sums = self._copy(cells.sums, worker)
        inputs = [model.mass[run], model.volume[run], cells.lattice, cells.window]
        inputs += [s.x[run], s.v[run], s.C[run]]
        kernel, count = transfer.make_scatter(model.real, self._form), run.stop - run.start
        launch = model.launch(kernel, count, inputs, [sums])
        columns = [self._copy(ends, worker) for ends in (cells.lowest, cells.highest)]
        inputs = [cells.lattice, cells.window, s.x[run]]
        sweep = model.launch(active.make_sweep(model.real), count, inputs, columns)
        clear = [sums.zero_, lambda: columns[0].fill_(active.NONE), lambda: columns[1].fill_(-1)]
        named = [("clear", work) for work in clear]
        return [*named, *launches([("p2g", launch), ("active", sweep)])]

    def _sum_copies(self, worker: int, stage: str, copies: wp.array, width: int) -> Recorded:
        """Return a worker's launch that adds up all workers' vectors of `width` numbers."""
        if len(self._workers) == 1:
            return stage, None
        kernel = faces.make_sum_copies(self._model.real, width)
        return self._over_cells(
            worker, stage, kernel, [self._cells.count, len(self._workers)], [copies]
        )

    def _levels(self, worker: int) -> Recorded:
        cells, tracks = self._cells, self._tracks
        inputs = [cells.lattice, cells.window, tracks.clock, tracks.values]
        inputs += [*self._near_walls(), self._copy(cells.sums, 0)]
        outputs = [cells.velocity, cells.hats, cells.phi, cells.liquid, cells.known]
        kernel = surface.make_levels(self._model.real)
        return self._over_cells(worker, "levels", kernel, inputs, outputs)

    def _near_walls(self) -> list:
        cells = self._cells
        first = self._solids.first(self._walls)
        return [cells.open, cells.shares, cells.distances, cells.owners, first]

    def _assemble(self, worker: int, densities: wp.array) -> Recorded:
        cells = self._cells
        inputs = [cells.window, cells.open, densities, cells.phi, cells.liquid]
        outputs = [cells.diagonal, cells.links, cells.inverse]
        kernel = pressure.make_assemble(self._model.real)
        return self._over_cells(worker, "levels", kernel, inputs, outputs)

    def _divergence(self, worker: int) -> Recorded:
        cells, walls = self._cells, self._walls
        inputs = [int(walls.move), self._solids.first(walls), cells.lattice, cells.window]
        inputs += [walls.motions, cells.open, cells.covers]
        inputs += [cells.distances, cells.owners, cells.liquid]
        inputs += [self.viscosity.carry, cells.velocity]
        kernel = pressure.make_divergence(self._model.real)
        outputs = [cells.right, cells.pressure]
        return self._over_cells(worker, "levels", kernel, inputs, outputs)

    def _jumps(self, worker: int) -> list[Recorded]:
        if not self._solids.present:
            return []
        return [self._solids.jumps(self._cells, self._walls, worker)]

    def _couple(self, worker: int) -> list[list[Recorded]]:
        if not self._solids.present:
            return []
        weights = self._mixture.densities, self.pushes.gains
        return self._solids.couple(self._cells, weights, self._walls, self._tracks, worker)

    def _yields(self, worker: int) -> list[Recorded]:
        if self._bodies is None:
            return []
        known = self._cells, self._tracks.clock, worker, self._model.real
        return [(BODIES, self._bodies.yields(*known))]

    def _respond(self, worker: int, *, pulled: bool) -> list[Recorded]:
        if worker > 0 or not self._solids.present:
            return []
        if self._bodies is None:
            return self._solids.respond(self._walls, self._impulses_of_walls, self._tracks, pulled)
        step = self._impulses_of_walls.step
        return [(BODIES, self._bodies.answer(self._walls, step, self._model))]

    def _gradient(self, solution: wp.array, worker: int, *, shifts: float = 0.0) -> Recorded:
        cells = self._cells
        densities = self._mixture.uniform if shifts > 0 else self._mixture.densities
        inputs = [shifts, cells.lattice, cells.window, cells.open, densities]
        inputs += [cells.phi, cells.liquid, solution]
        kernel = pressure.make_gradient(self._model.real)
        outputs = [cells.velocity, cells.known]
        return self._over_cells(worker, "spread", kernel, inputs, outputs)

    def _impulses(self, worker: int) -> Recorded:
        model, cells, walls, tracks = self._model, self._cells, self._walls, self._tracks
        if not walls.all:
            return "walls", None
        part, parts = self._projection.part(worker)
        inputs = [part, self._mixture.density, self._projection.counts, cells.listed, cells.lattice]
        inputs += [cells.window, tracks.clock, tracks.values, walls.motions]
        inputs += [cells.open, cells.covers, cells.distances, cells.owners]
        inputs += [self._mixture.densities, cells.phi, cells.pressure, self.pushes.gains]
        inputs.append(self._solids.first(walls))
        outputs = [self._impulses_of_walls.rows(worker)]
        if self._bodies is None:
            inputs.append(len(walls.all))
            outputs.append(wp.zeros(0, dtype=types(model.real).vec3, device=model.device))
        else:
            inputs.append(self._solids.first(walls) + self._bodies.first)
            outputs.append(self._bodies.pressed)
        kernel = impulses.make_wall_impulses(model.real)
        return "walls", model.launch(kernel, parts, inputs, outputs)

    def _spread(self, worker: int, turn: int, sums: wp.array) -> Recorded:
        """Extrapolate velocities or displacements; `sums` is empty for displacements."""
        cells = self._cells
        known = [cells.known, cells.also]
        inputs = [self.viscosity.rate, cells.window, self._tracks.clock, known[turn % 2]]
        inputs += [self._mixture.densities, self._mixture.viscosities]
        inputs += [sums, cells.open, cells.owners, self._solids.first(self._walls)]
        outputs = [cells.velocity, known[1 - turn % 2]]
        kernel = spread.make_spread(self._model.real, self._form)
        return self._over_cells(worker, "spread", kernel, inputs, outputs)

    def _slide(self, worker: int, motions: wp.array, *, rubs: bool) -> Recorded:
        cells, walls, dx = self._cells, self._walls, self._model.dx
        mode = 2 if rubs and self.viscosity.rate > 0 else int(rubs)
        inputs = [mode, self._mixture.density * dx**3, cells.lattice, cells.window, motions]
        inputs += [walls.frictions, cells.open, cells.shares, cells.distances, cells.owners]
        inputs += [self._mixture.densities, cells.liquid, cells.known]
        inputs += [cells.pressure, cells.velocity]
        kernel = spread.make_slide(self._model.real)
        outputs = [cells.other, self._impulses_of_walls.rows(worker)]
        return self._over_cells(worker, "spread", kernel, inputs, outputs)

    def _gather(self, worker: int) -> Recorded:
        model, s, run, cells = self._model, self._state, self._run(worker), self._cells
        inputs = [cells.lattice, cells.window, self._tracks.clock, self._tracks.values]
        outputs = [s.x[run], s.residue[run], s.v[run], s.C[run], part_of(s.total, run)]
        outputs.append(cast("wp.array", self._missed[worker]))
        kernel, count = transfer.make_gather(model.real, self._form), run.stop - run.start
        return "g2p", model.launch(kernel, count, [*inputs, cells.other], outputs)

    def _push_out(self, worker: int, *, stops: bool) -> list[Recorded]:
        s, run = self._state, self._run(worker)
        sums, walls, cells = self._impulses_of_walls.rows(worker), self._walls, self._cells
        out = []
        if self._bodies is not None:
            out = [(BODIES, self._bodies.push_out(cells, walls, self._model, s.x[run]))]
        return [*out, *walls.push_out(cells, run, s, sums, stops=stops)]

    def _fill(self, worker: int, volume: wp.array) -> list[Named]:
        model, run, cells = self._model, self._run(worker), self._cells
        fills = self._copy(cells.fills, worker)
        inputs = [volume[run], cells.lattice, cells.window, self._state.x[run]]
        kernel = transfer.make_scatter_volume(model.real, self._form)
        launch = model.launch(kernel, run.stop - run.start, inputs, [fills])
        return [("density", fills.zero_), *launches([("density", launch)])]

    def _mix(self, worker: int, mixed: wp.array) -> Recorded:
        cells = self._cells
        inputs = [cells.window, self._copy(cells.fills, 0), self._copy(cells.sums, 0)]
        kernel = mixture.make_mix(self._model.real)
        return self._over_cells(worker, "density", kernel, inputs, [mixed])

    def _meet(self, worker: int) -> list[Recorded]:
        """Return the kernel launches that sum the impulses of the pressure between liquids."""
        cells, liquids = self._cells, self._mixture
        kernel, records = mixture.make_meeting(self._model.real), []
        for index, pair in enumerate(liquids.pairs):
            inputs = [liquids.density, cells.lattice, cells.window, cells.open, cells.liquid]
            inputs += [cells.pressure, *(liquids.fractions[number] for number in pair)]
            row = cast("wp.array", liquids.sums[worker, index])
            records.append(self._over_cells(worker, "density", kernel, inputs, [row]))
        return records

    def _refill(self, worker: int) -> Recorded:
        cells = self._cells
        inputs = [cells.lattice, cells.window, *self._near_walls(), self._copy(cells.fills, 0)]
        outputs = [cells.hats, cells.phi, cells.liquid]
        kernel = surface.make_refill(self._model.real)
        return self._over_cells(worker, "density", kernel, inputs, outputs)

    def _excess(self, worker: int) -> Recorded:
        cells = self._cells
        inputs = [cells.window, cells.open, cells.shares, cells.hats, cells.phi, cells.liquid]
        outputs = [cells.right, cells.packing]
        kernel = packing.make_excess(self._model.real)
        return self._over_cells(worker, "density", kernel, inputs, outputs)

    def _displace(self, worker: int) -> Recorded:
        model, run, cells = self._model, self._run(worker), self._cells
        inputs = [cells.lattice, cells.window, cells.other]
        kernel, count = transfer.make_displace(model.real, self._form), run.stop - run.start
        return "density", model.launch(kernel, count, inputs, [self._state.x[run]])
