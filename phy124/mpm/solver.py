"""Solver: explicit MLS-MPM substeps of stable length.

What a substep does is recorded (phy124/mpm/substep.py) and repeated by one thread, by two that
have half of the particles each (phy124/mpm/workers.py), or by a CUDA device alone
(phy124/mpm/graph.py).
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.transfer import types
from phy124.materials import Material
from phy124.mpm import workers as company
from phy124.mpm.graph import Graph, usable
from phy124.mpm.grid import Grid, Unstable
from phy124.mpm.outliers import Outliers
from phy124.mpm.rejection import CHECK_EVERY, StepRejection
from phy124.mpm.state import Group, State, parameters
from phy124.mpm.substep import record_looks, record_phases, record_pushes
from phy124.mpm.timestep import CFL, Extremes, Substep, beside_elastic, stable_substep
from phy124.mpm.workers import Barrier, Named, Timings, Worker, cut, timed
from phy124.tracks import Tracks

Stage = tuple[str, Callable[[], wp.Launch | None]]
"""Name of a stage and how to record its launch for the grid window of the moment."""
CLOCK = ("time", "last_dt", "substeps", "since_check", "extremes")
"""Numbers that a snapshot holds beside the state."""
MEASURE = 3
"""Instead of a phase: the limits are measured."""
PRECISIONS = {"float32": wp.float32, "float64": wp.float64}


class Attachable(Protocol):
    """A force or a boundary: adds its stages to a solver."""

    def attach(self, solver: Solver) -> list[Stage]:
        """The stages it needs in each substep."""
        ...


class Solver:
    """Steps particles of given materials under forces and boundaries.

    `x [P,3]` m, `volume [P]` m^3, `material [P]` non-decreasing indices into `materials`,
    `stiffness [P]` shares of their E, `dx` the grid spacing [m]; `v [P,3]` m/s and `C [P,3,3]` 1/s
    are the motion at the start.
    """

    def __init__(
        self,
        x: NDArray,
        volume: NDArray,
        materials: Sequence[Material],
        *,
        dx: float,
        material: NDArray | None = None,
        stiffness: NDArray | None = None,
        v: NDArray | None = None,
        C: NDArray | None = None,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Attachable] = (),
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        precision: str = "float32",
        device: str = "cpu",
        cfl: float = CFL,
        ceiling: float = math.inf,
        simd: bool | None = None,
        threads: int | None = None,
        graph: bool | None = None,
        check_every: int = CHECK_EVERY,
    ) -> None:
        self.real, self.device, self.dx = PRECISIONS[precision], device, float(dx)
        self.cfl, self.ceiling, self.check_every = cfl, ceiling, check_every
        slowest = min(section.viscous_limit(self.dx) for section in materials)
        self.viscous = beside_elastic(cfl) * slowest
        cpu_float = device == "cpu" and precision == "float32"
        rows = cpu_float if simd is None else simd and cpu_float
        self.form = "simd" if rows else "plain"
        self.rest = np.asarray(x, dtype=np.float64)
        self.materials = tuple(materials)
        material = np.zeros(len(x), int) if material is None else material
        self._build_model(volume, material, stiffness)
        self._build_state(v, C)
        self.grid = Grid(origin, self.dx, real=self.real, device=device)
        self.clock = wp.zeros(3, dtype=self.real, device=device)
        self.stray = wp.zeros(1, dtype=int, device=device)
        self.tracks = Tracks(real=self.real, device=device)
        self.pushes = [stage for force in forces for stage in force.attach(self)]
        self.collisions = [stage for wall in boundaries for stage in wall.attach(self)]
        self.closings: list[Stage] = []
        """What ends a substep, once the walls have acted; for books."""
        self.tracks.upload(self.clock)
        self.time, self.substeps, self.last_dt = 0.0, 0, 0.0
        self.limiters: dict[str, int] = {}
        self.threads = self._thread_count(threads)
        self.outliers = Outliers(self)
        self.workers = self._build_lanes()
        self.timings: Timings = self.workers[0].timings
        self._tracks_launch = self.tracks.record()
        self._tracks_launch.launch()
        self._pushes: list[Named] = []
        self._meeting: Barrier | None = None
        self._agenda: list[int | None] = []
        self._fault: Exception | None = None
        self.between = self.since_check = min(check_every, CHECK_EVERY)
        self.extremes = Extremes(0.0, 0.0, 0.0)
        self.rejection = StepRejection(self)
        self.graph = Graph(self, every=self.between)
        self.alone = usable(device) if graph is None else graph

    def _build_model(self, volume: NDArray, material: NDArray, share: NDArray | None) -> None:
        laws = [section.device_law.name for section in self.materials]
        law = np.array([laws.index(name) for name in laws])[material]
        if np.any(np.diff(law) < 0):
            raise ValueError("particles must be sorted by law")
        if not np.all(np.asarray(volume) > 0):
            raise ValueError("every particle needs a volume above zero")
        density = np.array([section.density for section in self.materials])[material]
        self.volume = self.array(volume, self.real)
        self.mass = self.array(np.asarray(volume) * density, self.real)
        self.history = np.array([section.history() for section in self.materials])[material]
        self.groups = []
        for index in np.unique(law):
            start, stop = np.searchsorted(law, [index, index + 1]).tolist()
            part = slice(start, stop)
            own = None if share is None else share[part]
            theta = parameters(self.materials, material[part], own, dx=self.dx, cfl=self.cfl)
            kind = self.materials[material[start]].device_law
            width = wp.types.vector(kind.width, self.real)
            self.groups.append(Group(kind, start, stop, self.array(theta, width)))

    def _build_state(self, v: NDArray | None, C: NDArray | None) -> None:
        t, count = types(self.real), len(self.rest)
        plastic = any(group.law.project is not None for group in self.groups)
        kept = count if plastic else 0
        identity = np.tile(np.eye(3), (count, 1, 1))
        self.state = State(
            x=self.array(self.rest, t.vec3),
            residue=self.array(np.zeros((count, 3)), t.vec3),
            v=self.array(np.zeros((count, 3)) if v is None else v, t.vec3),
            C=self.array(np.zeros((count, 3, 3)) if C is None else C, t.mat33),
            F=self.array(identity, t.mat33),
            history=self.array(self.history[:kept], t.vec2),
            total=self.array(identity[:kept], t.mat33),
        )

    def array(self, values: object, dtype: Any) -> wp.array:
        """Values on the device in the solver's precision."""
        scalar = np.float32 if self.real is wp.float32 else np.float64
        return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype, device=self.device)

    def record(self, kernel: Any, dim: Any, inputs: list, outputs: list) -> wp.Launch | None:
        """A launch to be repeated, on the solver's device; None if it has nothing to do."""
        launch = wp.launch(
            kernel, dim, inputs=inputs, outputs=outputs, device=self.device, record_cmd=True
        )
        return cast("wp.Launch | None", launch)

    def _thread_count(self, wanted: int | None) -> int:
        if self.device != "cpu":
            return 1
        return company.usable_threads(len(self.rest)) if wanted is None else wanted

    def _build_lanes(self) -> list[Worker]:
        """One worker that scatters to the shared grid, or two with nodes of their own."""
        runs = cut([(group.start, group.stop) for group in self.groups], self.threads)
        workers = []
        for part in runs:
            nodes = self.grid
            if self.threads > 1:
                nodes = Grid(self.grid.origin.tolist(), self.dx, real=self.real, device=self.device)
            maxima = wp.zeros(9, dtype=self.real, device=self.device)
            workers.append(Worker(part, nodes, maxima))
            workers[-1].looks = record_looks(self, workers[-1])
        return workers

    def _measure(self) -> None:
        """Read the stability limits and make the windows fit; raises Unstable."""
        maxima = self._maxima()
        greatest = maxima.max(axis=0)
        if self.outliers.confine(-greatest[3:6], greatest[6:9]):
            maxima = self._maxima()
            greatest = maxima.max(axis=0)
        self.extremes = Extremes(*greatest[:3].tolist()).after(self.extremes)
        # A particle that comes back to the domain may be beyond the window.
        self.grid.stale |= self.outliers.changed
        changed = self.grid.fit(-greatest[3:6], greatest[6:9])
        for worker, own in zip(self.workers, maxima, strict=True):
            if worker.nodes is not self.grid:
                own = np.where(np.isfinite(own), own, greatest)
                changed |= company.fit_part(
                    worker.nodes, self.grid, -own[3:6], own[6:9], force=changed
                )
        if changed:
            self._record_substep()
        self.between, self.since_check = self.rejection.pause(self.check_every), 0

    def _maxima(self) -> NDArray[np.float64]:
        """What limits each worker [L,9]; raises Unstable."""
        if self._meeting:
            self._agree(MEASURE)
        for worker in self.workers[: 1 if self._meeting else None]:
            self.measure_lane(worker)
        if self._meeting:
            self._agree(None)
        lost = int(self.stray.numpy()[0])
        if lost:
            raise Unstable(f"{lost} particles are no longer numbers")
        return np.array([worker.maxima.numpy() for worker in self.workers], dtype=np.float64)

    def measure_lane(self, worker: Worker) -> None:
        """Find what limits the substep among a worker's particles, and where they are."""
        worker.maxima.fill_(-np.inf)
        for launch in worker.looks:
            launch.launch()

    def _record_substep(self) -> None:
        """Record the launches of one substep, in order."""
        self._pushes = record_pushes(self)
        record_phases(self)
        self.graph.forget()

    def step(self, kick: float, drift: float) -> None:
        """One substep: velocities change over `kick` s, positions and F over `drift` s."""
        if self.since_check >= self.between:
            timed(self.timings, "measure", self._measure)
        self.begin(kick, drift)
        self.work(range(3))
        self.finish(drift)

    def work(self, phases: Iterable[int]) -> None:
        """Phases of a substep: scatter 0, update 1, gather 2; by both threads if there are two."""
        for phase in phases:
            self._meet(phase)
            for worker in self.workers[: 1 if self._meeting else None]:
                worker.run(phase)
        self._meet(None)

    def begin(self, kick: float, drift: float) -> None:
        """What comes before the scatter: the clock, the tracks, forces on particles."""
        self._set_clock(kick, drift)
        if self.tracks.vary:
            timed(self.timings, "tracks", self._tracks_launch.launch)
        for name, launch in self._pushes:
            timed(self.timings, name, launch)

    def finish(self, drift: float, *, violent: bool = False) -> None:
        """Count a substep that was taken; after a violent one the limits are measured anew."""
        self.time += drift
        self.substeps += 1
        self.since_check += self.between if violent else 1

    def _meet(self, phase: int | None) -> None:
        """Wait for the other thread, which then works on a phase, or waits again for None."""
        if self._meeting:
            timed(self.timings, "wait", lambda: self._agree(phase))

    def _agree(self, phase: int | None) -> None:
        """Meet the other thread and tell it what is next."""
        # A list, since the other thread may read late what is agreed on here.
        self._agenda.append(phase)
        if self._meeting:
            self._meeting.wait(0)
        fault, self._fault = self._fault, None
        if fault:
            raise fault

    @contextmanager
    def _company(self) -> Iterator[None]:
        """While inside, the second worker runs on a thread of its own."""
        if len(self.workers) == 1:
            yield
            return
        # Kernels must be loaded before two threads use them: loading is not safe in Warp.
        if self.since_check >= self.between:
            timed(self.timings, "measure", self._measure)
        # A fault may be left of the last time: nobody asks for one after another was raised.
        self._meeting, self._agenda, self._fault = Barrier(2), [], None
        follow, args = self._follow, (self.workers[1], self._meeting)
        helper = threading.Thread(target=follow, args=args, daemon=True)
        helper.start()
        try:
            yield
        finally:
            # Wherever the first thread was, Ctrl-C may have ended it between two meetings.
            self._meeting.over = True
            helper.join()
            self._meeting = None

    def _follow(self, worker: Worker, meeting: Barrier) -> None:
        """The second thread: phases as they come, until there are no more meetings."""
        for meetings in itertools.count():
            if not meeting.wait(1):
                return
            phase = self._agenda[meetings]
            try:
                if phase == MEASURE:
                    timed(worker.timings, "measure", lambda: self.measure_lane(worker))
                elif phase is not None:
                    worker.run(phase)
            except Exception as fault:  # The first thread waits here, and raises it.
                self._fault = fault

    def advance(self, until: float, *, after: Callable[[], None] | None = None) -> None:
        """Substeps of stable length up to a time [s]; `after` is called after each.

        Raises Unstable if a particle leaves the grid window or stops being a number.
        """
        with self._company():
            while self.time < until:
                if not self._run_graph(until):
                    self._stable_step(until)
                if after is not None:
                    after()
            timed(self.timings, "measure", self._measure)

    def launches(self) -> Iterator[Callable[[], Any]]:
        """What one substep of a single worker launches, in order."""
        if self.tracks.vary:
            yield self._tracks_launch.launch
        for _, launch in itertools.chain(self._pushes, *self.workers[0].phases):
            yield launch

    def _run_graph(self, until: float) -> bool:
        """Substeps by the device alone; False if the next is for the host."""
        if not (self.alone and self.graph.fits):
            return False
        if self.since_check >= self.between:
            timed(self.timings, "measure", self._measure)
        return self.graph.run(until)

    def _stable_step(self, until: float) -> None:
        """One substep, as long as is stable and divides the rest evenly."""
        if self.since_check >= self.between:
            timed(self.timings, "measure", self._measure)
        limit = self.substep()
        rest = until - self.time
        dt = rest / max(1, math.ceil(rest / limit.dt - 1e-9))
        if self.rejection.called_for(dt):
            dt = self.rejection.step(dt)
        else:
            self.step((self.last_dt + dt) / 2, dt)
        if dt == rest:
            self.time = until
        self.last_dt = dt
        self.limiters[limit.limiter] = self.limiters.get(limit.limiter, 0) + 1

    def snapshot(self) -> dict[str, Any]:
        """All that `restore` needs to go on from here bit for bit."""
        return {"state": self.state.copy(), "memory": self.memory()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to a snapshot."""
        self.state.restore(snapshot["state"])
        self.recall(snapshot["memory"])

    def memory(self) -> dict[str, Any]:
        """What `recall` needs beside the state, as plain data."""
        return {
            **{name: getattr(self, name) for name in CLOCK},
            "limiters": dict(self.limiters),
            "domain": self.outliers.memory(),
            "windows": [(g.low.tolist(), g.size.tolist()) for g in company.grids(self)],
        }

    def recall(self, memory: dict[str, Any]) -> None:
        """Go on as when `memory` was taken, once the state is as it was then."""
        for name in CLOCK:
            setattr(self, name, memory[name])
        self.extremes = Extremes(*memory["extremes"])
        self.between = self.rejection.pause(self.check_every)
        self.limiters = dict(memory["limiters"])
        self.outliers.recall(memory["domain"])
        self.stray.zero_()
        for grid, (low, size) in zip(company.grids(self), memory["windows"], strict=True):
            grid.rebase(np.array(low), np.array(size))
        self.grid.stale = self.since_check >= self.between
        if not self.grid.stale:
            self._record_substep()

    def substep(self) -> Substep:
        """The longest stable substep at the present state."""
        limits = {"cfl": self.cfl, "ceiling": self.ceiling, "viscous": self.viscous}
        return stable_substep(self.extremes, self.dx, **limits)

    def _set_clock(self, kick: float, drift: float) -> None:
        values = (kick, drift, self.time)
        if self.device == "cpu":
            self.clock.numpy()[:] = values
        else:
            self.clock.assign(np.array(values))
