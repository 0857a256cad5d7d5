"""The launches of one substep, recorded for the grid's current windows.

A substep consists of push, clear, p2g, update, collide and g2p; each is one launch per law and
worker. Repeating a recorded launch takes a few microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import warp as wp

from phy124.kernels import transfer
from phy124.kernels.grid import make_merge, make_update
from phy124.kernels.reduction import shared_out
from phy124.kernels.transfer import Law
from phy124.mpm.grid import Grid
from phy124.mpm.model import Model
from phy124.mpm.outliers import Outliers
from phy124.mpm.slabs import Slabs
from phy124.mpm.stage import Named, Recorded, Stage, launches
from phy124.mpm.state import State, part_of
from phy124.mpm.workers import GATHER, Part, Worker
from phy124.tracks import Tracks


class Transfers(NamedTuple):
    """The kernels of a law."""

    measure: Any
    p2g: Any
    g2p: Any

    @classmethod
    def of(cls, law: Law, real: Any, form: str) -> Transfers:
        """Those of one precision and form."""
        return cls(
            transfer.make_measure(law, real),
            transfer.make_p2g(law, real, form),
            transfer.make_g2p(law, real, form),
        )


def kernels(laws: Iterable[Law], real: Any, form: str) -> Iterator[Any]:
    """What the substeps of one worker launch, besides forces and boundaries."""
    yield make_update(real)
    for law in laws:
        yield from Transfers.of(law, real, form)


@dataclass(frozen=True)
class Recorder:
    """Records the launches of a substep."""

    model: Model
    state: State
    grid: Grid
    tracks: Tracks
    outliers: Outliers
    workers: Sequence[Worker]
    slabs: Slabs | None
    """Those of several workers."""

    def record(
        self, pushes: Sequence[Stage], walls: Sequence[Stage], sums: Sequence[Stage]
    ) -> None:
        """Give every worker its phases.

        Args:
            pushes: Stages of forces on particles, before the scatter.
            walls: Stages of boundaries, after the update.
            sums: Stages that end the substep.
        """
        for index, worker in enumerate(self.workers):
            layers = self._layers(index)
            scatter = [self._p2g(part) for part in worker.parts]
            update = self._update_phases(walls, index, layers)
            gather = [record for part in worker.parts for record in self._gather(part)]
            clear: tuple[str, Callable[[], Any]] = ("clear", self._clear(index))
            worker.phases = [[clear, *launches(scatter)], *map(launches, update), launches(gather)]
            if pushes:
                worker.phases.insert(0, self._push(pushes, index))
        self.workers[0].phases[GATHER] += launches([(s.name, s.record(self.grid)) for s in sums])

    def _push(self, stages: Sequence[Stage], worker: int) -> list[Named]:
        """A worker's share of the pushes; the first has them all unless all can be shared."""
        if all(stage.by_run for stage in stages):
            with self.grid.only(None, worker, len(self.workers)):
                return launches([(stage.name, stage.record(self.grid)) for stage in stages])
        if worker > 0:
            return []
        return launches([(stage.name, stage.record(self.grid)) for stage in stages])

    def _update_phases(
        self, walls: Sequence[Stage], worker: int, layers: tuple[int, int] | None
    ) -> list[list[Recorded]]:
        """A worker's phases of update and walls; the first worker does some walls alone."""
        with self.grid.only(layers, worker, len(self.workers)):
            phases, alone = [self._update(layers)], False
        for wall in walls:
            if layers is not None and wall.alone != alone:
                phases.append([])
                alone = wall.alone
            if not alone:
                with self.grid.only(layers, worker, len(self.workers)):
                    phases[-1].append((wall.name, wall.record(self.grid)))
            elif worker == 0:
                phases[-1].append((wall.name, wall.record(self.grid)))
        return phases

    def _layers(self, worker: int) -> tuple[int, int] | None:
        """The layers of the shared grid that a worker updates; None: all."""
        if self.slabs is None:
            return None
        first, last = (
            int(self.grid.size[0]) * place // len(self.workers) for place in (worker, worker + 1)
        )
        return first, last

    def _clear(self, worker: int) -> Callable[[], Any]:
        """Clears the nodes that a worker scatters to."""
        return self.grid.nodes.zero_ if self.slabs is None else self.slabs.runs[worker].zero_

    def measures(self, worker: Worker, stray: wp.array) -> list[wp.Launch]:
        """The launches that measure the limits of the substep among a worker's particles."""
        model, s, found = self.model, self.state, []
        for part in worker.parts:
            group, run = part.group, part.particles
            threads, *fraction = shared_out(part.count, model.device)
            kernel = Transfers.of(group.law, model.real, model.form).measure
            read = [group.rows(run), model.mass[run], model.volume[run], self.outliers.corners]
            state = [s.x[run], s.v[run], s.C[run], s.F[run], part_of(s.history, run)]
            inputs = [*fraction, part.count, part.chosen, *read, *state]
            found.append(model.launch(kernel, threads, inputs, [part.maxima, stray]))
        return [launch for launch in found if launch is not None]

    def _p2g(self, part: Part) -> Recorded:
        model, s, law, run = self.model, self.state, part.group.law, part.particles
        kernel = Transfers.of(law, model.real, model.form).p2g
        read = [part.chosen, model.mass[run], model.volume[run], part.group.rows(run)]
        state = [s.x[run], s.v[run], s.C[run], s.F[run], part_of(s.history, run)]
        inputs = [*read, part.nodes.lattice, part.nodes.window, self.tracks.clock, *state]
        return f"p2g {law.name}", model.launch(kernel, part.count, inputs, [part.nodes.nodes])

    def _gather(self, part: Part) -> list[Recorded]:
        model, s, grid, run = self.model, self.state, self.grid, part.particles
        law = part.group.law
        kernel = Transfers.of(law, model.real, model.form).g2p
        read = [part.chosen, part.group.rows(run)]
        inputs = [*read, grid.lattice, grid.window, self.tracks.clock, grid.nodes]
        outputs = [s.x[run], s.residue[run], s.v[run], s.C[run], s.F[run]]
        outputs += [part_of(s.history, run), part_of(s.total, run)]
        record = f"g2p {law.name}", model.launch(kernel, part.count, inputs, outputs)
        return self.outliers.around(part, record, grid, self.tracks)

    def _update(self, layers: tuple[int, int] | None) -> list[Recorded]:
        model, grid, slabs = self.model, self.grid, self.slabs
        inputs, found = [self.tracks.clock, self.tracks.values], []
        count, nodes = grid.count, grid.nodes
        if layers is not None and slabs is not None:
            rows = (layers[1] - layers[0], int(grid.size[1]))
            boxes = [layers[0], grid.window, slabs.boxes, slabs.starts, slabs.pool]
            found.append(("grid", model.launch(make_merge(model.real), rows, boxes, [nodes])))
            nodes = grid.slab(*layers)
            count = len(nodes)
        update = model.launch(make_update(model.real), count, inputs, [nodes])
        return [*found, ("grid", update)]
