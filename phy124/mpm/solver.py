"""Solver: explicit MLS-MPM substeps of stable length.

The kernel launches of a substep are recorded once (phy124/mpm/substep.py) and then repeated: by
threads for parts of the particles (phy124/mpm/workers.py), or by a CUDA device without the host
(phy124/mpm/graph.py).
"""

import itertools
import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.measure import COUNT
from phy124.mpm.clock import MEASURE_EVERY, Clock
from phy124.mpm.fluctuation import APIC, Fluctuation, Scheme, usable_rpic
from phy124.mpm.free import FreeBodies, FreeBody, Plane
from phy124.mpm.graph import Graph, usable
from phy124.mpm.grid import Corners, Grid, Unstable, corners_of, fit_all, grids_of
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model, State
from phy124.mpm.outliers import Outliers
from phy124.mpm.pairs import Pair, Pairs
from phy124.mpm.rejection import StepRejection
from phy124.mpm.repair import Repair
from phy124.mpm.runner import Runner
from phy124.mpm.stage import Accumulator, Attachable
from phy124.mpm.substep import Gathered, Recorder
from phy124.mpm.timestep import Maxima
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import (
    FOLLOW,
    GATHER,
    REPAIR,
    SCHEDULE,
    WINDOW,
    Slabs,
    Timings,
    Worker,
    lone_worker,
    run_timed,
    usable_workers,
)

CALM = 0.9
"""Largest growth of stiffness between two measurements, relative to the largest growth with which
substeps are still stable.
"""


