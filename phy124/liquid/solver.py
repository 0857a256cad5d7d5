"""Solver of a liquid, with the interface of `phy124.mpm.Solver`. All particles are liquid."""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.liquid.bodies import Advance, Bodies
from phy124.liquid.cells import MOST_CELLS, Cells, needed_cells, restrict
from phy124.liquid.clock import LiquidClock
from phy124.liquid.energies import Energies
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.phases import Phases
from phy124.liquid.projection import Projection
from phy124.liquid.walls import Walls, walls_of, walls_of_bodies, walls_of_solids
from phy124.mpm import Accumulator, Attachable, FreeBodies, FreeBody, Grid, Model, State, Unstable
from phy124.mpm.free import Plane
from phy124.mpm.grid import grids_of
from phy124.mpm.kept import Kept
from phy124.mpm.outliers import Outliers
from phy124.mpm.pairs import Pairs
from phy124.mpm.rejection import StepRejection
from phy124.mpm.repair import Repair
from phy124.mpm.runner import Runner
from phy124.mpm.stage import launches
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import (
    FOLLOW,
    REPAIR,
    SCHEDULE,
    WINDOW,
    Timings,
    Worker,
    numbers,
    run_timed,
    usable_workers,
)

TOLERANCE, LOOSE = 1e-4, 1e-2
"""Largest residual of the pressure equation and of the density equation, relative to the largest
right-hand side.
"""
CROWDING = 0.4
"""Largest increase per second of the excess of density that counts as a lack of space [1/s]."""
SETTLE = 4
"""Number of times that the density is corrected before the first step."""


