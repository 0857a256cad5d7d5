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
from phy124.mpm.model import Group, Model
from phy124.mpm.outliers import Outliers
from phy124.mpm.stage import Named, Recorded, Stage, launches
from phy124.mpm.state import State, part_of
from phy124.mpm.workers import Worker, layers_of
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

    def pushes(self, stages: Sequence[Stage]) -> list[Named]:
        """The launches that act on particles before the scatter."""
        return launches([(stage.name, stage.record(self.grid)) for stage in stages])

    def record(self, walls: Sequence[Stage], sums: Sequence[Stage]) -> None:
        """Give every worker its scatter, update and gather.

        Args:
            walls: Stages of boundaries, after the update.
            sums: Stages that end the substep.
        """
        for worker, layers in zip(self.workers, layers_of(self.workers, self.grid), strict=True):
            parts = list(worker.parts(self.model.groups))
            scatter = [self._p2g(group, part, worker.nodes) for group, part in parts]
            with self.grid.only(layers):
                update = [self._update(layers)]
                update += [(wall.name, wall.record(self.grid)) for wall in walls]
            gather = [self._g2p(group, part) for group, part in parts]
            gather = self.outliers.around(worker, gather, self.grid, self.tracks)
            clear: tuple[str, Callable[[], Any]] = ("clear", worker.nodes.nodes.zero_)
            worker.phases = [[clear, *launches(scatter)], launches(update), launches(gather)]
        self.workers[0].phases[2] += launches([(s.name, s.record(self.grid)) for s in sums])

    def measures(self, worker: Worker, stray: wp.array) -> list[wp.Launch]:
        """The launches that measure the limits of the substep among a worker's particles."""
        model, s, found = self.model, self.state, []
        for group, part in worker.parts(model.groups):
            threads, *fraction = shared_out(part.stop - part.start, model.device)
            kernel = Transfers.of(group.law, model.real, model.form).measure
            read = [group.rows(part), model.mass[part], model.volume[part], self.outliers.corners]
            state = [s.x[part], s.v[part], s.C[part], s.F[part], part_of(s.history, part)]
            inputs, outputs = [*fraction, *read, *state], [worker.maxima, stray]
            found.append(model.launch(kernel, threads, inputs, outputs))
        return [launch for launch in found if launch is not None]

    def _p2g(self, group: Group, part: slice, nodes: Grid) -> Recorded:
        model, s, law = self.model, self.state, group.law
        kernel = Transfers.of(law, model.real, model.form).p2g
        read = [model.mass[part], model.volume[part], group.rows(part)]
        state = [s.x[part], s.v[part], s.C[part], s.F[part], part_of(s.history, part)]
        inputs = [*read, nodes.lattice, nodes.window, self.tracks.clock, *state]
        count = part.stop - part.start
        return f"p2g {law.name}", model.launch(kernel, count, inputs, [nodes.nodes])

    def _g2p(self, group: Group, part: slice) -> Recorded:
        model, s, grid, law = self.model, self.state, self.grid, group.law
        kernel = Transfers.of(law, model.real, model.form).g2p
        inputs = [group.rows(part), grid.lattice, grid.window, self.tracks.clock, grid.nodes]
        outputs = [s.x[part], s.residue[part], s.v[part], s.C[part], s.F[part]]
        outputs += [part_of(s.history, part), part_of(s.total, part)]
        count = part.stop - part.start
        return f"g2p {law.name}", model.launch(kernel, count, inputs, outputs)

    def _update(self, layers: tuple[int, int] | None) -> Recorded:
        model, grid, inputs = self.model, self.grid, [self.tracks.clock, self.tracks.values]
        if layers is None:
            return "grid", model.launch(make_update(model.real), grid.count, inputs, [grid.nodes])
        layer = int(grid.size[1] * grid.size[2])
        ranges = []
        for other in self.workers:
            first = int(other.nodes.low[0] - grid.low[0]) * layer
            ranges += [first, first + other.nodes.count]
        nodes = [other.nodes.nodes for other in self.workers]
        start, count = layers[0] * layer, (layers[1] - layers[0]) * layer
        inputs = [start, *ranges, *inputs, *nodes]
        return "grid", model.launch(make_merge(model.real), count, inputs, [grid.nodes])
