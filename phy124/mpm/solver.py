"""Solver: explicit MLS-MPM substeps of stable length.

The launches of a substep are recorded (phy124/mpm/substep.py) and repeated by one thread, by two
threads with half of the particles each (phy124/mpm/workers.py), or by a CUDA device alone
(phy124/mpm/graph.py).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.mpm.clock import MEASURE_EVERY, Clock
from phy124.mpm.graph import Graph, usable
from phy124.mpm.grid import Grid, Unstable
from phy124.mpm.maxima import Maxima
from phy124.mpm.model import Model
from phy124.mpm.outliers import Outliers
from phy124.mpm.rejection import StepRejection
from phy124.mpm.repair import Repair
from phy124.mpm.stage import Accumulator, Attachable, Named
from phy124.mpm.state import State
from phy124.mpm.substep import Recorder
from phy124.mpm.threads import SecondThread
from phy124.mpm.workers import (
    GATHER,
    SCATTER,
    UPDATE,
    Timings,
    Worker,
    fit_part,
    make_workers,
    timed,
    usable_workers,
)
from phy124.tracks import Tracks

MEASURE = 3
"""Given instead of a phase to measure the limits."""


class Solver:
    """Advances a state in time under forces and boundaries; puts the phases in order."""

    def __init__(
        self,
        model: Model,
        state: State | None = None,
        *,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Attachable] = (),
        accumulators: Sequence[Accumulator] = (),
        ceiling: float = math.inf,
        threads: int | None = None,
        graph: bool | None = None,
        measure_every: int = MEASURE_EVERY,
    ) -> None:
        """Bind forces and boundaries to a model.

        Args:
            model: What never changes.
            state: The initial state; None: undeformed and at rest.
            forces: Forces, in the order in which they act.
            boundaries: Boundaries, in the order in which they act.
            accumulators: Sums that grow in every substep.
            ceiling: Longest substep allowed [s].
            threads: CPU threads, 1 or 2; None: two if that is faster and a core is free.
            graph: Run frames as one graph on the device; None: on CUDA.
            measure_every: Substeps between two measurements of the limits, where that is safe.

        Raises:
            InputError: The region of a force holds no particle, or a boundary is too thin for the
                grid.
        """
        self.model = model
        self.state = State.of(model) if state is None else state
        self.clock = Clock(model, ceiling=ceiling, measure_every=measure_every)
        self.grid = Grid(model.origin, model.dx, real=model.real, device=model.device)
        self.tracks = Tracks(real=model.real, device=model.device)
        self._forces, self.boundaries, self._sums = (
            [stage for one in some for stage in one.attach(model, self.state, self.tracks)]
            for some in (forces, boundaries, accumulators)
        )
        self.tracks.upload(self.clock.values)
        self.outliers = Outliers(model, self.state)
        self.repair = Repair(model, self.state)
        count = usable_workers(model) if threads is None else threads
        self.workers = make_workers(model, self.grid, count)
        self._recorder = Recorder(
            model, self.state, self.grid, self.tracks, self.outliers, self.workers
        )
        self._stray = wp.zeros(1, dtype=int, device=model.device)
        for worker in self.workers:
            worker.measures = self._recorder.measures(worker, self._stray)
        self._sample = self.tracks.record()
        self._sample.launch()
        self._pushes: list[Named] = []
        self._second = SecondThread[int](self._run_second)
        self.rejection = StepRejection(model, self.state, self.tracks, self._forces, accumulators)
        self._graph = Graph(model, self.clock, self.grid, self.workers[0], self._stray)
        self.on_device = usable(model.device) if graph is None else graph
        """Whether frames run as graphs."""

    @property
    def timings(self) -> Timings:
        """Seconds and launches of each stage, in the first thread."""
        return self.workers[0].timings

    def advance(self, until: float, *, after: Callable[[], None] | None = None) -> None:
        """Take substeps of stable length.

        Args:
            until: The time at which to stop [s].
            after: Called after each substep.

        Raises:
            Unstable: A particle left the grid's window or is no longer finite.
        """
        with self._second_thread():
            while self.clock.time < until:
                if not self._run_graph(until):
                    self._stable_step(until)
                self.repair.substep(self.clock)
                if after is not None:
                    after()
            timed(self.timings, "measure", self._measure)

    def step(self, kick: float, drift: float) -> None:
        """One substep: velocities change over `kick` s, positions and F over `drift` s."""
        self._measure_if_due()
        self._scatter(kick, drift)
        self._run(GATHER)
        self._join()
        self.clock.finish(drift)

    def snapshot(self) -> dict[str, Any]:
        """The state that `restore` needs to continue bit for bit."""
        return {
            "state": self.state.snapshot(),
            "clock": self.clock.snapshot(),
            "outliers": self.outliers.snapshot(),
            "repair": self.repair.snapshot(),
            "windows": [[g.low.tolist(), g.size.tolist()] for g in self._grids()],
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self.state.restore(snapshot["state"])
        self.clock.restore(snapshot["clock"])
        self._set_interval()
        self.outliers.restore(snapshot["outliers"])
        self.repair.restore(snapshot["repair"])
        self._stray.zero_()
        for grid, (low, size) in zip(self._grids(), snapshot["windows"], strict=True):
            grid.rebase(np.array(low), np.array(size))
        self.grid.stale = self.clock.due
        if not self.grid.stale:
            self._record()

    def _stable_step(self, until: float) -> None:
        """One substep: of a stable length that divides the remaining time evenly."""
        self._measure_if_due()
        clock, limit = self.clock, self.clock.stable()
        rest = until - clock.time
        dt = rest / max(1, math.ceil(rest / limit.dt - 1e-9))
        if self.rejection.must_try(clock, dt):
            dt = self._careful_step(dt)
        else:
            self.step((clock.last_dt + dt) / 2, dt)
        if dt == rest:
            clock.time = until
        clock.last_dt = dt
        clock.count(limit.limiter)

    def _careful_step(self, dt: float) -> float:
        """A substep of at most `dt` in which no node moves more than a cell; returns its length."""

        def scatter(dt: float) -> None:
            self._scatter((self.clock.last_dt + dt) / 2, dt)
            self._join()

        dt, violent = self.rejection.attempt(dt, scatter, self.grid)
        self._run(GATHER)
        self._join()
        self.clock.finish(dt, violent=violent)
        return dt

    def _scatter(self, kick: float, drift: float) -> None:
        """All but the gather: clock, tracks, forces on particles, scatter, grid update, walls."""
        self.clock.begin(kick, drift)
        if self.tracks.vary:
            timed(self.timings, "tracks", self._sample.launch)
        for name, launch in self._pushes:
            timed(self.timings, name, launch)
        self._run(SCATTER)
        self._run(UPDATE)

    def _run(self, phase: int) -> None:
        """Run a phase; two threads wait for each other before it."""
        if self._second.alive:
            timed(self.timings, "wait", lambda: self._second.put(phase))
            self.workers[0].run(phase)
        else:
            for worker in self.workers:
                worker.run(phase)

    def _join(self) -> None:
        """Wait until the second thread has finished its part."""
        if self._second.alive:
            timed(self.timings, "wait", self._second.join)

    def _run_second(self, phase: int) -> None:
        """Run a phase in the second thread."""
        worker = self.workers[1]
        if phase == MEASURE:
            timed(worker.timings, "measure", worker.measure)
        else:
            worker.run(phase)

    @contextmanager
    def _second_thread(self) -> Iterator[None]:
        """Within this context, the second worker runs on a thread of its own."""
        if len(self.workers) == 1:
            yield
            return
        # This loads every kernel.
        self._measure_if_due()
        with self._second.running():
            yield

    def _run_graph(self, until: float) -> bool:
        """Take substeps on the device alone; False if the host has to take the next one."""
        alone = self.on_device and len(self.workers) == 1 and not self.outliers.bounded
        if not alone or self.rejection.sudden(self.clock):
            return False
        self._measure_if_due()
        return self._graph.run(until, self.rejection, self._launches)

    def _launches(self) -> Iterable[Callable[[], Any]]:
        """The launches of one substep of a single worker, in order."""
        if self.tracks.vary:
            yield self._sample.launch
        for _, launch in itertools.chain(self._pushes, *self.workers[0].phases):
            yield launch

    def _measure_if_due(self) -> None:
        if self.clock.due:
            timed(self.timings, "measure", self._measure)

    def _measure(self) -> None:
        """Read the stability limits and fit the windows to the particles; raises Unstable."""
        found = self._maxima()
        if self.outliers.confine(*Maxima.of(found.max(axis=0)).corners):
            found = self._maxima()
        overall = found.max(axis=0)
        measured = Maxima.of(overall)
        self.clock.extremes = measured.extremes.after(self.clock.extremes)
        # A particle that has come back to the others may be outside the window.
        self.grid.stale |= self.outliers.changed
        changed = self.grid.fit(*measured.corners)
        for worker, own in zip(self.workers, found, strict=True):
            changed |= self._fit(worker, np.where(np.isfinite(own), own, overall), changed)
        if changed:
            self._record()
        self._set_interval()
        self.clock.since_measured = 0

    def _fit(self, worker: Worker, own: NDArray[np.float64], force: bool) -> bool:
        """Fit a worker's private nodes to its particles; returns whether they changed."""
        if worker.nodes is self.grid:
            return False
        return fit_part(worker.nodes, self.grid, *Maxima.of(own).corners, force=force)

    def _maxima(self) -> NDArray[np.float64]:
        """What each worker measures, one row each [W,9]; raises Unstable."""
        if self._second.alive:
            self._second.put(MEASURE)
            self.workers[0].measure()
            self._second.join()
        else:
            for worker in self.workers:
                worker.measure()
        lost = int(self._stray.numpy()[0])
        if lost:
            raise Unstable(f"{lost} particles are NaN or infinite")
        return np.array([worker.maxima.numpy() for worker in self.workers], dtype=np.float64)

    def _set_interval(self) -> None:
        clock = self.clock
        usual = min(clock.measure_every, MEASURE_EVERY)
        clock.interval = usual if self.on_device else self.rejection.interval(clock)

    def _record(self) -> None:
        """Record the launches of one substep, in order."""
        self._pushes = self._recorder.pushes(self._forces)
        self._recorder.record(self.boundaries, self._sums)
        self._graph.forget()

    def _grids(self) -> list[Grid]:
        """The shared grid, and the private grids of workers that have one."""
        private = [worker.nodes for worker in self.workers if worker.nodes is not self.grid]
        return [self.grid, *private]
