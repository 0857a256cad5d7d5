"""Step rejection: a substep that may be too long is tried first, and repeated shorter if it was.

Nothing but pushed velocities changes before the gather, so a substep can be taken back after the
grid update at the price of one scatter. Only substeps in which something violent may happen are
tried: near the limits of speed and gradient, under forces on particles, or a huge acceleration.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import warp as wp

from phy124.kernels.diagnose import make_grid_speed
from phy124.kernels.profile import JOINS
from phy124.mpm.timestep import CELLS_PER_STEP, STRAIN_PER_STEP

if TYPE_CHECKING:
    from phy124.mpm.solver import Solver

CHECK_EVERY = 4
"""Substeps between two measurements of the stability limits."""
CALM_WAY, CALM_STRAIN = 1.0, STRAIN_PER_STEP
"""Cells and strain that nothing may pass between two measurements that are further apart."""
TRIES = 100
"""Each try is at most half as long as the one before."""
SUDDEN = ("set_velocity", "wind")
"""Stages that may change a velocity at once, whatever their strength."""
PER_MASS = "particle_force"
"""The stage whose strength is in newtons on each particle."""
FIRST = 4
"""Substeps after which what always acts has shown its effect."""


class Books(Protocol):
    """Sums that grow in every substep."""

    def mark(self) -> Any:
        """What they are now."""
        ...

    def undo(self, mark: Any) -> None:
        """Go back to what they were."""
        ...


class StepRejection:
    """Decides which substeps are tried, and tries them."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self._fastest = wp.zeros(1, dtype=solver.real, device=solver.device)
        self.acceleration = _greatest_acceleration(solver)
        """What forces may do to a particle at most [m/s^2]."""
        self.wall = _greatest_rate(solver)
        """How fast a wall moves at most [m/s]."""
        self._pushy = any(name in SUDDEN for name, _ in solver.pushes)
        self.rejected = 0
        """Substeps that were taken back."""
        self.books: Books | None = None
        """What counts during a substep and must be taken back with it."""

    @property
    def sudden(self) -> bool:
        """Whether a force may change velocities at once in the next substep."""
        return self._pushy and (self._solver.tracks.vary or self._solver.substeps < FIRST)

    def called_for(self, dt: float) -> bool:
        """Whether a substep of length `dt` may carry something further than a cell."""
        s, extremes = self._solver, self._solver.extremes
        return (
            2 * max(extremes.speed, self.wall) * dt > CELLS_PER_STEP * s.dx
            or 2 * extremes.gradient * dt > STRAIN_PER_STEP
            or self.acceleration * dt * dt > 0.1 * s.dx
            or self.sudden
        )

    def pause(self, every: int) -> int:
        """Substeps until limits are measured again: `every`, if nothing gets far until then."""
        s = self._solver
        if every <= CHECK_EVERY or s.alone or not s.extremes.stiffness > 0:
            return min(every, CHECK_EVERY)
        speed, pulled = max(s.extremes.speed, self.wall), math.sqrt(self.acceleration)
        each = s.substep().dt * max(
            speed / (CALM_WAY * s.dx),
            s.extremes.gradient / CALM_STRAIN,
            pulled / math.sqrt(2 * CALM_WAY * s.dx),
        )
        return every if each * every <= 1 else max(CHECK_EVERY, int(1 / each))

    def step(self, dt: float) -> float:
        """A substep of at most `dt`, so short that no node moves more than a cell; its length."""
        s, cells = self._solver, 0.0
        pushed = [s.state.v, s.state.C] if s.pushes else []
        before = [wp.clone(array) for array in pushed]
        page = self.books and self.books.mark()
        for _ in range(TRIES):
            s.begin((s.last_dt + dt) / 2, dt)
            s.work((0, 1))
            cells = self._speed() * dt / s.dx
            if cells <= 1:
                break
            self.rejected += 1
            for array, kept in zip(pushed, before, strict=True):
                wp.copy(array, kept)
            if self.books:
                self.books.undo(page)
            dt *= min(0.5, CELLS_PER_STEP / cells)
        s.work((2,))
        s.finish(dt, violent=2 * cells > CELLS_PER_STEP)
        return dt

    def _speed(self) -> float:
        """The greatest speed of a node [m/s]."""
        s = self._solver
        self._fastest.zero_()
        kernel = make_grid_speed(s.real)
        wp.launch(kernel, s.grid.count, [s.grid.nodes], [self._fastest], device=s.device)
        return math.sqrt(float(np.asarray(self._fastest.numpy())[0]))


def _greatest_acceleration(solver: Solver) -> float:
    """An upper bound of what forces may do to a particle at any time [m/s^2]."""
    joined, alone = 0.0, 0.0
    for track, flag in zip(solver.tracks.tracks, solver.tracks.flags, strict=True):
        value = max(math.hypot(*value) for _, value in track.keys)
        joined, alone = (joined + value, alone) if flag & JOINS else (joined, alone + value)
    if not solver.pushes:
        return joined
    if any(name == PER_MASS for name, _ in solver.pushes):
        alone /= min(1.0, float(solver.mass.numpy().min()))
    return joined + alone


def _greatest_rate(solver: Solver) -> float:
    """How fast a wall moves at most [m/s]."""
    fastest = 0.0
    for track, flag in zip(solver.tracks.tracks, solver.tracks.flags, strict=True):
        for (start, a), (end, b) in itertools.pairwise(track.keys) if not flag else ():
            if end > start:
                fastest = max(fastest, math.dist(a, b) / (end - start))
    return fastest
