"""Spectrum: measures the largest angular frequency of the bodies by power iteration.

The largest frequency limits the substep.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice.nodes import RECENT
from phy124.kernels.launches import reader
from phy124.lattice.crew import Crew
from phy124.lattice.rest import RestLattice
from phy124.lattice.trials import ACCELERATE, COMPARE, TRIAL, TRY, Trials
from phy124.lattice.walls import Nodes
from phy124.mpm.model import Model

ROUNDS, DAMPED, SMALL = 60, 8, 1e-3
"""`ROUNDS`: number of power iterations for the largest frequency at rest. `DAMPED`: number of
further iterations for the largest rate of damping. `SMALL`: size of the trial displacements in
these iterations [cells].
"""
FOLLOWED, SQUEEZED, UNDAMPED = 5, 1.5, 0.1
"""A measurement of the largest frequency normally takes a single power iteration. The measurement
takes `FOLLOWED` iterations if two conditions hold: the squared frequency exceeds its value at rest
by the factor `SQUEEZED`, and the damping ratio of the fastest vibration is below `UNDAMPED`. The
fastest vibration then moves through the body too fast for single iterations.
"""
MIXED = 0.1
"""Size of the accelerations that are added to the trial shape, relative to the shape."""
STEADY = 0.05
"""Largest relative change of a steady frequency's square between two measurements."""
MISSED = 1.1
"""Factor on squared frequencies, because power iterations underestimate the largest frequency."""


class Spectrum:
    """The largest angular frequency of a body."""

    def __init__(
        self,
        model: Model,
        crew: Crew,
        nodes: Nodes,
        lattice: RestLattice,
        complete: Callable[[int], None],
    ) -> None:
        """Measure the largest frequency of the body at rest."""
        self._model, self._complete = model, complete
        self._nodes = nodes
        self._size = SMALL * model.dx
        start = np.random.default_rng(0).normal(size=(len(lattice), 3))
        start[lattice.tied] = 0
        self._trials = trials = Trials(model, crew, start)
        arrays = trials.a, trials.shape, trials.mixed
        self._read_a, self._read_shape, self._read_mixed = map(reader, arrays)
        v = nodes.lagging.numpy().copy()
        nodes.lagging.zero_()  # Viscous forces must not contribute.
        trials.u.assign(nodes.u)
        complete(TRIAL)
        complete(COMPARE)
        trials.a.assign(trials.after)
        trials.shape.assign(start)
        self._least = MISSED * self._iterate(0.0, ROUNDS)
        if self._least == 0:  # All bodies are fixed, so no node moves; assume unbounded material.
            fastest = max(section.sound_speed() for section in model.materials)
            self._least = (2 * fastest / model.dx) ** 2
        self._delay = 0.0
        """Ratio of viscosity to stiffness in the fastest vibrations of the bodies [s]."""
        if any(math.isfinite(section.viscous_limit(model.dx)) for section in model.materials):
            self._size *= math.sqrt(self._least)
            rate = self._iterate(0.0, DAMPED, velocities=nodes.lagging)
            if len(model.materials) > 1:
                shape = trials.shape.numpy().copy()
                trials.shape.assign(start)
                rate = max(rate, self._iterate(0.0, ROUNDS, velocities=nodes.lagging))
                trials.shape.assign(shape)
            self._size = SMALL * model.dx
            self._delay = MISSED * rate / (2 * self._least)
        nodes.lagging.assign(v)
        self.square = self._least
        """Square of the largest angular frequency, as last measured [1/s^2]."""
        self.steady = False
        """Whether the last two measurements agree, and the fastest vibration is damped."""
        self._stiffened = 1.0

    def stiffen(self, factor: float) -> float:
        """Set the factor on the initial stiffness of all materials, and return `stiffness`.

        A larger factor shortens substeps immediately, because the frequency is measured only after
        a substep. A factor below 1 is ignored, although substeps are then shorter than necessary
        for a body at rest.
        """
        stiffened = max(1.0, factor)
        ratio, self._stiffened = stiffened / self._stiffened, stiffened
        self._least *= ratio
        self._delay /= ratio
        self.square = max(self._least, self.square * max(1.0, ratio))
        return self.stiffness

    @property
    def _damping_ratio(self) -> float:
        return math.sqrt(self.square) * self._delay

    @property
    def stiffness(self) -> float:
        """dx^2 / dt^2 [m^2/s^2], where dt is the longest stable substep in the last measurement."""
        return self.square * (self._model.dx / 2 * _shorten(self._damping_ratio)) ** 2

    @property
    def substep_at_rest(self) -> float:
        """Longest stable substep of the undeformed bodies [s]."""
        z = math.sqrt(self._least) * self._delay
        return 2 / math.sqrt(self._least) / _shorten(z)

    def follow(self) -> None:
        """Measure the largest frequency in the current state, when all forces are summed."""
        self._complete(ACCELERATE)
        largest = float(np.abs(self._read_a()).max())
        share = MIXED / largest if largest > 0 else 0.0
        damped, before = self._damping_ratio >= UNDAMPED, self.square
        hard = before > SQUEEZED * self._least and not damped
        rounds = FOLLOWED if hard else 1
        self.square = max(self._least, MISSED * self._iterate(share, rounds))
        self.steady = damped and abs(self.square - before) < STEADY * before

    def _iterate(self, share: float, rounds: int, velocities: wp.array | None = None) -> float:
        """Return the square of the largest frequency [1/s^2] after some power iterations.

        The accelerations are added to the shape with the factor `share`. If the nodes' velocities
        are passed, velocities are changed instead of displacements, and the result is the largest
        rate of damping [1/s].
        """
        square, peak, trials = 0.0, self._peak(), self._trials
        for _ in range(rounds):
            if not peak > 0:  # In a needle, rounding may remove the only trial motion.
                return square
            trials.prepare(1 / peak, share, self._size)
            self._complete(TRY)
            if velocities is not None:
                still = self._nodes.u.numpy()
                velocities.assign(trials.u.numpy() - still)
                trials.u.assign(still)
            self._complete(TRIAL)
            self._complete(COMPARE)
            peak = self._peak()
            if peak > 0:
                longer = peak * _norm(self._read_shape() * (1 / peak))
                square = longer / _norm(self._read_mixed()) / self._size
        return square

    def _peak(self) -> float:
        return float(np.abs(self._read_shape()).max())

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot of the last measurement."""
        shape, factor = self._trials.shape.numpy().copy(), self._stiffened
        known = {"square": self.square, "steady": self.steady, "stiffened": factor}
        return {"shape": shape, **known}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        self._trials.shape.assign(np.array(snapshot["shape"]))
        self.stiffen(snapshot["stiffened"])
        self.square, self.steady = snapshot["square"], snapshot["steady"]


def _shorten(z: float) -> float:
    """Return the factor by which a damping ratio z shortens stable substeps.

    Viscosity acts on delayed velocities (`RECENT`), so only half of the viscosity damps the
    vibration that limits the substep.
    """
    half = (2 * RECENT - 1) * z
    return math.sqrt(1 + half * half) + half


def _norm(values: NDArray[Any]) -> float:
    """Return the 4-norm of values up to about 1; this norm gives large values a large weight."""
    squares = values * values
    return float(np.vdot(squares, squares)) ** 0.25
