"""CoupledSolver: advances bodies on lattices and bodies of particles in the same substeps."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.lattice.material import Material
from phy124.lattice.solver import LatticeSolver
from phy124.mpm import Attachable, Clock, Model, Pair, Solver, State
from phy124.mpm.kept import Kept
from phy124.mpm.pairs import fill_of
from phy124.mpm.stage import divide_forces
from phy124.mpm.timestep import Substep

STATE = ("x", "v", "C", "F")
"""Names of the arrays of `State` that exist for the integration points of a lattice."""


class CoupledClock(Clock):
    """The clock of the particles, with substeps that are also short enough for the lattices."""

    lattice: Clock | None = None

    def stable(self) -> Substep:
        """Return the longest substep that is stable for all bodies."""
        substeps = [super().stable(), *([self.lattice.stable()] if self.lattice else [])]
        return min(substeps, key=lambda substep: substep.dt)

    def list_failed(self, dt: float) -> list[tuple[Clock, float]]:
        """Return the clocks to `halve` if a frame is repeated: this clock and the lattices'."""
        return [*super().list_failed(dt), *(self.lattice.list_failed(dt) if self.lattice else [])]


class CoupledSolver(Solver):
    """Advances bodies on lattices and bodies of particles in time."""

    clock_type = CoupledClock

    def __init__(
        self,
        model: Model,
        surface: NDArray,
        state: State,
        *,
        pairs: Sequence[Pair] = (),
        copies: NDArray | None = None,
        still: Sequence[int] = (),
        ceiling: float = math.inf,
        **options: Any,
    ) -> None:
        """Divide the bodies between the lattice solver and the particle solver.

        Args:
            model: All particles; the bodies `Model.wet` are on lattices.
            surface: Surface points at rest [S,8], as in `Particles.surface`.
            state: Initial state of the particles.
            pairs: Pairs of bodies whose contact differs from the default.
            copies: Copy of each of the 27 nodes that a cell uses [C,27]; None: no node has copies.
            still: Bodies on lattices that never move.
            ceiling: Longest substep allowed [s].
            options: Further arguments of `Solver` and of `bind`.

        Raises:
            InputError: As in `Solver` and `LatticeSolver`.
        """
        bodies = sorted(model.wet)
        part, index = part_of_bodies(model, bodies, still)
        number = {body: place for place, body in enumerate(bodies)}
        between = [
            Pair(number[p.first], number[p.second], p.friction, p.sticky)
            for p in pairs
            if {p.first, p.second} <= model.wet
        ]
        motion = (np.asarray(array.numpy(), np.float64)[index] for array in (state.v, state.C))
        rows = surface.copy()
        rows[:, 6] = np.searchsorted(bodies, rows[:, 6])
        self._index, self._bodies, self._numbers = index, bodies, number
        self.lattice = LatticeSolver(
            part,
            rows,
            State.of(part, *motion),
            pairs=between,
            copies=copies,
            ceiling=ceiling,
            threads=1,
        )
        self.materials: list[Material] = []
        self.lattice.guests = self.materials
        self.guest = self._part = _Lattices(self.lattice, self.materials)
        super().__init__(model, state, pairs=pairs, ceiling=ceiling, graph=False, **options)
        fill = fill_of(model)
        for pair in self.pairs.all:
            soft = {pair.first, pair.second} & model.wet
            if len(soft) != 1:
                continue
            (body,) = soft
            (other,) = {pair.first, pair.second} - soft
            moves = other not in model.held
            known = self.lattice.surface, self.lattice.nodes_state, part, pair, fill[other]
            self.materials.append(Material(*known, body=number[body], moves=moves))
        assert isinstance(self.clock, CoupledClock)
        self.clock.lattice = self.lattice.clock

    @property
    def meetings(self) -> Any:
        """Contact between the bodies on lattices."""
        return self.lattice.meetings

    @property
    def nodes(self) -> int:
        """Number of nodes in all windows and lattices."""
        return super().nodes + self.lattice.nodes

    def bind(
        self, *, uniform: Sequence[Attachable] = (), walls: Sequence[Any] = (), **acting: Any
    ) -> None:
        """Replace forces, boundaries and sums as `Solver.bind` does.

        The `uniform` forces and the boundaries `walls` act on the lattices.
        """
        forces = divide_forces(uniform, self.lattice.model, self.model)
        self.lattice.bind(forces=forces, boundaries=walls)
        super().bind(**acting)
        self.rejection.keep(self._part)

    def advance(
        self, until: float, *, after: Callable[[], None] | None = None, each: bool = False
    ) -> None:
        """Take substeps of stable length, as `Solver.advance` does."""
        lattice = self.lattice
        lattice.rejection.begin(self.clock.time, until)
        lattice.limits.measure_if_due()
        lattice.pairs.begin()
        before = [material.sums.numpy().copy() for material in self.materials]
        super().advance(until, after=after, each=each)
        lattice.clock.time = self.clock.time
        lattice.follow()
        copy_points(lattice.state, self.state, self._index)
        for material, old in zip(self.materials, before, strict=True):
            first, second = material.pair[:2]
            soft, other = (first, second) if first in self._numbers else (second, first)
            impulse, moment = np.split(material.sums.numpy() - old, 2)
            self.pairs.add(other, soft, impulse, moment)
        for (first, second), (impulse, moment) in lattice.pairs.wrenches(1.0).items():
            self.pairs.add(self._bodies[first], self._bodies[second], impulse, moment)

    def _stable_step(self, until: float) -> None:
        if self.lattice.limits.measure_if_due():
            for material in self.materials:
                material.due = True
        if self.clock.stable().dt < self.lattice.clock.stable().dt:
            # Substeps that are short because of the particles say nothing about the lattices.
            self.lattice.clock.mark()
        super()._stable_step(until)
        self.lattice.clock.last_dt = self.clock.last_dt

    def step(self, kick: float, drift: float) -> None:
        """Take one substep: change velocities for `kick` [s], positions and F for `drift` [s]."""
        super().step(kick, drift)
        self.lattice.end_step(drift)

    def _careful_step(self, dt: float) -> float:
        dt = super()._careful_step(dt)
        self.lattice.end_step(dt)
        return dt

    def _scatter(self, kick: float, drift: float) -> None:
        self._part.times = kick, drift
        super()._scatter(kick, drift)

    def _record(self) -> None:
        for material in self.materials:
            pair = material.pair
            (other,) = {pair.first, pair.second} - self._numbers.keys()
            clock = self.lattice.tracks.clock
            material.record(self.grids[other], clock, self.lattice.walls.recovery)
            material.due = True
        self.lattice.record()
        super()._record()
        self.flying = False

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot from which `restore` continues bit for bit."""
        return {**super().snapshot(), **self._part.snapshot()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore a snapshot; with an equal number of threads, the run continues bit for bit."""
        super().restore(snapshot)
        self._part.restore(snapshot)


