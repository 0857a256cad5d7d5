"""External work: sums impulse and work of forces and walls on the object in every substep.

A constant uniform acceleration `a` contributes the impulse `M a dt` and the work `M a . dx`, which
need no kernel launch. If the acceleration varies in time, a single-thread kernel adds its impulse
and work, computed from the momentum, at the end of each substep. In runs with a projected liquid,
`phy124.monitor.liquid_work` adds them instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.kernels import free
from phy124.kernels import work as kernels
from phy124.kernels.reduction import shared_out
from phy124.monitor.measured import Measured, NodesNear
from phy124.monitor.observer import Effect, Observed, Observer, Subject
from phy124.mpm import Attachable, Clock, Grid, Model, Stage, State
from phy124.mpm.model import part_of
from phy124.mpm.tracks import Tracks
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver

STAGE = "external work"
PUSH, WALL, UNIFORM = "push", "wall", "uniform"
"""Causes: forces on particles, walls, and a varying uniform acceleration."""
MEAN_PUSH, MEAN = "mean_push", "mean"
"""Further causes, for lattices and for projected liquids: forces on points, and walls. The work of
these causes is computed with the mean velocities of a step.
"""
SOURCES = (PUSH, WALL, UNIFORM, MEAN_PUSH, MEAN)
ROOM = 16
"""Length of each worker's array of sums, chosen so that no two workers write to one cache line."""
IMPULSES = slice(kernels.IMPULSE, kernels.IMPULSE + 3)
Sums = NDArray[np.float64]


class Exchange(NamedTuple):
    """External impulse and work on the object since the start."""

    impulse: Sums
    """Impulse [3], N s."""
    work: float
    """Work [J]."""
    moved: float
    """Sum of the norms of all impulses [N s]."""
    turned: float
    """Sum of the absolute values of the work [J]."""

    def plus(self, sums: Sums) -> Exchange:
        """Return this exchange plus the impulse and work of rigid solids (phy124/kernels/free)."""
        work, moved, turned = sums[free.WORK :]
        return Exchange(
            self.impulse + sums[:3], self.work + work, self.moved + moved, self.turned + turned
        )


