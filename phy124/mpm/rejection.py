"""Step rejection: a substep that may be too long is run as a trial, and shortened if necessary.

Before the gather, a substep changes only velocities of particles on which forces act. A substep can
therefore be rejected after the grid update, at the cost of one scatter. Substeps are run as trials
only near the limits of speed and gradient, under forces on particles, or under a very large
acceleration.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import warp as wp

from phy124.kernels.grid import make_grid_speed
from phy124.kernels.profile import JOINS, LIMITED
from phy124.mpm.clock import MEASURE_EVERY, Clock
from phy124.mpm.grid import Grid
from phy124.mpm.model import Model, State
from phy124.mpm.stage import Stage, Sums
from phy124.mpm.timestep import CELLS_PER_STEP, STRAIN_PER_STEP, TRAVEL
from phy124.mpm.tracks import Tracks

TRIES = 100
"""Largest number of trials for a substep; each is at most half as long as the previous trial."""
FIRST = 4
"""Number of trial substeps at the start of a run if a force may change velocities suddenly."""
PULL = 0.1
"""A substep is run as a trial if forces may displace a particle by more than this [cells]."""
ROUNDED = 1 - 1e-6
"""The bounds of forces and walls also cover this fraction of the previous frame. If the bounds
covered the whole previous frame, rounding errors could add forces that ended just before that
frame.
"""


class StepRejection:
    """Decides which substeps are run as trials, and runs the trials."""

    def __init__(
        self,
        model: Model,
        state: State,
        tracks: Tracks,
        pushes: Sequence[Stage],
        accumulators: Sequence[Sums],
    ) -> None:
        self._model, self._tracks, self._accumulators = model, tracks, accumulators
        turning = any(not stage.keeps_C for stage in pushes)
        self._pushed = [state.v, *([state.C] if turning else [])] if pushes else []
        self._fastest = wp.zeros(1, dtype=model.real, device=model.device)
        self.pressed = 0.0
        """Largest acceleration of a particle due to the pressure of a liquid [m/s^2]."""
        self._pushes = pushes
        self.begin(-math.inf, math.inf)
        self._pushy = any(stage.sudden for stage in pushes)
        self.rejected = 0
        """Number of trial substeps that have been rejected."""

    def keep(self, sums: Sums) -> None:
        """From now on, also restore these sums after each rejected substep."""
        self._accumulators = [*self._accumulators, sums]

    def begin(self, start: float, end: float) -> None:
        """Compute upper bounds of forces and wall speeds from `start` to `end` [s].

        Forces and walls outside the interval are ignored, so that a push does not shorten the
        substeps of another frame. A kick includes half of the previous substep, so the bounds also
        cover one frame before `start`.
        """
        before = start - ROUNDED * (end - start) if math.isfinite(start) else start
        largest = _max_acceleration(self._model, self._tracks, self._pushes, before, end)
        self.acceleration = largest + self.pressed
        """Upper bound of the acceleration of particles by forces [m/s^2]."""
        tops = [stage.top_speed(before, end) for stage in self._pushes if stage.top_speed]
        self.wall = max(_max_rate(self._tracks, before, end), *tops, 0.0)
        """Largest speed of a wall or stream [m/s]; a particle may reach it in a single substep."""
        self._changing = any(track.changes(before, end) for track in self._tracks.tracks)

    def sudden(self, clock: Clock) -> bool:
        """Return whether a force may change velocities abruptly in the next substep."""
        return self._pushy and (self._changing or clock.substeps < FIRST)

    def must_try(self, clock: Clock, dt: float, *, flying: bool = False) -> bool:
        """Return whether a substep may move a particle or a wall too far.

        The estimate is based on the last measurement. If `flying` is true, no force, wall or body
        is near the window, so that high speeds do no harm.
        """
        extremes, dx = clock.extremes, self._model.dx
        fast = 2 * max(extremes.speed, self.wall) * dt > CELLS_PER_STEP * dx
        return (
            (fast and not flying)
            or 2 * extremes.gradient * dt > STRAIN_PER_STEP
            or self.acceleration * dt * dt > PULL * dx
            or self.sudden(clock)
        )

    def interval(self, clock: Clock, calm: float) -> int:
        """Return the number of substeps between two measurements of speeds.

        The number in the user's options is returned if it is safe. Up to the strain `calm`, no
        material stiffens significantly.
        """
        every, extremes, dx = clock.measure_every, clock.extremes, self._model.dx
        if every <= MEASURE_EVERY or not extremes.stiffness > 0:
            return min(every, MEASURE_EVERY)
        speed, pulled = max(extremes.speed, self.wall), math.sqrt(self.acceleration)
        # A wall or a body that moves into the next cell by a fraction of a cell strains the cell by
        # this fraction.
        each = clock.stable().dt * max(
            speed / (calm * dx), clock.strain_rate / calm, pulled / math.sqrt(2 * calm * dx)
        )
        return every if each * every <= 1 else max(MEASURE_EVERY, int(1 / each))

    def room(self, clock: Clock) -> int:
        """Return the number of substeps in which no particle can leave the margin of its window.

        In substep k, a particle moves by at most `(v + k a dt) dt`. The term `a dt^2` is limited to
        `PULL` cells, because substeps with a larger term are run as trials.
        """
        dx, dt = self._model.dx, clock.stable().dt
        if not math.isfinite(dt):
            return 1
        gain = min(self.acceleration * dt * dt, PULL * dx)
        first = clock.extremes.speed * dt + gain / 2
        left = max(TRAVEL * dx - clock.travel, 0.0)
        root = first + math.sqrt(first * first + 2 * gain * left)
        return int(min(2 * left / root, clock.measure_every)) if root > 0 else clock.measure_every

    def attempt(
        self, dt: float, scatter: Callable[[float], None], grids: Sequence[Grid]
    ) -> tuple[float, bool]:
        """Scatter and update with ever shorter substeps until no node moves more than a cell.

        Args:
            dt: Length of the first trial [s].
            scatter: Function that applies forces, scatters and updates the grid for a substep of a
                given length [s].
            grids: The grids; the largest speed of nodes decides whether a trial is accepted.

        Returns:
            The accepted length [s], and whether the substep was violent. A substep is violent if a
            node moves by more than half of the allowed `CELLS_PER_STEP`.
        """
        before = [wp.clone(array) for array in self._pushed]
        sums = [accumulator.snapshot() for accumulator in self._accumulators]
        cells = 0.0
        for _ in range(TRIES):
            scatter(dt)
            cells = self._speed(grids) * dt / self._model.dx
            if cells <= 1:
                break
            self.rejected += 1
            for array, kept in zip(self._pushed, before, strict=True):
                wp.copy(array, kept)
            for accumulator, kept in zip(self._accumulators, sums, strict=True):
                accumulator.restore(kept)
            dt *= min(0.5, CELLS_PER_STEP / cells)
        return dt, 2 * cells > CELLS_PER_STEP

    def _speed(self, grids: Sequence[Grid]) -> float:
        self._fastest.zero_()
        kernel, device = make_grid_speed(self._model.real), self._model.device
        for grid in grids:
            wp.launch(kernel, grid.count, [grid.nodes], [self._fastest], device=device)
        return math.sqrt(float(np.asarray(self._fastest.numpy())[0]))


def _max_acceleration(
    model: Model, tracks: Tracks, pushes: Sequence[Stage], start: float, end: float
) -> float:
    """Return an upper bound [m/s^2] of the acceleration that forces cause in a time interval."""
    joined, alone = 0.0, 0.0
    for track, flag in zip(tracks.tracks, tracks.flags, strict=True):
        # Tracks without flags are displacements of walls.
        value = track.largest(start, end) if flag and not flag & LIMITED else 0.0
        joined, alone = (joined + value, alone) if flag & JOINS else (joined, alone + value)
    if not pushes:
        return joined
    if any(stage.in_newtons for stage in pushes):
        alone /= min(1.0, float(model.mass.numpy().min()))
    limits = [stage.limit(start, end) for stage in pushes if stage.limit]
    return joined + alone + sum(limits)


def _max_rate(tracks: Tracks, start: float, end: float) -> float:
    """Return the largest speed [m/s] of a wall in a time interval."""
    flagged = zip(tracks.tracks, tracks.flags, strict=True)
    return max((track.fastest(start, end) for track, flag in flagged if not flag), default=0.0)