class _Lattices(Kept):
    """Takes the lattices' part of a substep; restores the lattices if the substep is rejected."""

    kept = ("_lattice", "_materials")

    def __init__(self, lattice: LatticeSolver, materials: list[Material]) -> None:
        self._lattice, self._materials = lattice, materials
        self.times = (0.0, 0.0)
        """Kick and drift of the substep [s]."""

    def launch(self) -> None:
        """Apply forces and contact impulses, before walls act on the particles' grids."""
        self._lattice.start_step(*self.times)


def copy_points(points: State, state: State, index: NDArray[np.int64]) -> None:
    """Copy the state of the lattices' points into the state of all particles, at `index`."""
    copies = [(getattr(state, name), getattr(points, name)) for name in STATE]
    if len(state.total):
        copies.append((state.total, points.F))
    for array, part in copies:
        values = array.numpy()
        values[index] = part.numpy()
        array.assign(values)


def part_of_bodies(
    model: Model, bodies: Sequence[int], still: Sequence[int]
) -> tuple[Model, NDArray[np.int64]]:
    """Return a model of `bodies`, in this order, and the particles' indices in `model`.

    The bodies `still` never move.
    """
    groups, runs, start = [], [], 0
    for place, body in enumerate(bodies):
        for group in model.groups:
            if group.body == body:
                stop = start + len(group)
                groups.append(replace(group, start=start, stop=stop, body=place))
                runs.append(np.arange(group.start, group.stop))
                start = stop
    index = np.concatenate(runs)
    laws = {group.law.name for group in groups}
    names = tuple(model.names[body] for body in bodies) if model.names else ()

    def chosen(array: wp.array) -> wp.array:
        return model.array(array.numpy()[index], model.real)

    part = replace(
        model,
        rest=model.rest[index],
        mass=chosen(model.mass),
        volume=chosen(model.volume),
        history=model.history[index],
        groups=tuple(groups),
        materials=tuple(m for m in model.materials if m.device_law.name in laws),
        held=frozenset(place for place, body in enumerate(bodies) if body in still),
        wet=frozenset(),
        names=names,
        whole=model,
    )
    return part, index
