"""External work: impulse and work that forces and walls give a run, summed in every substep.

Forces on particles and walls are bracketed: velocities are kept before they act and compared
after. A uniform acceleration gives M a dt and M a . dx, which needs no launch; where it varies in
time, a kernel of one thread closes each substep with its impulse and work.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries.base import Corners, swept
from phy124.kernels import diagnose
from phy124.kernels.reduction import shared_out

if TYPE_CHECKING:
    from phy124.mpm import Attachable, Solver, Stage


BOOKS = "books"
"""Name of the stages that sum it."""
KINDS = ("push", "wall", "uniform")
"""What is summed apart: forces on particles, walls, and a uniform acceleration that varies."""
_WALLS = (("wall", False), ("wall", True))
"""Pages of the walls, by lane."""


class Given(NamedTuple):
    """What came from outside since the start."""

    impulse: NDArray[np.float64]
    """[3], N s."""
    work: float
    """J."""
    moved: float
    """Sum of the sizes of all impulses, N s."""
    turned: float
    """Sum of the sizes of all works, J."""


class ExternalWork:
    """Books of one run; hand `forces` and `boundaries` to its solver."""

    def __init__(self) -> None:
        self._pages: dict[Any, wp.array] = {}
        self._closed = {kind: np.zeros(diagnose.GIVEN) for kind in KINDS}
        self._walls: Sequence[Any] = ()
        self._begun = np.zeros(3)
        self._kicked = 0.0

    def forces(self, forces: Sequence[Attachable]) -> list[Attachable]:
        """The forces, bracketed."""
        return [_Bracket(self._push, -1), *forces, _Bracket(self._push, 1)] if forces else []

    def boundaries(self, boundaries: Sequence[Attachable]) -> list[Attachable]:
        """The boundaries, bracketed."""
        if not boundaries:
            return []
        self._walls = boundaries
        return [_Bracket(self._wall, -1), *boundaries, _Bracket(self._wall, 1)]

    def open(self, solver: Solver) -> None:
        """Begin to count with the present state of the solver."""
        self.restore({kind: np.zeros(diagnose.GIVEN) for kind in KINDS})
        if solver.tracks.vary:
            self._base, self._walls_before = (
                wp.zeros(3, dtype=wp.float64, device=solver.device) for _ in range(2)
            )
            solver.closings.append((BOOKS, lambda: self._close(solver)))
        self._kicked = solver.time - solver.last_dt / 2
        solver.rejection.books = self

    def mark(self) -> dict[Any, NDArray[Any]]:
        """The open sums; for a substep that may be taken back."""
        return {key: np.array(page.numpy()) for key, page in self._pages.items()}

    def undo(self, mark: dict[Any, NDArray[Any]]) -> None:
        """Go back to the open sums of a mark."""
        for key, page in self._pages.items():
            page.assign(mark[key])

    def total(self, solver: Solver, way: NDArray[np.float64]) -> Given:
        """What was given so far; `way` is mass times position since the start [kg m]."""
        given = self._all()
        if not solver.tracks.vary:
            a, mass = _acceleration(solver), total_mass(solver)
            impulse = mass * a * (solver.time - solver.last_dt / 2 - self._kicked)
            work = float(a @ way)
            given = given + np.array([*impulse, work, np.linalg.norm(impulse), abs(work)])
        return Given(given[:3], *given[3:].tolist())

    def begin(self, solver: Solver, momentum: NDArray[np.float64]) -> None:
        """A frame begins with this momentum: the work of what varies depends on it."""
        if solver.tracks.vary:
            self._begun = momentum - self._all()[:3]
            self._set_base()

    def snapshot(self) -> dict[str, NDArray]:
        """What `restore` needs."""
        return {kind: self._all(kind) for kind in KINDS}

    def restore(self, snapshot: dict[str, NDArray]) -> None:
        """Go back to a snapshot."""
        # Pauses of earlier builds know no sum of all works.
        missing = {kind: (0, diagnose.GIVEN - len(sums)) for kind, sums in snapshot.items()}
        self._closed = {kind: np.pad(sums, missing[kind]) for kind, sums in snapshot.items()}
        for page in self._pages.values():
            page.zero_()

    def memory(self) -> dict[str, Any]:
        """What `recall` needs, as plain data."""
        sums = {kind: sums.tolist() for kind, sums in self.snapshot().items()}
        return {"sums": sums, "kicked": self._kicked, "begun": self._begun.tolist()}

    def recall(self, memory: dict[str, Any]) -> None:
        """Go on as when `memory` was taken, after `open`."""
        self.restore({kind: np.array(sums) for kind, sums in memory["sums"].items()})
        self._kicked, self._begun = memory["kicked"], np.array(memory["begun"])

    def _all(self, *kinds: str) -> NDArray[np.float64]:
        """All sums so far, or only those of pushes or of walls."""
        total = np.zeros(diagnose.GIVEN)
        for kind in kinds or KINDS:
            total += self._closed[kind]
        for key, page in self._pages.items():
            if key[0] in (kinds or KINDS):
                total += page.numpy()
        return total

    def _page(self, key: tuple[Any, ...], solver: Solver) -> wp.array:
        """Sums of one launch's own, so that two threads never add to the same."""
        if key in self._pages:
            self._closed[key[0]] = self._closed[key[0]] + self._pages[key].numpy()
        self._pages[key] = wp.zeros(diagnose.GIVEN, dtype=wp.float64, device=solver.device)
        return self._pages[key]

    def _close(self, solver: Solver) -> wp.Launch | None:
        """The launch that ends a substep with the books of the uniform acceleration."""
        page = self._page(("uniform",), solver)
        self._set_base()
        none = wp.zeros(diagnose.GIVEN, dtype=wp.float64, device=solver.device)
        pages = [self._pages.get(key, none) for key in (("push",), *_WALLS)]
        inputs = [total_mass(solver), solver.clock, solver.tracks.values, self._base, *pages]
        kernel = diagnose.make_uniform_sums(solver.real)
        return solver.record(kernel, 1, inputs, [self._walls_before, page])

    def _set_base(self) -> None:
        """Momentum without what the open pages hold; the walls' last impulse is on theirs."""
        closed = sum(self._closed[kind][:3] for kind in KINDS)
        self._base.assign(self._begun + closed)
        walls = [self._pages[key].numpy()[:3] for key in _WALLS if key in self._pages]
        self._walls_before.assign(np.sum(walls, axis=0) if walls else np.zeros(3))

    def _push(self, solver: Solver, sign: int) -> wp.Launch | None:
        if all(name == BOOKS for name, _ in solver.pushes):
            return None
        state, count = solver.state, len(solver.rest)
        if sign < 0:
            self._kept = [wp.empty_like(state.v), wp.empty_like(state.C)]
            kernel = diagnose.make_push_copy(solver.real)
            return solver.record(kernel, count, [state.v, state.C], self._kept)
        threads, *share = shared_out(count, solver.device)
        inputs = [*share, solver.mass, solver.dx, state.v, state.C, *self._kept]
        kernel = diagnose.make_push_sums(solver.real)
        return solver.record(kernel, threads, inputs, [self._page(("push",), solver)])

    def _wall(self, solver: Solver, sign: int) -> wp.Launch | None:
        grid, real = solver.grid, solver.real
        if sign < 0:
            start, extent = grid.nodes_within(*self._reach(solver))
            corners = np.stack([start, extent]).astype(np.int32)
            box = wp.array(corners, dtype=wp.vec3i, device=solver.device)
            kept = wp.empty(int(np.prod(extent)), dtype=grid.vec4, device=solver.device)
            self._copied = (box, kept, tuple(extent[:2].tolist()))
        box, kept, rows = self._copied
        read: list[Any] = [box, grid.window, grid.nodes]
        if sign < 0:
            return solver.record(diagnose.make_wall_copy(real), rows, read, [kept])
        page = self._page(("wall", bool(grid.share and grid.share[0] > 0)), solver)
        return solver.record(diagnose.make_wall_sums(real), rows, [*read, kept], [page])

    def _reach(self, solver: Solver) -> Corners:
        """A box that holds every node that a wall may touch [m]."""
        lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
        for wall in self._walls:
            corners, track = wall.bounds(solver), wall.track(solver)
            if track is not None:
                corners = swept(corners, track)
            lower, upper = np.minimum(lower, corners[0]), np.maximum(upper, corners[1])
        return lower, upper


def total_mass(solver: Solver) -> float:
    """Mass of all particles, kg."""
    return float(np.sum(solver.mass.numpy(), dtype=np.float64))


def _acceleration(solver: Solver) -> NDArray[np.float64]:
    """The uniform acceleration of the last substep [3], m/s^2."""
    values: NDArray[Any] = solver.tracks.values.numpy()
    return values[0, :3].astype(np.float64)


class _Bracket:
    """One side of a bracket, attached as if it were a force or a boundary."""

    def __init__(self, record: Callable[[Solver, int], wp.Launch | None], sign: int) -> None:
        self._record, self._sign = record, sign

    def attach(self, solver: Solver) -> list[Stage]:
        """One stage."""
        return [(BOOKS, lambda: self._record(solver, self._sign))]
