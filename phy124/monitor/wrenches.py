"""Wrenches: measures force and torque of an object on each wall and on other objects.

Torques are about the centre of mass of all particles at the time of the frame.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.gaussians import Frame, Wrench, walls_of
from phy124.kernels import contacts as kernels
from phy124.kernels.work import make_wall_copy
from phy124.monitor.measured import NodesNear
from phy124.monitor.observer import Effect, Observed, Observer, Subject
from phy124.mpm import Attachable, Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver

STAGE = "wrenches"
LIQUID = -1
"""Key of the impulses of a projected liquid; other keys are indices of workers."""
Vector3 = NDArray[np.float64]


class Wrenches(Observer):
    """Wrenches (forces and torques) between objects and, if requested, on walls."""

    absent: ClassVar[dict[str, Any]] = {"walls": None}
    in_substeps = True

    def __init__(self, *, of_walls: bool = True, of_pairs: bool = False, fps: float = 1.0) -> None:
        self._of_walls, self._of_pairs, self._fps = of_walls, of_pairs, fps
        self._sums: dict[str, dict[int, wp.array]] = {}
        """Impulses on each wall, by name and worker."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the scene requests wrenches or has objects that may touch."""
        return subject.scene.keeps_wrenches or bool(subject.scene.objects)

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that measure a wall."""
        if subject.scene.keeps_wrenches and subject.scene.boundaries:
            yield from (make_wall_copy(real), kernels.make_wall_wrench(real))

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        asked = subject.scene.keeps_wrenches and bool(subject.scene.boundaries)
        return Effect("force and torque per wall", asked, "not requested, or there is no boundary")

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        scene = setup.scene
        pairs = bool(scene.objects)
        return cls(of_walls=scene.keeps_wrenches, of_pairs=pairs, fps=scene.time.fps)

    @property
    def walls(self) -> tuple[str, ...]:
        """Names of the measured walls."""
        return tuple(self._sums)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all wrenches in a frame."""
        return (*self.walls, *pair_names(self._solver))

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable]
    ) -> Sequence[Attachable]:
        """Return the boundaries, with stages that measure each wall."""
        if not self._of_walls:
            return inner
        named = zip(wall_names(walls), walls, inner, strict=True)
        return [_Separated(self, name, wall, wrapped) for name, wall, wrapped in named]

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver."""
        self._solver = solver
        self._read_impulses()

    def change(self, scene: Scene) -> None:
        """Continue with the walls of another scene."""
        self._read_impulses()

    def _read_impulses(self) -> None:
        solver: Any = self._solver
        if self._of_walls and solver.projects:
            impulses = solver.impulses
            # In addition to the liquid's sums, each worker has sums for other materials.
            self._sums = {name: s for name, s in self._sums.items() if LIQUID not in s}
            for name in impulses.names:
                self._sums.setdefault(name, {})[LIQUID] = impulses.wrench(name)

    def before_attempt(self, *, closely: bool = False) -> None:
        """Set the sums of impulses to zero."""
        for sums in self._arrays().values():
            sums.zero_()

    def after_frame(self, frame: Frame) -> Frame:
        """Return the frame with the mean wrenches since the previous frame."""
        if not self._of_walls and not self.names:
            return frame
        return replace(frame, wrenches=self.contacts(self._solver, self._fps))

    def contacts(self, solver: AnySolver, fps: float) -> dict[str, Wrench]:
        """Return the mean wrench on each wall and between each pair of bodies since the start of
        the frame.
        """
        arrays = (solver.model.mass, solver.state.x)
        mass, x = (np.asarray(array.numpy(), np.float64) for array in arrays)
        centre = mass @ x / mass.sum()
        wrenches = {wall: self.of_wall(wall, centre, fps) for wall in self.walls}
        between = [*solver.pairs.wrenches(1 / fps).values(), *solver.free.wrenches(1 / fps)]
        for name, (force, torque) in zip(pair_names(solver), between, strict=True):
            wrenches[name] = Wrench(force, torque - np.cross(centre, force))
        return wrenches

    def report(self, frames: Sequence[Frame]) -> dict[str, Any]:
        """Return the sections about wrenches on walls and between objects."""
        pairs = pair_names(self._solver)
        walls = [name for name in walls_of(frames) if name not in pairs]
        report = {"walls": summary(frames, walls) if self._of_walls else None}
        if self._of_pairs:
            report["pairs"] = summary(frames, pairs)
        return report

    def snapshot(self) -> dict[str, Any]:
        """Return the sums of impulses."""
        return {name: wp.clone(sums) for name, sums in self._arrays().items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the sums of impulses."""
        for name, sums in self._arrays().items():
            copy = snapshot.get(name)
            sums.zero_() if copy is None else sums.assign(copy)

    def measure(self, name: str, wall: Boundary, model: Model) -> tuple[Stage, Stage]:
        """Return the stages before and after a wall acts; `name` is the key of the wall's sums."""
        self._sums[name] = {}
        near, kernel = NodesNear([wall], model), kernels.make_wall_wrench(model.real)

        def after(grid: Grid) -> wp.Launch | None:
            inputs = [grid.lattice, *near.read, near.copy]
            sums = self._worker_sums(name, grid, model)
            return model.launch(kernel, near.threads, inputs, [sums])

        return Stage(STAGE, near.record_copy), Stage(STAGE, after)

    def _worker_sums(self, name: str, grid: Grid, model: Model) -> wp.array:
        """Return a worker's array, to which no other thread adds."""
        sums = self._sums[name]
        if grid.worker not in sums:
            sums[grid.worker] = wp.zeros(kernels.SUMS, dtype=wp.float64, device=model.device)
        return sums[grid.worker]

    def _arrays(self) -> dict[str, wp.array]:
        return {
            f"{name} {worker}": array
            for name, sums in self._sums.items()
            for worker, array in sums.items()
        }

    def of_wall(self, wall: str, centre: Vector3, fps: float) -> Wrench:
        """Return the mean force and torque about a centre [3], m, on a wall since the start of the
        frame.
        """
        total = np.zeros(kernels.SUMS)
        for sums in self._sums[wall].values():
            total += sums.numpy()
        impulse, moment = np.split(-total, [kernels.MOMENT])
        return Wrench(fps * impulse, fps * (moment - np.cross(centre, impulse)))