class LiquidSolver(Kept):
    """Advances a liquid in time under forces and walls."""

    kept = (
        "state",
        "clock",
        "outliers",
        "repair",
        "pairs",
        "free",
        "_bodies",
        "cells",
        "impulses",
        "kick",
        "crowding",
        "_excess",
        "lasting",
        "_lasts",
    )

    projects: ClassVar[bool] = True
    """Whether the solver makes a liquid incompressible by pressure projection."""

    def __init__(
        self,
        model: Model,
        state: State | None = None,
        *,
        free: Sequence[FreeBody] = (),
        ceiling: float = math.inf,
        threads: int | None = None,
        bodies: Bodies | None = None,
        advance_bodies: Advance | None = None,
        whole: Model | None = None,
        **acting: Any,
    ) -> None:
        """Connect forces and walls to the particles.

        Args:
            model: The constants of the run.
            state: The initial state; None: at rest.
            free: At most one freely moving rigid solid.
            ceiling: Longest step allowed [s].
            threads: Number of CPU threads; None: the fastest number.
            bodies: Bodies of other materials.
            advance_bodies: Function that moves the bodies up to a time [s].
            whole: All particles of the run; walls are placed relative to these particles. None:
                `model`.
            acting: Forces, boundaries, sums and planes, as in `bind`.

        Raises:
            InputError: A force's region contains no particle, or a wall is too thin.
        """
        self.model, self._whole = model, whole or model
        self.state = State.of(model) if state is None else state
        self.clock = LiquidClock(model, ceiling=ceiling)
        self.grids = grids_of(model)
        """Grids without nodes, because forces and reports expect a grid for each body."""
        count = usable_workers(len(model), model.device, threads)
        self.workers = [Worker(numbers(0, model), numbers(0, model)) for _ in range(count)]
        self.slabs, self.softened = None, 1.0
        self.outliers, self.repair = Outliers(model, self.state), Repair(model, self.state)
        self.pairs, self.free = Pairs(model, (), count), FreeBodies(model, free)
        self._missed = wp.zeros((count, 1), dtype=int, device=model.device)
        self.cells = Cells(model, count)
        self._bodies, self._advance_bodies = bodies, advance_bodies
        self.within: Timings = {}
        """Timings of the bodies' substeps, which are a part of the liquid's steps."""
        self.bounds: StepRejection | None = None
        """Bounds of the forces on the bodies."""
        solids = len(free) + (len(bodies.numbers) if bodies else 0)
        self.projection = Projection(model, count, solids)
        wet = sorted(self._whole.wet) or range(self._whole.bodies)
        runs = [self._whole.particles(body) for body in wet]
        self.wet, first = tuple(wet), runs[0].start
        """Indices of the liquids among all bodies of the run."""
        self._phases = Phases(
            model,
            self.state,
            self.cells,
            self.projection,
            self.workers,
            self._missed,
            self.free,
            bodies,
            [slice(run.start - first, run.stop - first) for run in runs],
        )
        self.runner = Runner(self.workers)
        self.kick = 0.0
        """Duration of the last step [s]."""
        self.follower: Callable[[], None] | None = None
        """Function that is called after each step, before the argument `after` of `advance`."""
        self._fitted = False
        self.crowding, self._excess = 0.0, 0.0
        """Largest mean excess of the liquid's density, as a fraction of the rest density; and the
        excess at the end of the last frame. Only an excess that lasts for two frames counts,
        because an impact compresses the liquid for a moment.
        """
        self.lasting, self._lasts = 0.0, 0.0
        """Like `crowding` and `_excess`, but these values rise by at most `CROWDING` per second,
        because an impact may compress the liquid for a quarter of a second.
        """
        self.impulses = WallImpulses((), 0, count, model.device)
        self.bind(**acting)

    def bind(
        self,
        *,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[tuple[str, Boundary]] = (),
        accumulators: Sequence[Accumulator] = (),
        planes: Sequence[Plane] = (),
    ) -> None:
        """Replace the forces, the walls and the sums over particles, from the next step on.

        Args:
            forces: Forces, in the order in which they act.
            boundaries: Boundaries with their names.
            accumulators: Sums that are updated in every step.
            planes: Flat walls with which the freely moving solid collides.

        Raises:
            InputError: The region of a force contains no particle, or a wall is too thin for the
                grid; in this case nothing has changed.
        """
        model, state = self.model, self.state
        tracks = Tracks(real=model.real, device=model.device)
        acting = [stage for item in forces for stage in item.attach(model, state, tracks)]
        sums = [stage for item in accumulators for stage in item.attach(model, state, tracks)]
        fixed = list(walls_of(boundaries, self._whole, tracks))
        surfaces = [*walls_of_solids(self.free, model)]
        if self._bodies is not None:
            surfaces += walls_of_bodies(self._bodies.names, model)
        self.free.bind(planes, tracks)
        tracks.upload(self.clock.values)
        walls = Walls(model, tracks, [*fixed, *surfaces])
        self.tracks, self.walls, self._forces, self._sums = tracks, walls, acting, sums
        self.boundaries: list[Any] = []
        before, names = self.impulses.total, [wall.name for wall in fixed]
        self.impulses = WallImpulses(names, len(walls.all), len(self.workers), model.device)
        wp.copy(self.impulses.total, before)
        self._sample = tracks.record()
        self._sample.launch()
        self.rejection = StepRejection(model, state, tracks, acting, list(accumulators))
        if self._fitted:
            self._record()

    @property
    def grid(self) -> Grid:
        """The grid of the first body."""
        return self.grids[0]

    @property
    def nodes(self) -> int:
        """Number of cells in the window."""
        return self.cells.count

    @property
    def energies(self) -> Energies:
        """Work on the liquid by cause, if the work is summed."""
        return self._phases.energies

    def keep_pushes(self, sums: wp.array) -> None:
        """Sum impulse and work of forces on particles from now on; one row per worker."""
        self._phases.pushes.sums = sums
        if self._fitted:
            self._record()

    def keep_works(self) -> None:
        """Sum the work of each cause from now on."""
        self.energies.start()
        if self._fitted:
            self._record()

    @property
    def timings(self) -> Timings:
        """Seconds and number of kernel launches of each stage, in the first thread."""
        return self.workers[0].timings

    def advance(
        self, until: float, *, after: Callable[[], None] | None = None, each: bool = False
    ) -> None:
        """Take steps of stable length; `after` follows each step."""
        self._fit()
        list(self._phases.take_impulses())
        started, named = time.perf_counter(), self._seconds()
        begun = self.clock.time
        self._begin(until)
        with self.runner.on_threads():
            while self.clock.time < until:
                self._stable_step(until)
                for follow in filter(None, (self.follower, after)):
                    run_timed(self.timings, FOLLOW, follow)
        for a, b, row in self._phases.take_impulses():
            self.pairs.add(self.wet[a], self.wet[b], *np.split(row, 2))
        filled = self.cells.hats.numpy()[self.cells.liquid.numpy() == 1]
        if len(filled):
            excess = float(np.maximum(filled - 1, 0).mean())
            self.crowding, self._excess = max(self.crowding, min(self._excess, excess)), excess
            self._lasts = min(excess, self._lasts + CROWDING * (self.clock.time - begun))
            self.lasting = max(self.lasting, self._lasts)
        between = self.timings.setdefault(SCHEDULE, [0.0, 0])
        between[0] += time.perf_counter() - started - (self._seconds() - named)
        between[1] += 1

    def step(self, kick: float, drift: float) -> None:
        """Take a step: velocities change for the time `kick` [s], positions for `drift` [s]."""
        self._fit()
        clock = self.clock
        clock.begin(kick, drift)
        if self.tracks.vary:
            run_timed(self.timings, "tracks", self._sample.launch)
        self._guess(kick)
        if self.walls.move:
            if self.projection.solids or self.walls.time != clock.time:
                self.walls.place(clock.time)
                self._move_walls(ahead=drift / 2)
            self.walls.lead(clock.time + drift)
        self._group("scatter")
        if self._bodies is not None:
            self.runner.join()
            pull = np.asarray(self.tracks.values.numpy()[0, :3], np.float64)
            self._bodies.plan(kick, pull)
        if self._phases.viscosity.rate > 0:
            self._phases.viscosity.solve(self.runner.run, self._phases.group("viscosity")[0])
        self._group("equation")
        self._solve("pressure", TOLERANCE)
        self.walls.place(clock.time + drift)
        self._group("gather")
        self._move_solids(drift)
        if self.projection.solids or self.walls.follow_tracks:
            self._move_walls()
        self._group("fill")
        self._solve("packing", LOOSE)
        self._group("displace")
        self.runner.join()
        for name, launch in self._ending:
            run_timed(self.timings, name, launch)
        run_timed(self.timings, REPAIR, lambda: self.repair.substep(clock))
        clock.finish(drift)
        clock.pull = np.asarray(self.tracks.values.numpy()[0, :3], np.float64)
        self._measure()

    def start(self) -> None:
        """Move particles out of walls, and restore the rest density, without changing velocities.

        All observers must be bound before this call. The energy balance starts after this call, so
        that it does not include the energy for moving liquid out of a floor, or for expanding a
        liquid that is too dense.
        """
        self._fit()
        if self.walls.move:
            self.walls.place(self.clock.time)
            self._move_walls()
        self._group("leave walls")
        self.clock.begin(0.0, 0.0)
        self._group("scatter")
        for _ in range(SETTLE):
            self._group("fill")
            self._solve("packing", LOOSE)
            self._group("displace")
        self.runner.join()
        self._measure()

    def renew(self) -> None:
        """Measure all limits of a step again, after the state was changed from outside."""
        self._fit()
        self._measure()

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot from which `restore` continues bit for bit."""
        return {
            **super().snapshot(),
            # In the next step, viscosity acts before the pressure renews the motions of bodies.
            "motions": wp.clone(self.walls.motions),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore a snapshot; with an equal number of threads, the run continues bit for bit."""
        super().restore(snapshot)
        self._phases.stray.zero_()
        self._missed.zero_()
        self.walls.motions.assign(snapshot["motions"])
        self._fitted = self.cells.count > 0
        if self._fitted:
            self._record()

    def _seconds(self) -> float:
        return _sum_seconds(self.timings) + _sum_seconds(self.within)

    def _begin(self, until: float) -> None:
        clock, rejection = self.clock, self.rejection
        rejection.begin(clock.time, until)
        clock.acceleration, clock.wall = rejection.acceleration, rejection.wall
        if self.bounds is not None:
            self.bounds.begin(clock.time, until)
            clock.acceleration = max(clock.acceleration, self.bounds.acceleration)
            clock.wall = max(clock.wall, self.bounds.wall)
        clock.wall = max(clock.wall, self.free.fastest())

    def _stable_step(self, until: float) -> None:
        self._fit()
        clock = self.clock
        if self._bodies is not None:
            clock.period, clock.light = self._bodies.period, self._bodies.light
        rest = until - clock.time
        dt, limit = clock.divide(rest)
        self.step((clock.last_dt + dt) / 2, dt)
        if dt == rest:
            clock.time = until
        clock.last_dt = dt
        clock.count(limit.limiter, needed=dt / limit.dt)

    def _guess(self, kick: float) -> None:
        """Scale the last pressure to a step of `kick` [s], as the next initial guess."""
        scale = kick / self.kick if self.kick > 0 else 0.0
        self._phases.viscosity.carry.fill_(scale)
        self.kick = kick

    def _solve(self, name: str, tolerance: float) -> None:
        self.projection.solve(self.runner.run, self._phases.group(name)[0], tolerance)

    def _move_solids(self, drift: float) -> None:
        if not self.projection.solids:
            return
        self._group("drift")
        self.runner.join()
        if self._bodies is not None and self._advance_bodies is not None:
            rows, densities = self.impulses.rows(0), self._phases.densities
            self._bodies.receive(self.cells, self.tracks, rows, densities, drift)
            self._advance_bodies(self.clock.time + drift)

    def _move_walls(self, ahead: float = 0.0) -> None:
        """Write the positions of moving walls, `ahead` [s] from now, into the cells."""
        self.runner.join()
        run_timed(self.timings, "walls", self.cells.restore_walls)
        if self._bodies is not None:
            self._bodies.free.lead(self.free, ahead)
        self.walls.centre(self.cells)
        self._group("move")
        if (bodies := self._bodies) is not None:
            self.runner.join()
            before = _sum_seconds(self.within)
            describe = partial(bodies.describe, self.cells, self.walls, ahead)
            run_timed(self.timings, "bodies", describe)
            # The bodies may take trial substeps, whose times are in `within`.
            self.timings["bodies"][0] -= _sum_seconds(self.within) - before

    def _group(self, name: str) -> None:
        for phase in self._phases.group(name):
            self.runner.run(phase)

    def _fit(self) -> None:
        if not self._fitted:
            self._extents = [self._phases.extent(index) for index in range(len(self.workers))]
            self._fitted = True
            self._measure()

    def _measure(self) -> None:
        extents, team = self._extents, self.runner.team

        def extend(member: int) -> None:
            for _, launch in extents[member]:
                launch()

        run_timed(self.timings, "measure", lambda: team.complete(extend))
        rows = np.asarray(self._phases.extents.numpy(), np.float64).max(axis=0)
        lost = int(self._phases.stray.numpy()[0])
        if lost:
            raise Unstable(f"{lost} particles are NaN or infinite")
        self.clock.set_speed(math.sqrt(max(rows[6], 0.0)))
        if self.cells.fit(*self._bound(-rows[:3], rows[3:6])):
            run_timed(self.timings, WINDOW, self._record)

    def _bound(self, lower: NDArray, upper: NDArray) -> tuple[NDArray, NDArray]:
        """Return the corners [m] of the particles' bounding box, or of its part that fits into the
        largest window.
        """
        most = min(self.outliers.allowed, MOST_CELLS)
        if np.prod(needed_cells(lower, upper, self.model.dx)) <= most:
            return lower, upper
        lower, upper, outside = restrict(self.state.x.numpy(), self.model.dx, most)
        self.outliers.most = max(self.outliers.most, outside)
        return lower, upper

    def _record(self) -> None:
        self.grid.low, self.grid.size = self.cells.low, self.cells.size
        if self._bodies is not None:
            self._bodies.fit(self.cells)
        self._extents = [self._phases.extent(index) for index in range(len(self.workers))]
        self._phases.record(self._forces, self.walls, self.tracks, self.impulses, self.grid)
        sums = launches([(stage.name, stage.record(self.grid)) for stage in self._sums])
        self._ending = [("walls", self.impulses.settle), *sums]
        self.cells.clear_walls()
        # The times are a part of the stage `WINDOW`.
        for phase in self._phases.group("walls"):
            for worker in self.workers:
                for _, launch in worker.phases[phase]:
                    launch()
        self.walls.time = math.nan
        if self.walls.move:
            self.cells.keep_walls()


def _sum_seconds(timings: Timings) -> float:
    return sum(seconds for seconds, _ in timings.values())
