"""Records the kernel launches of one substep for the current windows of the grids.

A substep consists of the phases push, clear, p2g, update, collide and g2p. Each phase has one
kernel launch per law and worker. Repeating a recorded launch takes a few microseconds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

import warp as wp

from phy124.kernels import measure, transfer
from phy124.kernels.fluctuation import make_rpic
from phy124.kernels.grid import make_merge, make_update
from phy124.kernels.reduction import shared_out
from phy124.kernels.transfer import Law
from phy124.mpm.fluctuation import Fluctuation
from phy124.mpm.free import FreeBodies
from phy124.mpm.grid import Grid
from phy124.mpm.model import Model, State, part_of
from phy124.mpm.outliers import Outliers
from phy124.mpm.pairs import Pairs
from phy124.mpm.stage import Named, Recorded, Stage, launches, push_launches
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import GATHER, Part, Slabs, Worker

MEASURING = 2**17
"""Largest number of GPU threads that measure the limits; each block of threads writes once."""


class Transfers(NamedTuple):
    """The scatter and gather kernels of a constitutive law."""

    measure: Any
    p2g: Any
    g2p: Any

    @classmethod
    def of(cls, law: Law, real: Any, form: str) -> Transfers:
        """Return a law's kernels for a precision and an implementation of the transfers."""
        return cls(
            measure.make_measure(law, real),
            transfer.make_p2g(law, real, form),
            transfer.make_g2p(law, real, form),
        )


def kernels(laws: Iterable[Law], real: Any, form: str) -> Iterator[Any]:
    """Yield the kernels of a worker's substeps, except forces and boundaries."""
    yield make_update(real)
    yield measure.make_measure_speeds(real)
    for law in laws:
        yield from Transfers.of(law, real, form)


class Gathered(Protocol):
    """An object that reads each worker's particles of one law at a time, after the gather."""

    def allocate(self, model: Model, workers: int) -> None:
        """Allocate the object's memory for a number of workers."""
        ...

    def record(
        self, part: Part, worker: int, model: Model, state: State, tracks: Tracks
    ) -> Recorded:
        """Record the kernel launch that reads a worker's part of the particles.

        Args:
            part: Particles of one law that a worker processes.
            worker: Index of the worker.
            model: The constants of the run.
            state: The state after the gather.
            tracks: Quantities that change over time.
        """
        ...