class _Separated:
    def __init__(self, wrenches: Wrenches, name: str, wall: Boundary, inner: Attachable) -> None:
        self._wrenches, self._name, self._wall, self._inner = wrenches, name, wall, inner

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        wall = self._wall
        stages, parts = self._inner.attach(model, state, tracks), wall.parts()
        if not parts:  # a container whose sides are all open
            return stages
        each, more = divmod(len(stages), len(parts))
        if len(parts) == 1 or more:
            return self._between(self._name, wall, stages, model)
        named = zip(wall.part_names(), parts, itertools.count(0, each))
        return [
            stage
            for name, part, first in named
            for stage in self._between(
                f"{self._name}_{name}", part, stages[first : first + each], model
            )
        ]

    def _between(self, name: str, wall: Boundary, stages: list[Stage], model: Model) -> list[Stage]:
        before, after = self._wrenches.measure(name, wall, model)
        return [before, *stages, after]


def pair_names(solver: AnySolver) -> tuple[str, ...]:
    """Return a name for each pair of bodies that may touch.

    The second body receives the force. Particle bodies come before rigid solids.
    """
    names = solver.model.names
    pairs = (f"{names[p.first]}_on_{names[p.second]}" for p in solver.pairs.all)
    return (*pairs, *solver.free.names)


def kind_of(wall: Boundary) -> str:
    """Return a boundary's kind; without a kind, the name of its class in lower case."""
    return str(getattr(wall, "kind", type(wall).__name__.lower()))


def wall_names(walls: Sequence[Boundary]) -> list[str]:
    """Return a name for each boundary: its kind, with a number for repeated kinds."""
    counts: Counter[str] = Counter()
    names = []
    for wall in walls:
        kind = kind_of(wall)
        counts[kind] += 1
        names.append(kind if counts[kind] == 1 else f"{kind}_{counts[kind]}")
    return names


def simple_wall_names(walls: Sequence[Boundary]) -> list[str]:
    """Return a name for each simple wall, in the order of the boundaries."""
    return [
        name if len(wall.parts()) == 1 else f"{name}_{part}"
        for name, wall in zip(wall_names(walls), walls, strict=True)
        for part in wall.part_names()
    ]


def summary(frames: Sequence[Frame], names: Sequence[str]) -> dict[str, Any] | None:
    """Return for each name the largest force, its time, and the last wrench."""
    if not frames or frames[-1].wrenches is None:
        return None
    rows = {}
    for name in names:
        acting = [(f.time, f.wrenches[name]) for f in frames if f.wrenches and name in f.wrenches]
        forces = [float(np.linalg.norm(wrench.force)) for _, wrench in acting]
        worst, (_, last) = int(np.argmax(forces)), acting[-1]
        rows[name] = {
            "largest_force": forces[worst],
            "at": acting[worst][0],
            "last": {"force": last.force.tolist(), "torque": last.torque.tolist()},
        }
    return rows
