"""Wrenches: force and torque that the object exerts on each wall, if they are asked for.

What a wall gives to the nodes is summed in every substep, as impulse and as its moment. What the
object exerts on the wall is the opposite. Its torque is taken about the object's centre of mass at
the instant of the frame.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.gaussians import Frame, Wrench
from phy124.kernels import wrenches as kernels
from phy124.kernels.external_work import make_wall_copy
from phy124.monitor.near import NodesNear
from phy124.mpm import Attachable, Grid, Model, Solver, Stage, State
from phy124.mpm.tracks import Tracks

STAGE = "wrenches"
"""Name of the stages that sum them."""
Vector3 = NDArray[np.float64]


class Wrenches:
    """The sums of one frame; give the solver the result of `boundaries` and this object."""

    def __init__(self, *, asked: bool = True) -> None:
        self.asked = asked
        """Whether anything is summed."""
        self._sums: dict[str, dict[int, wp.array]] = {}
        """Sums of each wall, for each worker."""

    @property
    def walls(self) -> tuple[str, ...]:
        """Names of the walls, in the order of the scene."""
        return tuple(self._sums)

    def boundaries(self, walls: Sequence[Boundary]) -> list[Attachable]:
        """The boundaries, each of whose walls is measured before and after it acts."""
        return [
            _Separated(self, wall, name) for name, wall in zip(names(walls), walls, strict=True)
        ]

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Nothing more: the walls have the stages."""
        del model, state, tracks
        return []

    def begin(self) -> None:
        """Start a frame."""
        for sums in self._arrays().values():
            sums.zero_()

    def contacts(self, solver: Solver, fps: float) -> dict[str, Wrench] | None:
        """Mean wrench on each wall since the frame began, and of each object on each other one.

        The torques are about the centre of mass of all particles. None if there are no walls that
        are asked for and no other objects.

        Args:
            solver: The particles, and what the objects gave each other.
            fps: Frames per second.
        """
        names = pair_names(solver)
        if not self.asked and not names:
            return None
        arrays = (solver.model.mass, solver.state.x)
        mass, x = (np.asarray(array.numpy(), np.float64) for array in arrays)
        middle = mass @ x / mass.sum()
        found = {wall: self._wrench(wall, middle, fps) for wall in self._sums} if self.asked else {}
        given = [*solver.pairs.wrenches(1 / fps).values(), *solver.free.wrenches(1 / fps)]
        for name, (force, torque) in zip(names, given, strict=True):
            found[name] = Wrench(force, torque - np.cross(middle, force))
        return found

    def snapshot(self) -> dict[str, Any]:
        """The sums as they are now."""
        return {name: wp.clone(sums) for name, sums in self._arrays().items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Set the sums back to a snapshot."""
        for name, sums in self._arrays().items():
            kept = snapshot.get(name)
            sums.zero_() if kept is None else wp.copy(sums, kept)

    def measured(self, name: str, wall: Boundary, model: Model) -> tuple[Stage, Stage]:
        """The stages before and after a wall, whose sums have a name."""
        self._sums[name] = {}
        near, (copy, wrench) = NodesNear([wall], model), wrench_kernels(model.real)

        def before(grid: Grid) -> wp.Launch | None:
            near.fit(grid)
            return model.launch(copy, near.threads, near.read, [near.kept])

        def after(grid: Grid) -> wp.Launch | None:
            inputs = [grid.lattice, *near.read, near.kept]
            return model.launch(wrench, near.threads, inputs, [self._own(name, grid, model)])

        return Stage(STAGE, before), Stage(STAGE, after)

    def _own(self, name: str, grid: Grid, model: Model) -> wp.array:
        """The sums of a wall and worker, so that two threads never add to the same ones."""
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

    def _wrench(self, wall: str, middle: Vector3, fps: float) -> Wrench:
        total = np.zeros(kernels.SUMS)
        for sums in self._sums[wall].values():
            total += sums.numpy()
        impulse, moment = np.split(-total, [kernels.MOMENT])
        return Wrench(fps * impulse, fps * (moment - np.cross(middle, impulse)))


class _Separated:
    """A boundary with a stage before and one after each of its walls."""

    def __init__(self, wrenches: Wrenches, wall: Boundary, name: str) -> None:
        self._wrenches, self._wall, self._name = wrenches, wall, name

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Its stages between those that measure: each wall by itself if all have as many."""
        wall = self._wall
        stages, parts = wall.attach(model, state, tracks), wall.parts()
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
        before, after = self._wrenches.measured(name, wall, model)
        return [before, *stages, after]


def pair_names(solver: Solver) -> tuple[str, ...]:
    """A name for each pair of bodies: that of the one that exerts the wrench comes first.

    Those of bodies of particles, then those of what these exert on free solids.
    """
    called = solver.model.names
    pairs = (f"{called[p.first]}_on_{called[p.second]}" for p in solver.pairs.all)
    return (*pairs, *solver.free.names)


def names(walls: Sequence[Boundary]) -> list[str]:
    """A name for each boundary: its kind, numbered from the second of a kind on."""
    found: Counter[str] = Counter()
    named = []
    for wall in walls:
        kind = str(getattr(wall, "kind", type(wall).__name__.lower()))
        found[kind] += 1
        named.append(kind if found[kind] == 1 else f"{kind}_{found[kind]}")
    return named


def summary(frames: Sequence[Frame], chosen: Sequence[str]) -> dict[str, Any] | None:
    """For each wall its largest force, when that was, and the wrench of the last frame.

    Args:
        frames: All frames of a run; those before the first substep have no forces.
        chosen: Names of the walls.
    """
    if not frames or frames[-1].wrenches is None:
        return None
    found = {}
    for wall in chosen:
        last = frames[-1].wrenches[wall]
        forces = [float(np.linalg.norm(f.wrenches[wall].force)) for f in frames if f.wrenches]
        worst = int(np.argmax(forces))
        found[wall] = {
            "largest_force": forces[worst],
            "at": frames[worst].time,
            "last": {"force": last.force.tolist(), "torque": last.torque.tolist()},
        }
    return found


def wrench_kernels(real: Any) -> tuple[Any, Any]:
    """What measures a wall: before and after it acts."""
    return make_wall_copy(real), kernels.make_wall_wrench(real)