class Solver(Kept):
    """Advances a state in time under forces and boundaries."""

    kept = ("state", "clock", "outliers", "repair", "pairs", "free")

    projects: ClassVar[bool] = False
    clock_type: ClassVar[type[Clock]] = Clock
    guest: Any = None
    """A kernel launch of another solver, made between the update of the grids and the walls."""

    def __init__(
        self,
        model: Model,
        state: State | None = None,
        *,
        pairs: Sequence[Pair] = (),
        free: Sequence[FreeBody] = (),
        ceiling: float = math.inf,
        threads: int | None = None,
        graph: bool | None = None,
        measure_every: int = MEASURE_EVERY,
        scheme: Scheme = APIC,
        gathered: Sequence[Gathered] = (),
        **acting: Any,
    ) -> None:
        """Connect forces and boundaries to a model.

        Args:
            model: The constants of the run.
            state: The initial state; None: undeformed and at rest.
            pairs: Pairs of bodies whose contact differs from the default.
            free: Freely moving rigid solids.
            ceiling: Longest substep allowed [s].
            threads: Number of CPU threads; None: chosen from the numbers of free cores and
                particles.
            graph: Whether a frame runs as one graph on the device. None: only on CUDA, if there is
                one body.
            measure_every: Number of substeps between measurements of the limits, used only if it is
                safe.
            scheme: The grid-to-particle transfer scheme.
            gathered: Objects that read each part of the particles after every gather.
            acting: Forces, boundaries, sums and planes, as in `bind`.

        Raises:
            InputError: The region of a force contains no particle, or a boundary is too thin for
                the grid.
            ValueError: The scheme is not stable with the model's substeps.
        """
        self.model = model
        self.state = State.of(model) if state is None else state
        self.fluctuation = Fluctuation.of(model, self.state, scheme) if scheme.passes else None
        self._rpic = usable_rpic(scheme, model.cfl)
        self.clock = self.clock_type(model, ceiling=ceiling, measure_every=measure_every)
        on_device = usable(model.device) if graph is None else graph
        self.on_device = on_device and model.bodies == 1 and not free and not model.held
        """Whether the substeps of a frame run as a CUDA graph."""
        self.grids = grids_of(model, apart=self.on_device)
        self.outliers = Outliers(model, self.state)
        self.repair = Repair(model, self.state)
        count = usable_workers(len(model), model.device, threads)
        self.slabs = Slabs(model, self.state, self.grids, count) if count > 1 else None
        self.workers = self.slabs.workers if self.slabs else [lone_worker(model, self.grids)]
        self.gathered = gathered
        for reader in gathered:
            reader.allocate(model, count)
        self.pairs = Pairs(model, pairs, count)
        self.free = FreeBodies(model, free)
        self._stray = wp.zeros(1, dtype=int, device=model.device)
        self._missed = wp.zeros((count, 1), dtype=int, device=model.device)
        self.flying = False
        """Whether no force acts on the particles, and no wall or other body is near the window."""
        self._moved = False
        """Whether a window has moved since the kernel launches were recorded."""
        self.softened = 1.0
        """Current factor on the initial stiffness of all particles."""
        self.runner = Runner(self.workers)
        self._graph = Graph(model, self.clock, self.grids[0], self.workers[0], self._stray)
        self.bind(**acting)
        self._record_measures()

    def bind(
        self,
        *,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Attachable] = (),
        accumulators: Sequence[Accumulator] = (),
        planes: Sequence[Plane] = (),
    ) -> None:
        """Replace the forces, the boundaries and the sums over particles, from the next substep on.

        Args:
            forces: Forces, in the order in which they act.
            boundaries: Boundaries, in the order in which they act.
            accumulators: Sums that are updated in every substep.
            planes: Flat walls with which free bodies collide.

        Raises:
            InputError: The region of a force contains no particle, or a boundary is too thin for
                the grid; in this case nothing has changed.
        """
        model, state = self.model, self.state
        tracks = Tracks(real=model.real, device=model.device)
        acting, walls, sums = (
            [stage for item in items for stage in item.attach(model, state, tracks)]
            for items in (forces, boundaries, accumulators)
        )
        self.free.bind(planes, tracks)
        tracks.upload(self.clock.values)
        self.tracks, self._forces, self.boundaries, self._sums = tracks, acting, walls, sums
        self._recorder = Recorder(
            model, state, self.grids, tracks, self.outliers, self.workers, self.slabs, self.pairs,
            self.free, self._missed, self.fluctuation, self.gathered, self._rpic, self.guest,
        )  # fmt: skip
        self._sample = tracks.record()
        self._sample.launch()
        undone = [*accumulators, self.pairs, self.free]
        self.rejection = StepRejection(model, state, tracks, acting, undone)
        if any(grid.count for grid in self.grids):
            self._record()

    @property
    def grid(self) -> Grid:
        """The grid of the first body that this solver moves."""
        wet = self.model.wet
        return next(grid for body, grid in enumerate(self.grids) if body not in wet)

    @property
    def nodes(self) -> int:
        """Number of nodes in all windows."""
        return sum(grid.count for grid in self.grids)

    @property
    def timings(self) -> Timings:
        """Seconds and number of kernel launches of each stage of a substep, in the first thread."""
        return self.workers[0].timings

    def start(self) -> None:
        """Do nothing; called once before the first step, after all observers have been bound."""

    def advance(
        self, until: float, *, after: Callable[[], None] | None = None, each: bool = False
    ) -> None:
        """Take substeps of stable length.

        Args:
            until: The time at which to stop [s].
            after: Function that is called after each substep or, with a graph, after several
                substeps.
            each: Whether `after` must be called after each substep, so that no graph is used.

        Raises:
            Unstable: A particle left the grid's window, or a value is not finite.
        """
        started, named = time.perf_counter(), self._seconds()
        self.rejection.begin(self.clock.time, until)
        # The forces and walls of this frame may require more frequent measurements.
        if not self.clock.due:
            self.clock.interval = min(self.clock.interval, self._safe_interval())
        if len(self.workers) > 1:
            # The measurement loads every kernel; loading kernels later is not thread-safe.
            self._measure_if_due()
        with self.runner.on_threads():
            while self.clock.time < until:
                if each or not self._run_graph(until):
                    self._stable_step(until)
                run_timed(self.timings, REPAIR, lambda: self.repair.substep(self.clock))
                if after is not None:
                    run_timed(self.timings, FOLLOW, after)
            run_timed(self.timings, "measure", self._end_frame)
            self._follow_window()
        between = self.timings.setdefault(SCHEDULE, [0.0, 0])
        between[0] += time.perf_counter() - started - (self._seconds() - named)
        between[1] += 1

    def _seconds(self) -> float:
        return sum(seconds for seconds, _ in self.timings.values())

    def step(self, kick: float, drift: float) -> None:
        """Take one substep: advance velocities by `kick` [s], positions and F by `drift` [s]."""
        self._measure_if_due()
        self._scatter(kick, drift)
        self.runner.run(GATHER)
        self.runner.join()
        self.clock.finish(drift)

    def renew(self) -> None:
        """Measure all limits again; call this after the state was changed from outside."""
        self.clock.expire()
        for grid in self.grids:
            grid.stale = True

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot from which `restore` continues bit for bit."""
        return {
            **super().snapshot(),
            "windows": [[grid.low.tolist(), grid.size.tolist()] for grid in self.grids],
            "slabs": self.slabs.snapshot() if self.slabs else {},
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore a snapshot; with an equal number of threads, the run continues bit for bit."""
        super().restore(snapshot)
        self._stray.zero_()
        self._missed.zero_()
        for grid, (low, size) in zip(self.grids, snapshot["windows"], strict=True):
            grid.rebase(np.array(low), np.array(size))
        known = self._restore_slabs(snapshot["slabs"])
        for grid in self.grids:
            grid.stale = self.clock.due or not known
        if not self.grid.stale:
            self._record()

    def _restore_slabs(self, snapshot: dict[str, Any]) -> bool:
        """Restore the workers' nodes; return False if the number of threads differs."""
        if self.slabs is None:
            return True
        known = self.slabs.restore(snapshot)
        self._record_measures()
        if not known:
            self.clock.expire()
        return known

    def _stable_step(self, until: float) -> None:
        """Take one stable substep, whose length divides the remaining time evenly."""
        self._measure_if_due()
        clock = self.clock
        limit = clock.stable()
        rest = until - clock.time
        dt = rest / max(1, math.ceil(rest / limit.dt - 1e-9))
        if self.rejection.must_try(clock, dt, flying=self.flying and not self.outliers.bounded):
            dt = self._careful_step(dt)
        else:
            self.step((clock.last_dt + dt) / 2, dt)
        if dt == rest:
            clock.time = until
        clock.last_dt = dt
        clock.count(limit.limiter, needed=dt / limit.dt)

    def _careful_step(self, dt: float) -> float:
        """Take a substep of at most `dt` [s] in which no node crosses a cell; return its length."""

        def scatter(dt: float) -> None:
            if self.grid.apart:
                # After a rejected trial, no gather has cleared the scattered momenta.
                self.grid.momenta.zero_()
            self._scatter((self.clock.last_dt + dt) / 2, dt)
            self.runner.join()

        dt, violent = self.rejection.attempt(dt, scatter, self.grids)
        self.runner.run(GATHER)
        self.runner.join()
        self.clock.finish(dt, violent=violent)
        return dt

    def _scatter(self, kick: float, drift: float) -> None:
        """Run all phases of a substep except the gather."""
        self.clock.begin(kick, drift)
        if self.tracks.vary:
            run_timed(self.timings, "tracks", self._sample.launch)
        for phase in range(len(self.workers[0].phases) - 1):
            self.runner.run(phase)

    def _run_graph(self, until: float) -> bool:
        """Take substeps on the device; return False if the host must take the next substep."""
        alone = self.on_device and len(self.workers) == 1
        if not alone or self.rejection.sudden(self.clock):
            return False
        self._measure_if_due()
        apart = self.outliers.bounded
        return self._graph.run(until, self.rejection, self._launches, apart=apart)

    def _launches(self) -> Iterable[Callable[[], Any]]:
        if self.tracks.vary:
            yield self._sample.launch
        for _, launch in itertools.chain(*self.workers[0].phases):
            yield launch

    def _measure_if_due(self) -> None:
        if self.clock.due:
            run_timed(self.timings, "measure", self._measure_due)
            self._follow_window()

    def _measure_due(self) -> None:
        """Measure the speeds, and the other limits if they may have changed; may raise Unstable."""
        clock = self.clock
        calm = self._calm_strain()
        if self.on_device or self.outliers.bounded or clock.complete(calm):
            self._measure()
            return
        self._each_worker(Worker.glance)
        rows = [worker.speeds.numpy() for worker in self.workers]
        speed, gradient = np.max(rows, axis=0).tolist()
        speed = max(speed, self.free.fastest())
        extremes = clock.extremes._replace(speed=speed, gradient=gradient)
        clock.limit_by(extremes, complete=False, acceleration=self.rejection.acceleration)
        room = self.rejection.room(clock)
        if clock.complete(calm) or room < MEASURE_EVERY:
            self._measure()
        else:
            interval = self.rejection.interval(clock, max(calm - clock.strain, 1e-9))
            clock.interval = min(interval, room)

    def _calm_strain(self) -> float:
        """Return the strain up to which the substep remains stable although materials stiffen."""
        growth = max(CALM / self.clock.cfl**2, 1.05)
        stiffness = self.clock.extremes.stiffness / (self.model.least_stiffness * self.softened)
        return min(m.calm_strain(growth, stiffness) for m in self.model.materials)

    def _measure(self) -> None:
        """Measure the stability limits and fit the windows to the particles; may raise Unstable."""
        corners = self._corners(rows := self._maxima())
        if self.outliers.confine(corners):
            corners = self._corners(rows := self._maxima())
        measured = Maxima.of(rows.max(axis=0))
        clock = self.clock
        fastest, passed = self.free.fastest(), clock.since_complete
        extremes = measured.extremes.after(clock.extremes, fastest, substeps=passed)
        clock.limit_by(extremes, complete=True)
        changed = fit_all(self.grids, corners, returned=self.outliers.changed)
        changed |= self._fit_slabs(rows, changed)
        self._moved |= changed
        clock.interval = self._safe_interval()

    def _end_frame(self) -> None:
        """Check that every particle is still inside its window, or raise Unstable."""
        if self.clock.since_measured == 0:
            return
        if self.outliers.bounded or self._missed.numpy().any():
            self._measure()
        elif self.clock.due:
            self._measure_due()

    def _corners(self, rows: NDArray[np.float64]) -> list[Corners]:
        parts = self.slabs.parts if self.slabs else ()
        bodies = [part.group.body for part in parts] or range(len(rows))
        return corners_of(rows, bodies, len(self.grids))

    def _fit_slabs(self, rows: NDArray[np.float64], force: bool) -> bool:
        """Fit each worker's nodes (slabs) to the particles; return whether the slabs changed."""
        slabs = self.slabs
        if slabs is None or not slabs.fit(rows, force=force):
            return False
        if slabs.outgrown:
            slabs.divide_again(*Maxima.of(rows.max(axis=0)).corners)
            self._record_measures()
            slabs.fit(self._maxima(), force=True)
        return True

    def _record_measures(self) -> None:
        for worker in self.workers:
            worker.measures = self._recorder.measures(worker, self._stray)
            worker.glances = self._recorder.speeds(worker, self._stray)

    def _maxima(self) -> NDArray[np.float64]:
        """Return a row of measured maxima for each part of each worker, or for each body.

        Raises:
            Unstable: A value of a particle is not finite.
        """
        self._each_worker(Worker.measure)
        rows = [part.maxima for part in self.slabs.parts] if self.slabs else []
        rows = rows or [self.workers[0].maxima]
        return np.array([row.numpy() for row in rows], dtype=np.float64).reshape(-1, COUNT)

    def _each_worker(self, measure: Callable[[Worker], None]) -> None:
        """Let all workers measure their particles; raise Unstable if a value is not finite."""
        workers = self.workers

        def task(member: int) -> None:
            if member == 0:  # The callers add this time to the stage of the calling thread.
                measure(workers[0])
            else:
                run_timed(workers[member].timings, "measure", lambda: measure(workers[member]))

        self.runner.team.complete(task)
        lost = int(self._stray.numpy()[0])
        if lost:
            raise Unstable(f"{lost} particles are NaN or infinite")

    def _safe_interval(self) -> int:
        interval = min(self.clock.measure_every, MEASURE_EVERY)
        if not self.on_device:
            interval = self.rejection.interval(self.clock, self._calm_strain())
        return max(1, min(interval, self.rejection.room(self.clock)))

    def _follow_window(self) -> None:
        if self._moved:
            run_timed(self.timings, WINDOW, self._record)

    def _record(self) -> None:
        self._moved = False
        self._recorder.record(self._forces, self.boundaries, self._sums)
        walls = {stage.name for stage in self.boundaries} - {stage.name for stage in self._sums}
        phases = itertools.chain(*(worker.phases for worker in self.workers))
        meets = any(name in walls for name, _ in itertools.chain(*phases))
        alone = not self._forces and not self.free.all and not self.pairs.touching(self.grids)
        self.flying = alone and not meets
        self._graph.forget()