@dataclass(frozen=True)
class Recorder:
    """Records the kernel launches of a substep."""

    model: Model
    state: State
    grids: Sequence[Grid]
    tracks: Tracks
    outliers: Outliers
    workers: Sequence[Worker]
    slabs: Slabs | None
    """The sets of nodes to which several workers scatter; None for a single worker."""
    pairs: Pairs
    free: FreeBodies
    missed: wp.array
    """For each worker, 1 if the gather skipped a particle outside the window, otherwise 0 [W,1]."""
    fluctuation: Fluctuation | None = None
    """Object that restores the motion that the grid does not represent; None for APIC."""
    gathered: Sequence[Gathered] = ()
    """Objects that read each worker's particles right after the gather."""
    rpic: float = 0.0
    """Rate at which the symmetric part of the velocity gradients C decays [1/s]."""
    guest: Any = None
    """A kernel launch of another solver, made between the update of the grids and the walls."""

    def record(
        self, pushes: Sequence[Stage], walls: Sequence[Stage], sums: Sequence[Stage]
    ) -> None:
        """Record the kernel launches of every worker's phases.

        The stages `pushes` act before the scatter, `walls` act after the update, and `sums` act
        last.
        """
        held = self.model.held
        for body in held - self.model.wet:
            self._put_down(body)
        for index, worker in enumerate(self.workers):
            moving = [part for part in worker.parts if part.group.body not in held]
            scatter = [record for part in moving for record in self._scatter(part)]
            update = self._update_phases(walls, index)
            gather = [record for part in moving for record in self._gather(part, index)]
            scattering = [*self._clear(index), *launches(scatter)]
            worker.phases = [*self._passes(moving, index), scattering, *map(launches, update)]
            worker.phases.append(launches(gather))
            if pushes:
                before = push_launches(pushes, self._grid, index, len(self.workers))
                worker.phases.insert(0, before)
        last = [*self.free.drift(), *((stage.name, stage.record(self._grid)) for stage in sums)]
        self.workers[0].phases[GATHER] += launches(last)

    def _passes(self, parts: Sequence[Part], worker: int) -> Iterator[list[Named]]:
        """Yield a worker's phases for the passes of AFLIP or XPIC, before the scatter."""
        kept = self.fluctuation
        for turn in range(kept.scheme.passes if kept else 0):
            assert kept is not None
            cleared = self._clear(worker, velocities=True)
            yield [*cleared, *launches([kept.carry(part, turn) for part in parts])]
            still = [self._update(body, worker, kept.still) for body in self._moving]
            yield launches(list(itertools.chain(*still)))
            grids = [self.grids[part.group.body] for part in parts]
            pairs = zip(parts, grids, strict=True)
            yield launches([kept.remain(part, grid, turn) for part, grid in pairs])

    def _put_down(self, body: int) -> None:
        """Scatter the mass of a fixed body to the body's grid, once for all substeps."""
        grid = self.grids[body]
        grid.nodes.zero_()
        every = wp.zeros(0, dtype=int, device=self.model.device)
        for group in self.model.groups:
            if group.body == body:
                part = Part(group, group.particles, every, len(group), grid, every)
                for _, launch in launches([self._p2g(part)]):
                    launch()

    @property
    def _moving(self) -> list[int]:
        still = self.model.held | self.model.wet
        return [body for body in range(len(self.grids)) if body not in still]

    @property
    def _grid(self) -> Grid:
        """A grid for launches that need a grid as an argument but do not use the grid's nodes."""
        return next(grid for grid in self.grids if grid.count) if self.model.wet else self.grids[0]

    def _update_phases(self, walls: Sequence[Stage], worker: int) -> list[list[Recorded]]:
        """Return a worker's phases after the scatter: grid update, contact of bodies, and walls.

        Walls come last, so that no other stage can push material through walls.
        """
        first = next(iter(walls), None)
        fused = self._update_with(first) if first is not None else None
        if fused is not None:
            phases, walls = [[fused]], walls[1:]
        else:
            phases = [[record for body in self._moving for record in self._update(body, worker)]]
        if self.pairs.touching(self.grids):
            phases += [self.pairs.record(self.grids, worker, len(self.workers)), []]
        if self.free.all:
            phases += [self._meet_free() if worker == 0 else [], []]
        if self.guest is not None:
            phases += [[("lattice", self.guest)] if worker == 0 else [], []]
        alone = False
        for (place, body), wall in itertools.product(enumerate(self._moving), walls):
            if self.slabs is not None and wall.alone != alone:
                phases.append([])
                alone = wall.alone
            record = self._wall(wall, self.grids[body], place, worker, alone=alone)
            if record is not None:
                phases[-1].append(record)
        return phases

    def _update_with(self, wall: Stage) -> Recorded | None:
        """Return one kernel launch for the grid update and a wall; None if impossible."""
        if wall.with_update is None or len(self.grids) > 1 or not self._grid.apart:
            return None
        launch = wall.with_update(self._grid)
        return None if launch is None else (wall.name, launch)

    def _meet_free(self) -> list[Recorded]:
        records = (self.free.record(self.grids[body], body) for body in self._moving)
        return list(itertools.chain(*records))

    def _wall(
        self, wall: Stage, grid: Grid, place: int, worker: int, *, alone: bool
    ) -> Recorded | None:
        """Return the kernel launch for a wall and a body; if `alone`, only for the first worker."""
        if alone:
            return (wall.name, wall.record(grid)) if worker == 0 else None
        bodies = len(self._moving)
        places = (worker * bodies + place, len(self.workers) * bodies)
        with grid.only(self._layers(grid, worker), *places):
            return wall.name, wall.record(grid)

    def _layers(self, grid: Grid, worker: int) -> tuple[int, int] | None:
        """Return the layers of a grid that a worker updates; None for all layers."""
        if self.slabs is None:
            return None
        first, last = (
            int(grid.size[0]) * place // len(self.workers) for place in (worker, worker + 1)
        )
        return first, last

    def _clear(self, index: int, *, velocities: bool = False) -> Iterator[Named]:
        """Yield the kernel launches that clear a worker's nodes before the scatter.

        Velocities (`Grid.nodes`) and momenta may be separate arrays. In this case, the velocities
        are cleared if `velocities` is set, and the momenta if it is not.
        """
        if self.slabs is not None:
            yield "clear", self.slabs.runs[index].zero_
            return
        for body in self._moving:
            # The gather has already cleared the momenta if they are a separate array.
            if velocities or not self.grids[body].apart:
                yield "clear", self.grids[body].nodes.zero_

    def measures(self, worker: Worker, stray: wp.array) -> list[wp.Launch]:
        """Return the kernel launches that measure a substep's limits over a worker's particles."""
        model, s, measures = self.model, self.state, []
        for part in worker.parts:
            group, run = part.group, part.particles
            threads, *fraction = shared_out(part.count, model.device, MEASURING)
            kernel = Transfers.of(group.law, model.real, model.form).measure
            read = [group.rows(run), model.mass[run], model.volume[run], self.outliers.corners]
            state = [s.x[run], s.v[run], s.C[run], s.F[run], part_of(s.history, run)]
            inputs = [*fraction, part.count, part.chosen, *read, *state]
            measures.append(model.launch(kernel, threads, inputs, [part.maxima, stray]))
        return [launch for launch in measures if launch is not None]

    def speeds(self, worker: Worker, stray: wp.array) -> list[wp.Launch]:
        """Return the kernel launches that measure only the speeds of a worker's particles."""
        model, glances = self.model, []
        for part in worker.parts:
            run, (threads, *fraction) = part.particles, shared_out(part.count, model.device)
            inputs = [*fraction, part.count, part.chosen, self.state.v[run], self.state.C[run]]
            kernel = measure.make_measure_speeds(model.real)
            glances.append(model.launch(kernel, threads, inputs, [worker.speeds, stray]))
        return [launch for launch in glances if launch is not None]

    def _scatter(self, part: Part) -> Iterator[Recorded]:
        """Yield the kernel launches that scatter a part of the particles, after RPIC damping if
        required.

        The damping runs before the scatter instead of after the gather, so that measurements
        between two substeps include the strain of the substep.
        """
        if self.rpic > 0:
            inputs = [part.chosen, self.rpic, self.tracks.clock]
            kernel, outputs = make_rpic(self.model.real), [self.state.C[part.particles]]
            yield "rpic", self.model.launch(kernel, part.count, inputs, outputs)
        yield self._p2g(part)

    def _p2g(self, part: Part) -> Recorded:
        model, s, law, run = self.model, self.state, part.group.law, part.particles
        kernel = Transfers.of(law, model.real, model.form).p2g
        read = [part.chosen, model.mass[run], model.volume[run], part.group.rows(run)]
        state = [s.x[run], s.v[run], s.C[run], s.F[run], part_of(s.history, run)]
        inputs = [*read, part.nodes.lattice, part.nodes.window, self.tracks.clock, *state]
        return f"p2g {law.name}", model.launch(kernel, part.count, inputs, [part.nodes.momenta])

    def _gather(self, part: Part, worker: int) -> list[Recorded]:
        model, s, run = self.model, self.state, part.particles
        law, grid = part.group.law, self.grids[part.group.body]
        kernel = Transfers.of(law, model.real, model.form).g2p
        # Each thread also clears some nodes for the next scatter.
        clears = grid.apart and part.group.start == 0
        cleared = [-(-grid.count // part.count), part.count] if clears else [0, 0]
        read = [part.chosen, *cleared, part.group.rows(run)]
        inputs = [*read, grid.lattice, grid.window, self.tracks.clock, grid.nodes]
        outputs = [s.x[run], s.residue[run], s.v[run], s.C[run], s.F[run]]
        outputs += [part_of(s.history, run), part_of(s.total, run)]
        outputs += [cast("wp.array", self.missed[worker]), grid.momenta]
        record = f"g2p {law.name}", model.launch(kernel, part.count, inputs, outputs)
        records = self.outliers.around(part, record, grid, self.tracks)
        records += [reader.record(part, worker, model, s, self.tracks) for reader in self.gathered]
        if self.fluctuation is not None:
            records.append(self.fluctuation.keep(part))
        return records

    def _update(self, body: int, worker: int, clock: wp.array | None = None) -> list[Recorded]:
        model, grid, slabs = self.model, self.grids[body], self.slabs
        momenta = grid.nodes if clock is not None else grid.momenta
        clock = self.tracks.clock if clock is None else clock
        records = []
        count, nodes = grid.count, grid.nodes
        layers = self._layers(grid, worker)
        if layers is not None and slabs is not None:
            rows = (layers[1] - layers[0], int(grid.size[1]))
            boxes = [layers[0], grid.window, slabs.boxes[body], slabs.starts[body], slabs.pool]
            records.append(("grid", model.launch(make_merge(model.real), rows, boxes, [nodes])))
            nodes = momenta = grid.slab(*layers)
            count = len(nodes)
        inputs = [clock, self.tracks.values, momenta]
        update = model.launch(make_update(model.real), count, inputs, [nodes])
        return [*records, ("grid", update)]
