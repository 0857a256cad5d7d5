"""The crew: all workers (threads) of a run, and the kernel launches on their cells and nodes.

Cells and nodes are sorted by x, so consecutive cells use consecutive nodes. Each worker adds the
forces of its cells to private memory. For each node, the sums of all workers are then added in a
fixed order, so that runs with equal numbers of threads are bitwise equal.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import sparse, types
from phy124.kernels.lattice import nodes as node_kernels
from phy124.kernels.lattice import points as point_kernels
from phy124.kernels.lattice import simd
from phy124.kernels.lattice.stress import MAXIMA, make_lattice_measure, make_shock, make_stress
from phy124.kernels.lattice.work import PUSHED, STRESS, make_node_work, make_push_work
from phy124.kernels.launches import reader
from phy124.kernels.reduction import shared_out
from phy124.lattice.reach import find_reach
from phy124.lattice.rest import RestLattice
from phy124.lattice.walls import Nodes
from phy124.lattice.workers import MEASURE, PLACE, Worker
from phy124.mpm.model import Group, Model, State
from phy124.mpm.stage import Named, Recorded, launches
from phy124.mpm.tracks import Tracks
from phy124.particles.lattice import PER_CELL

LINE = 16
"""Number of values per cache line; no two workers write to one cache line."""


class Crew:
    """All workers of a run."""

    def __init__(
        self,
        model: Model,
        state: State,
        lattice: RestLattice,
        nodes: Nodes,
        count: int,
        *,
        vectors: bool = True,
    ) -> None:
        """Divide cells and nodes evenly among `count` workers.

        If `vectors` is True, vectorised CPU kernels are used where they exist.
        """
        self._model, self._state, self._lattice = model, state, lattice
        self.nodes = nodes
        self._vectors = vectors and simd.usable(model.real, model.device)
        self._blocks: dict[tuple[int, int], tuple[int, wp.array, wp.array]] = {}
        t, device = types(model.real), model.device
        self._rows = wp.array(lattice.rows.ravel(), dtype=int, device=device)
        self._offset = model.array(lattice.offset, t.vec3)
        self._rest = model.array(model.rest, t.vec3)
        self._kept = wp.zeros(len(model), dtype=t.vec3, device=device)
        cells = np.linspace(0, len(lattice.rows), count + 1).astype(int)
        edges = np.linspace(0, len(lattice), count + 1).astype(int)
        spans = [_span_of_cells(lattice, int(a), int(b)) for a, b in itertools.pairwise(cells)]
        room = [-(-(span.stop - span.start) // LINE) * LINE for span in spans]
        begin = np.cumsum([0, *room])
        self._parts = [slice(int(b), int(b) + r) for b, r in zip(begin[:-1], room, strict=True)]
        """Each worker's slice of a pool, which is an array with the forces of all workers."""
        self._pool, self._pushes = (
            wp.zeros(int(begin[-1]), dtype=t.vec3, device=device) for _ in range(2)
        )
        numbers = [(span.start, span.stop, at) for span, at in zip(spans, begin, strict=False)]
        self._spans = wp.array(np.array(numbers, np.int32), dtype=wp.vec3i, device=device)
        self.lasting: wp.array | None = None
        """A pool of forces [N] that act until they are replaced; None if no such forces act."""
        self._maxima = wp.zeros((count, LINE), dtype=model.real, device=device)
        self._read_maxima = reader(self._maxima)
        self.workers = [
            Worker(
                slice(PER_CELL * int(cells[w]), PER_CELL * int(cells[w + 1])),
                slice(int(edges[w]), int(edges[w + 1])),
                spans[w],
                self.part_of(self._pool, w),
                self.part_of(self._pushes, w),
                cast("wp.array", self._maxima[w]),
            )
            for w in range(count)
        ]
        self.tied = self._sparse(lattice, lattice.ties.tocsr())
        """For each tied node, the heavier nodes from which its motion is extrapolated
        (phy124/kernels/lattice/nodes.py).
        """
        self._donors = self._sparse(lattice, lattice.ties.T.tocsr())
        self._push_donors = self._sparse(lattice, lattice.pushes)
        self.stray, self._uncounted = (wp.zeros(1, dtype=int, device=device) for _ in range(2))
        self._read_stray = reader(self.stray)
        self.no_pull = wp.zeros(1, dtype=t.vec4, device=device)
        """A uniform acceleration of zero, for kernel launches without gravity."""
        self._middle = wp.zeros_like(nodes.u)
        """Velocities between two kicks of a substep, or before a kick of chosen nodes [N,3]."""
        self._unread = wp.zeros(MAXIMA, dtype=model.real, device=device)
        self.measuring = all(self.vectors(g) and is_viscous(g, model) for g in model.groups)
        """Whether the stress kernels measure the largest speed and strain rate in every substep."""
        for worker in self.workers:
            worker.tasks = {MEASURE: self._measure(worker), PLACE: self._follow(worker)}

    def _sparse(self, lattice: RestLattice, ties: Any) -> Any:
        """Return a sparse matrix on the device, with one row per node."""
        model, count = self._model, len(lattice)
        starts, columns = ties.indptr, ties.indices
        if ties.shape[0] != count:  # The rows of nodes that are not tied are empty.
            lengths = np.zeros(count, np.int64)
            lengths[lattice.tied] = np.diff(starts)
            starts = np.concatenate([[0], np.cumsum(lengths)])
        elif ties.shape[1] != count:  # Each tied node is a column.
            columns = lattice.tied[columns]
        matrix = sparse(model.real)()
        matrix.starts, matrix.nodes = (
            wp.array(np.asarray(values, np.int32), dtype=int, device=model.device)
            for values in (starts, columns)
        )
        matrix.weights = model.array(ties.data, model.real)
        return matrix

    def reach(self, cells: NDArray[np.int64] | None) -> None:
        """Set the cells with points on which forces act from now on; None: all cells."""
        reached = find_reach(cells, self._lattice, self.workers, self._model.device)
        for worker, reach in zip(self.workers, reached, strict=True):
            worker.reach = reach

    def locate(self, worker: Worker) -> list[Named]:
        """Return the kernel launch that computes x and v of points, before forces act."""
        nodes, state, model, points = self.nodes, self._state, self._model, worker.reach.points
        outputs = [state.x, state.v, self._kept]
        if self._vectors and len(points):
            motion, kernel = [self._rest, nodes.u, nodes.v], simd.make_locate_simd()
            span, cells = worker.points, worker.reach.cells
            launch = self._over_blocks(kernel, span, [model.dx], motion, outputs, cells)
            return launches([("locate", launch)])
        inputs = [points, self._rows, self._offset, self._rest, nodes.u, nodes.v]
        kernel = point_kernels.make_locate(model.real)
        return launches([("locate", model.launch(kernel, len(points), inputs, outputs))])

    def force(self, worker: Worker, pushes: Tracks | None = None) -> list[Named]:
        """Return the kernel launches that sum the forces of a worker's points on the nodes.

        `pushes` are the tracks of forces on points; None: no force acts on points.
        """
        outputs = [worker.forces, worker.maxima, self.stray]
        stress = self._stress(worker, self.nodes.u, outputs)
        if pushes is None:
            return stress
        clear: Callable[[], Any] = worker.pushes.zero_
        return [("clear", clear), *launches([self._push(worker, pushes)]), *stress]

    def press(self, pushes: wp.array, turns: wp.array) -> None:
        """Replace the forces that act on nodes until the next call.

        The forces accelerate the points by `pushes` [P,3], m/s^2; `turns` [P,3,3] are the moments
        of the forces (see `make_press`).
        """
        assert self.lasting is not None
        self.lasting.zero_()
        model, state, kernel = self._model, self._state, point_kernels.make_press(self._model.real)
        for index, worker in enumerate(self.workers):
            span = worker.points
            inputs = [span.start, worker.touched.start, model.mass, model.dx, self._rows]
            inputs += [self._offset, state.F, pushes, turns]
            count, part = span.stop - span.start, self.part_of(self.lasting, index)
            wp.launch(kernel, count, inputs=inputs, outputs=[part], device=model.device)

    def lasting_forces(self) -> list[Any]:
        """Return the arguments of `force_on` (kernels/lattice/nodes.py) for the stored forces."""
        return [self.lasting, self._spans, self._push_donors]

    def trial(self, worker: Worker, u: wp.array, out: wp.array) -> list[Named]:
        """Return the kernel launches that sum a worker's forces due to trial displacements `u`
        [N,3], m.

        `out` is the worker's part of a pool.
        """
        return self._stress(worker, u, [out, self._unread, self.stray])

    def shock(self, worker: Worker, clock: wp.array, out: wp.array | None = None) -> list[Named]:
        """Return the kernel launch that adds the forces of the artificial viscosity to the nodes.

        Args:
            worker: The worker.
            clock: Kick, drift and time of the substep [3], s.
            out: The worker's part of a pool, which receives the forces after the kick. None: the
                worker's own array receives the forces before the kick.
        """
        nodes, span, model = self.nodes, worker.points, self._model
        outputs = [worker.forces if out is None else out]
        motion = [clock, nodes.u, nodes.v if out is None else nodes.before]
        if self._vectors and span.stop > span.start:
            constants = [worker.touched.start, model.dx, model.mass]
            kernel = simd.make_shock_simd()
            launch = self._over_blocks(kernel, span, constants, motion, outputs)
            return launches([("shock", launch)])
        inputs = [span.start, worker.touched.start, model.mass, model.dx, self._rows, self._offset]
        launch = model.launch(
            make_shock(model.real), span.stop - span.start, [*inputs, *motion], outputs
        )
        return launches([("shock", launch)])

    @property
    def viscous(self) -> list[Group]:
        """The groups of points whose stress depends on the rate of strain."""
        return [group for group in self._model.groups if is_viscous(group, self._model)]

    def viscosity(self, worker: Worker, out: wp.array) -> list[Named]:
        """Return the kernel launches that sum a worker's viscous forces after the velocities have
        changed.

        The viscous forces are computed as the forces of a material without stiffness.
        """
        records = []
        for group in self.viscous:
            theta = np.array(group.theta.numpy())
            theta[:, : max(section.scaled for section in _sections(group, self._model))] = 0
            soft = replace(group, theta=wp.array(theta, dtype=group.theta.dtype, device=out.device))
            outputs = [out, self._unread, self._uncounted]
            records.append(self._stress_of(worker, soft, self.nodes.u, outputs))
        return launches(records)

    def new_pool(self) -> wp.array:
        """Return a pool: an array of zeros for the forces of all workers."""
        return wp.zeros_like(self._pool)

    def part_of(self, pool: wp.array, index: int) -> wp.array:
        """Return a worker's part of a pool."""
        return cast("wp.array", pool[self._parts[index]])

    def work(
        self, worker: Worker, at: int, tracks: Tracks, out: wp.array, pool: wp.array | None = None
    ) -> list[Named]:
        """Return the kernel launch that sums the work of forces on a worker's nodes, after all
        contact.

        Args:
            worker: The worker.
            at: Index of the sum (phy124/kernels/lattice/work.py).
            tracks: The tracks of the run, with the clock and the uniform acceleration.
            out: The sums.
            pool: The forces. None: if `at` is `PUSHED`, the forces of pushes; otherwise, the forces
                of the stress.
        """
        pushed = at == PUSHED
        if pool is None:
            pool = self._pushes if pushed else self._pool
        nodes, span, model = self.nodes, worker.nodes, self._model
        donors = self._push_donors if pushed else self._donors
        uniform = tracks.values if at == STRESS else self.no_pull
        inputs = [span.start, at, nodes.inverse, pool, self._spans, donors, tracks.clock]
        inputs += [uniform, nodes.before, nodes.v]
        kernel = make_node_work(model.real)
        return launches([("work", model.launch(kernel, span.stop - span.start, inputs, [out]))])

    def push_work(self, worker: Worker, tracks: Tracks, out: wp.array) -> list[Named]:
        """Return the kernel launch that sums impulse and work of a worker's forces on points.

        The sums `out` are in the order of phy124/kernels/work.py.
        """
        nodes, model, chosen = self.nodes, self._model, worker.reach.nodes
        threads, *fraction = shared_out(len(chosen), model.device)
        inputs = [*fraction, chosen, nodes.inverse, self._pushes, self._spans]
        inputs += [self._push_donors, tracks.clock, nodes.before, nodes.v]
        return launches(
            [("work", model.launch(make_push_work(model.real), threads, inputs, [out]))]
        )

    def _push(self, worker: Worker, tracks: Tracks) -> Recorded:
        points, state = worker.reach.points, self._state
        inputs = [points, worker.touched.start, self._model.mass, tracks.clock, self._rows]
        inputs += [self._offset, state.v, self._kept]
        kernel = point_kernels.make_push(self._model.real)
        launch = self._model.launch(kernel, len(points), inputs, [worker.pushes])
        return "push", launch

    def _over_blocks(
        self,
        kernel: Any,
        span: slice,
        constants: list[Any],
        motion: Sequence[Any],
        outputs: list[Any],
        cells: NDArray[np.int64] | None = None,
    ) -> wp.Launch | None:
        """Record a launch over blocks of `cells`; by default, the cells with points in `span`."""
        if cells is not None:
            blocks = self._pack(cells)
        else:
            known = span.start, span.stop
            if known not in self._blocks:
                every = np.arange(span.start // PER_CELL, span.stop // PER_CELL)
                self._blocks[known] = self._pack(every)
            blocks = self._blocks[known]
        full, order, packed = blocks
        inputs = [full, *constants, order, packed, self._rows, *motion]
        return self._model.launch(kernel, len(order) // simd.CELLS, inputs, outputs)

    def _pack(self, cells: NDArray[np.int64]) -> tuple[int, wp.array, wp.array]:
        points = (PER_CELL * cells[:, None] + np.arange(PER_CELL)).ravel()
        volume = np.asarray(self._model.volume.numpy(), np.float64)[points]
        blocks, device = simd.pack(self._lattice.offset[points], volume, cells), self._model.device
        order = wp.array(blocks.order.ravel(), dtype=int, device=device)
        packed = wp.array(blocks.packed.ravel(), dtype=wp.float32, device=device)
        return blocks.full, order, packed

    def _stress(self, worker: Worker, u: wp.array, outputs: list[wp.array]) -> list[Named]:
        records = [self._stress_of(worker, group, u, outputs) for group in self._model.groups]
        return [("clear", outputs[0].zero_), *launches(records)]

    def _stress_of(
        self, worker: Worker, group: Group, u: wp.array, outputs: list[wp.array]
    ) -> Recorded:
        """Record the kernel launch that adds the stress forces of a group to the nodes.

        The `outputs` are the forces and, for vectorised kernels, the maxima of the motion and the
        number of non-finite points.
        """
        model, span = self._model, _common(worker.points, group.particles)
        name, motion = f"stress {group.law.name}", (u, self.nodes.lagging)
        if self.vectors(group) and span.stop > span.start:
            constants = [group.start, worker.touched.start, model.dx, group.theta]
            kernel = simd.make_stress_simd(group.law, is_viscous(group, model))
            return name, self._over_blocks(kernel, span, constants, motion, outputs)
        inputs = [span.start, group.start, worker.touched.start, group.theta, model.volume]
        inputs += [model.dx, self._rows, self._offset, *motion]
        kernel = make_stress(group.law, model.real, is_viscous(group, model))
        return name, model.launch(kernel, span.stop - span.start, inputs, outputs[:1])

    def vectors(self, group: Group) -> bool:
        """Return whether the stress of a group is computed by vectorised CPU kernels."""
        return self._vectors and simd.has_stress(group.law)

    def totals(self, group: Group, outputs: list[wp.array]) -> list[wp.Launch | None]:
        """Record the vectorised kernel launches that sum a group's energy and power."""
        constants = [group.start, self._model.dx, group.theta]
        motion, kernel = [self.nodes.u, self.nodes.v], simd.make_totals_simd(group.law)
        spans = [_common(worker.points, group.particles) for worker in self.workers]
        return [
            self._over_blocks(kernel, span, constants, motion, outputs)
            for span in spans
            if span.stop > span.start
        ]

    def kick(self, worker: Worker, tracks: Tracks, *, pushed: bool) -> list[Named]:
        """Return the kernel launches that apply the forces to a worker's nodes.

        `pushed` states whether forces act on points.
        """
        span, v, before, clock = worker.nodes, self.nodes.v, self.nodes.before, tracks.clock
        stress = [span, self._pool, self._donors, clock, tracks.values, v]
        push = [self._push_donors, clock, self.no_pull, v]
        kicks: list[Named] = []
        if self.lasting is not None:
            kicks = self._kick(span, self.lasting, *push, before)
        if not pushed:
            return kicks + self._kick(*stress, self._middle if kicks else before)
        reached, middle = worker.reach.span, self._middle
        if kicks or reached == span:
            kicks += self._kick(reached, self._pushes, *push, middle if kicks else before)
            return kicks + self._kick(*stress, middle)
        # The kick by the stress stores the velocities after the kick by pushes, not before it.
        kicks = self._kick(reached, self._pushes, *push, middle) + self._kick(*stress, before)
        count, kernel = reached.stop - reached.start, node_kernels.make_copy(self._model.real)
        restore = self._model.launch(kernel, count, [reached.start, middle], [before])
        return kicks + launches([("nodes", restore)])

    def _kick(self, span: slice, pool: wp.array, donors: Any, *rest: Any) -> list[Named]:
        inputs = [self.nodes.inverse, pool, self._spans, donors, *rest]
        plain = node_kernels.make_kick(self._model.real)
        return self._over_nodes(span, plain, simd.make_kick_simd, inputs)

    def drift(self, worker: Worker, tracks: Tracks) -> list[Named]:
        """Return the kernel launch that moves a worker's nodes."""
        nodes = self.nodes
        inputs = [self.tied, tracks.clock, nodes.before]
        inputs += [nodes.v, nodes.u, nodes.residue, nodes.lagging]
        plain = node_kernels.make_drift(self._model.real)
        return self._over_nodes(worker.nodes, plain, simd.make_drift_simd, inputs)

    def _over_nodes(
        self, span: slice, plain: Any, make_simd: Callable[[], Any], inputs: list[Any]
    ) -> list[Named]:
        count, kernel = span.stop - span.start, plain
        if self._vectors:
            count, kernel = -(-count // simd.NODES), make_simd()
        launch = self._model.launch(kernel, count, [span.start, span.stop, *inputs], [])
        return launches([("nodes", launch)])

    def _follow(self, worker: Worker) -> list[Named]:
        span, state, nodes, model = worker.points, self._state, self.nodes, self._model
        outputs = [state.x, state.v, state.C, state.F]
        if self._vectors and span.stop > span.start:
            motion, kernel = [self._rest, nodes.u, nodes.v], simd.make_follow_simd()
            launch = self._over_blocks(kernel, span, [model.dx], motion, outputs)
            return launches([("follow", launch)])
        inputs = [span.start, model.dx, self._rows, self._offset, self._rest, nodes.u, nodes.v]
        kernel = point_kernels.make_follow(model.real)
        return launches([("follow", model.launch(kernel, span.stop - span.start, inputs, outputs))])

    def lost(self) -> int:
        """Return the number of points with values that were not finite."""
        return int(self._read_stray()[0])

    def maxima(self) -> list[float]:
        """Return the largest speed, strain rate and closing rate since these maxima were reset."""
        largest: list[float] = self._read_maxima().max(axis=0)[:MAXIMA].tolist()
        return largest

    def take_maxima(self) -> list[float]:
        """Return the largest speed, strain rate and closing rate, and reset these maxima."""
        largest = self.maxima()
        self._maxima.zero_()
        return largest

    def accelerate(self, worker: Worker, pool: wp.array | None, out: wp.array) -> list[Named]:
        """Return the kernel launches that compute accelerations `out` [N,3], m/s^2, of a worker's
        nodes without gravity.

        `pool` contains the forces; None: the forces of the stress in the last substep.
        """
        span, pool = worker.nodes, self._pool if pool is None else pool
        clock = self._model.array([1.0, 1.0, 0.0], self._model.real)  # kick of 1 s from rest
        kick = self._kick(span, pool, self._donors, clock, self.no_pull, out, self._middle)
        return [("clear", cast("wp.array", out[span]).zero_), *kick]

    def _measure(self, worker: Worker) -> list[Named]:
        model, state, nodes, records = self._model, self._state, self.nodes, []
        outputs = [worker.maxima, self.stray]
        for group in model.groups:
            span = _common(worker.points, group.particles)
            if self.vectors(group) and span.stop > span.start:
                motion, kernel = [nodes.u, nodes.v], simd.make_measure_simd()
                launch = self._over_blocks(kernel, span, [model.dx], motion, outputs)
            else:
                inputs = [span.start, state.v, state.C, state.F]
                kernel = make_lattice_measure(model.real)
                launch = model.launch(kernel, span.stop - span.start, inputs, outputs)
            records.append(("measure", launch))
        plain = not all(self.vectors(group) for group in model.groups)
        follows = self._follow(worker) if plain else []
        # The maxima that kernels of viscous stress have measured are kept.
        reset = [] if self.measuring else [("measure", worker.maxima.zero_)]
        return [*follows, *reset, *launches(records)]


def is_viscous(group: Group, model: Model) -> bool:
    """Return whether a group's stress depends on the rate of strain."""
    sections = _sections(group, model)
    return any(np.isfinite(section.viscous_limit(model.dx)) for section in sections)


def _sections(group: Group, model: Model) -> list[Any]:
    return [section for section in model.materials if section.device_law.name == group.law.name]


def _span_of_cells(lattice: RestLattice, first: int, last: int) -> slice:
    rows = lattice.rows[first:last]
    return slice(int(rows.min()), int(rows.max()) + 3) if len(rows) else slice(0, 0)


def _common(a: slice, b: slice) -> slice:
    start = max(a.start, b.start)
    return slice(start, max(start, min(a.stop, b.stop)))