class ExternalWork(Observer):
    """Sums the external impulse and work in a run.

    The watchdog calls `open` before the first frame and `begin` before every attempt.
    """

    in_substeps = True

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether momentum and energy are balanced."""
        return subject.scene.checks.balance

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that measure walls.

        The kernels that measure forces are compiled when needed, which takes 0.3 s.
        """
        if subject.scene.boundaries:
            yield from (kernels.make_wall_copy(real), kernels.make_wall_sums(real))

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects; constant uniform forces need no
        sums.
        """
        scene, why = (
            subject.scene,
            "checks.balance is off: an unstable run is detected only when values become NaN",
        )
        if scene.checks.balance:
            why = "all forces are constant, so that their work need not be summed"
        unsteady = any(not force.uniform or force.varies for force in scene.acting)
        summed = scene.checks.balance and (bool(scene.boundaries) or unsteady)
        return Effect("balance of momentum and energy", summed, why)

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        return cls(summed=setup.subject.changes)

    def __init__(self, *, summed: bool = False) -> None:
        """Prepare the sums. If `summed` is set, the work of a constant acceleration is also summed
        in every substep, because forces and boundaries may be replaced during the run.
        """
        self._summed = summed
        self._device: dict[str, wp.array] = {}
        """Sums [W,ROOM] since kernel launches were last recorded; the totals do not contain these
        sums yet.
        """
        self.stored = 0.0
        """Energy gained without motion since the start [J]."""
        self._closed: dict[str, Sums] = {name: np.zeros(kernels.EXCHANGE) for name in SOURCES}
        self._momentum, self._opened = np.zeros(3), 0.0
        """`_momentum` is the momentum at the start of the frame [kg m/s], without the impulses that
        the totals do not contain yet. `_opened` is the initial time of the velocities [s].
        """

    def wrap_forces(self, forces: Sequence[Attachable]) -> list[Attachable]:
        """Return one force that measures the particles before and after all forces act."""
        return [Measured(forces, self._attach_push)] if forces else []

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable]
    ) -> list[Attachable]:
        """Return one wall that measures the nodes before and after all walls act."""
        return [Measured(inner, partial(self._attach_walls, walls))] if walls else []

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stage that measures a varying uniform acceleration, if there is one."""
        self._model, self._tracks = model, tracks
        self._base, self._walls_before = (
            wp.zeros(count, dtype=wp.float64, device=model.device) for count in (3, 6)
        )
        return [Stage(STAGE, self._record_uniform)] if self.by_step else []

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver; solvers of projected liquids sum the work of
        walls.
        """
        self._liquid: Any = solver if solver.projects else None
        self._read_impulses()

    def follow_pushes(self, solver: Any) -> None:
        """Let a solver sum the impulse and work of forces on particles from now on."""
        sums = wp.zeros((len(solver.workers), ROOM), dtype=wp.float64, device=solver.model.device)
        self._device[MEAN_PUSH] = sums
        solver.keep_pushes(sums)

    def change(self, scene: Scene) -> None:
        """Measure the walls of another scene from now on."""
        self._read_impulses()

    def _read_impulses(self) -> None:
        if self._liquid is not None:
            self._device[MEAN] = self._liquid.impulses.total

    @property
    def by_step(self) -> bool:
        """Whether the work of the uniform acceleration is summed in every step or substep."""
        return self._summed or self._tracks.acceleration_varies

    def open(self, clock: Clock) -> None:
        """Sum impulse and work from now on."""
        for name in SOURCES:
            self._closed[name] = np.zeros(kernels.EXCHANGE)
        for sums in self._device.values():
            sums.zero_()
        self._opened, self.stored = clock.time - clock.behind, 0.0

    def store(self, energy: float) -> None:
        """Add energy [J] gained without motion, such as by stiffening."""
        self.stored += energy
        self._closed[PUSH] = self._closed[PUSH].copy()
        self._closed[PUSH][[kernels.WORK, kernels.TURNED]] += energy, abs(energy)

    def begin(self, momentum: Sums) -> None:
        """Start a frame with the momentum of the object [kg m/s]."""
        if self.by_step:
            self._momentum = momentum - self._sum()[IMPULSES] - self._from_bodies()
            self._set_base()

    def total(self, clock: Clock, way: Sums) -> Exchange:
        """Return the external impulse and work since the start of the run.

        `way` is the sum of mass times displacement since the start [3], kg m.
        """
        total = self._sum()
        values: NDArray[Any] = self._tracks.values.numpy()
        a = values[0, :3].astype(np.float64)
        if not self.by_step:
            impulse = self._model.total_mass * a * (clock.time - clock.behind - self._opened)
            work = float(a @ way)
            total = total + np.array([*impulse, work, np.linalg.norm(impulse), abs(work)])
        work, moved, turned = total[[kernels.WORK, kernels.MOVED, kernels.TURNED]].tolist()
        return Exchange(total[IMPULSES], work, moved, turned)

    def of_walls(self) -> float:
        """Return the work of the walls [J]; negative for walls at rest."""
        return float(self._sum(WALL, MEAN)[kernels.WORK])

    def of_grids(self) -> float:
        """Return the work of the walls on MPM bodies [J], a part of `of_walls`."""
        return float(self._sum(WALL)[kernels.WORK])

    def snapshot(self) -> dict[str, Any]:
        """Return the sums as plain data."""
        return {
            "closed": {name: sums.tolist() for name, sums in self._closed.items()},
            "open": {name: sums.numpy().tolist() for name, sums in self._device.items()},
            "momentum": self._momentum.tolist(),
            "opened": self._opened,
            "stored": self.stored,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the sums."""
        self._closed = {name: np.array(sums) for name, sums in snapshot["closed"].items()}
        for name, sums in snapshot["open"].items():
            open_sums = np.array(sums) if sums else np.zeros((0, ROOM))
            if name in self._device and self._device[name].shape == open_sums.shape:
                self._device[name].assign(open_sums)
            else:
                self._closed[name] += open_sums[:, : kernels.EXCHANGE].sum(axis=0)
        for name in self._device.keys() - snapshot["open"].keys():
            self._device[name].zero_()
        self._momentum, self._opened = np.array(snapshot["momentum"]), snapshot["opened"]
        self.stored = snapshot.get("stored", 0.0)

    def _sum(self, *names: str) -> Sums:
        """Return the sums of the named causes; without names, of all causes."""
        total = np.zeros(kernels.EXCHANGE)
        for name in names or SOURCES:
            total += self._closed[name]
            if name in self._device:
                total += self._open(name)
        return total

    def _open(self, name: str) -> Sums:
        """Return the sums of all workers since kernel launches were last recorded."""
        rows: NDArray[Any] = self._device[name].numpy()
        return rows[:, : kernels.EXCHANGE].sum(axis=0)

    def _accumulator(self, name: str, grid: Grid) -> wp.array:
        """Return the array of one worker; no two CPU threads use one array."""
        if grid.worker == 0:
            if name in self._device:
                self._closed[name] = self._closed[name] + self._open(name)
            self._device[name] = self._zeros(grid.workers)
        return cast("wp.array", self._device[name][grid.worker])

    def _zeros(self, workers: int) -> wp.array:
        return wp.zeros((workers, ROOM), dtype=wp.float64, device=self._model.device)

    def _record_uniform(self, grid: Grid) -> wp.Launch | None:
        model, tracks, sums = self._model, self._tracks, self._accumulator(UNIFORM, grid)
        self._set_base()
        names = (PUSH, WALL, MEAN_PUSH, MEAN)
        others = [self._device.get(name, self._zeros(0)) for name in names]
        inputs = [model.total_mass, tracks.clock, tracks.values, self._base, *others]
        inputs += self._rows_of_bodies()
        kernel = kernels.make_uniform_sums(model.real)
        return model.launch(kernel, 1, inputs, [self._walls_before, sums])

    def _set_base(self) -> None:
        """Store the momentum at the time when the sums were set to zero, and the impulse of the
        walls since that time.
        """
        self._base.assign(self._momentum + sum(sums[IMPULSES] for sums in self._closed.values()))
        before = [
            sum(self._open(name)[IMPULSES] for name in names if name in self._device)
            for names in ((WALL,), (MEAN_PUSH, MEAN))
        ]
        before[1] = before[1] + self._from_bodies()
        self._walls_before.assign(np.concatenate([np.zeros(3) + part for part in before]))

    def _rows_of_bodies(self) -> list[wp.array]:
        """Return impulses of freely moving solids, impulses of pairs of bodies, and signs of the
        pairs.
        """
        return [self._zeros(0), self._zeros(0), wp.zeros(0, wp.float64, device=self._model.device)]

    def _from_bodies(self) -> Sums:
        """Return the impulse [3] of freely moving solids and fixed bodies, N s."""
        return np.zeros(3)

    def _attach_push(
        self, stages: Sequence[Stage], model: Model, state: State
    ) -> tuple[Stage, Stage]:
        keeps_C = all(stage.keeps_C for stage in stages)
        copied = [wp.empty_like(state.v), wp.empty_like(state.C[:0] if keeps_C else state.C)]
        copy = kernels.make_push_copy(model.real, keeps_C)
        sums = (kernels.make_push_sums_v if keeps_C else kernels.make_push_sums)(model.real)

        def copies_for(grid: Grid) -> list[wp.array]:
            """Return arrays for copies of the velocities v and the matrices C of the particles on
            which forces act.
            """
            run = grid.run(len(model))
            return [part_of(array, run) for array in copied]

        def before(grid: Grid) -> wp.Launch | None:
            run, copies = grid.run(len(model)), copies_for(grid)
            return model.launch(copy, len(copies[0]), [state.v[run], state.C[run]], copies)

        def after(grid: Grid) -> wp.Launch | None:
            run = grid.run(len(model))
            threads, *fraction = shared_out(run.stop - run.start, model.device)
            inputs = [*fraction, model.mass[run]]
            if keeps_C:
                inputs += [state.v[run], copies_for(grid)[0]]
            else:
                inputs += [model.dx, state.v[run], state.C[run], *copies_for(grid)]
            return model.launch(sums, threads, inputs, [self._accumulator(PUSH, grid)])

        return Stage(STAGE, before, by_run=True), Stage(STAGE, after, by_run=True)

    def _attach_walls(
        self, walls: Sequence[Boundary], stages: Sequence[Stage], model: Model, state: State
    ) -> tuple[Stage, Stage]:
        near, kernel = NodesNear(walls, model), kernels.make_wall_sums(model.real)

        def after(grid: Grid) -> wp.Launch | None:
            inputs = [*near.read, near.copy]
            return model.launch(kernel, near.threads, inputs, [self._accumulator(WALL, grid)])

        return Stage(STAGE, near.record_copy), Stage(STAGE, after)


class MeanWork(ExternalWork):
    """Reads the external work from solvers that sum the work of walls and forces.

    Projected pressure and the clamps of lattices counteract a force within the same step. All work
    is therefore computed with the mean velocities of the step.
    """

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield nothing; the solver measures the walls."""
        yield from ()

    def wrap_walls(self, walls: Sequence[Boundary], inner: Sequence[Attachable]) -> Any:
        """Return the walls unchanged; the solver sums their work."""
        return inner

    def wrap_forces(self, forces: Sequence[Attachable]) -> list[Attachable]:
        """Return the forces unchanged; the solver sums their work."""
        return list(forces)

    def bind(self, solver: Any, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver, which then sums the impulse and work of forces."""
        super().bind(solver, observers)
        self.follow_pushes(solver)
