"""The launches of one substep, recorded for the windows of the moment.

A substep reads as push, clear, p2g, update, collide, g2p; each is one launch per material and
thread. A recorded launch is repeated for a few microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import warp as wp

from phy124.kernels import transfer
from phy124.kernels.grid import make_merge, make_update
from phy124.kernels.reduction import shared_out
from phy124.mpm.grid import Grid
from phy124.mpm.state import Group, part_of
from phy124.mpm.workers import Named, Recorded, Worker, taken, work

if TYPE_CHECKING:
    from phy124.mpm.solver import Solver


def parts(solver: Solver, worker: Worker) -> Iterator[tuple[Group, slice]]:
    """The worker's part of each group."""
    for group, (start, stop) in zip(solver.groups, worker.runs, strict=True):
        if stop > start:
            yield group, slice(start, stop)


def record_pushes(solver: Solver) -> list[Named]:
    """What acts on particles before the scatter."""
    return work((name, record()) for name, record in solver.pushes)


def record_phases(solver: Solver) -> None:
    """Give every worker its work of the three phases."""
    grid = solver.grid
    for worker, share in zip(solver.workers, _shares(solver), strict=True):
        scatter = [_p2g(solver, group, part, worker.nodes) for group, part in parts(solver, worker)]
        grid.share = share
        update = [_update(solver, share), *((n, record()) for n, record in solver.collisions)]
        grid.share = None
        gather = [_g2p(solver, group, part) for group, part in parts(solver, worker)]
        gather = solver.outliers.around(worker, gather)
        clear: tuple[str, Callable[[], Any]] = ("clear", worker.nodes.nodes.zero_)
        worker.phases = [[clear, *work(scatter)], work(update), work(gather)]
    solver.workers[0].phases[2] += work((name, record()) for name, record in solver.closings)


def record_looks(solver: Solver, worker: Worker) -> list[wp.Launch]:
    """What measures the limits of the substep among a worker's particles."""
    s, looks = solver.state, list[Recorded]()
    for group, part in parts(solver, worker):
        threads, *share = shared_out(part.stop - part.start, solver.device)
        kernel = transfer.make_measure(group.law, solver.real)
        corners = solver.outliers.corners
        model = [*share, group.rows(part), solver.mass[part], solver.volume[part], corners]
        state = [s.x[part], s.v[part], s.C[part], s.F[part], part_of(s.history, part)]
        outputs = [worker.maxima, solver.stray]
        looks.append(("measure", solver.record(kernel, threads, [*model, *state], outputs)))
    return [launch for _, launch in taken(looks)]


def _shares(solver: Solver) -> list[tuple[int, int] | None]:
    """The layers of the shared grid that each worker brings up to date."""
    if len(solver.workers) == 1:
        return [None]
    low, layers = solver.grid.low[0], int(solver.grid.size[0])
    first, second = (worker.nodes for worker in solver.workers)
    middle = int((first.low[0] + first.size[0] + second.low[0]) // 2 - low)
    middle = min(max(middle, 0), layers)
    return [(0, middle), (middle, layers)]


def _p2g(solver: Solver, group: Group, part: slice, nodes: Grid) -> Recorded:
    s, law = solver.state, group.law
    kernel = transfer.make_p2g(law, solver.real, solver.form)
    model = [solver.mass[part], solver.volume[part], group.rows(part)]
    state = [s.x[part], s.v[part], s.C[part], s.F[part], part_of(s.history, part)]
    inputs = [*model, nodes.lattice, nodes.window, solver.clock, *state]
    count = part.stop - part.start
    return f"p2g {law.name}", solver.record(kernel, count, inputs, [nodes.nodes])


def _g2p(solver: Solver, group: Group, part: slice) -> Recorded:
    s, grid, law = solver.state, solver.grid, group.law
    kernel = transfer.make_g2p(law, solver.real, solver.form)
    inputs = [group.rows(part), grid.lattice, grid.window, solver.clock, grid.nodes]
    outputs = [s.x[part], s.residue[part], s.v[part], s.C[part], s.F[part]]
    outputs += [part_of(s.history, part), part_of(s.total, part)]
    count = part.stop - part.start
    return f"g2p {law.name}", solver.record(kernel, count, inputs, outputs)


def _update(solver: Solver, share: tuple[int, int] | None) -> Recorded:
    grid, inputs = solver.grid, [solver.clock, solver.tracks.values]
    if share is None:
        return "grid", solver.record(make_update(solver.real), grid.count, inputs, [grid.nodes])
    layer = int(grid.size[1] * grid.size[2])
    ranges = []
    for other in solver.workers:
        first = int(other.nodes.low[0] - grid.low[0]) * layer
        ranges += [first, first + other.nodes.count]
    nodes = [other.nodes.nodes for other in solver.workers]
    start, count = share[0] * layer, (share[1] - share[0]) * layer
    inputs = [start, *ranges, *inputs, *nodes]
    return "grid", solver.record(make_merge(solver.real), count, inputs, [grid.nodes])
