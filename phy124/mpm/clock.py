"""Clock: what time it is, how long the next substep may be, and what limits it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from phy124.mpm.model import Model
from phy124.mpm.timestep import Extremes, Substep, stable_substep

MEASURE_EVERY = 4
"""Substeps between two measurements of the stability limits."""


class Clock:
    """The time of one run, on the host and on its device."""

    def __init__(
        self, model: Model, *, ceiling: float = math.inf, measure_every: int = MEASURE_EVERY
    ) -> None:
        self.dx, self.viscous, self._device = model.dx, model.viscous, model.device
        self.cfl, self.ceiling = model.cfl, ceiling
        """Fraction of the elastic limit that is used, and the longest substep allowed [s]."""
        self.measure_every = measure_every
        """Substeps between two measurements, as chosen by the user."""
        self.time, self.substeps, self.last_dt = 0.0, 0, 0.0
        """Time [s], substeps taken, length of the last one [s]."""
        self.limiters: dict[str, int] = {}
        """Number of substeps that each limit determined."""
        self.needed: dict[str, float] = {}
        """The same before rounding up to whole substeps in each frame: a substep counts as its
        length in units of what its limit allowed."""
        self.extremes = self.recent = Extremes(0.0, 0.0, 0.0)
        """The values that limit substeps, as measured last; and their maxima over the substeps
        since the host looked last, which are several if the device takes them alone."""
        self.strain_rate = 0.0
        """The largest |C| of late [1/s]; a vibration may just be at its turning point, where it is
        zero."""
        self.interval = self.since_measured = min(measure_every, MEASURE_EVERY)
        """Substeps between two measurements at present, and substeps since the last one."""
        self.values = wp.zeros(3, dtype=model.real, device=model.device)
        """On the device: kick and drift of the current substep, and the time before it [s]."""

    @property
    def due(self) -> bool:
        """Whether the limits must be measured before the next substep."""
        return self.since_measured >= self.interval

    def stable(self) -> Substep:
        """The longest stable substep in the current state."""
        limits = {"cfl": self.cfl, "ceiling": self.ceiling, "viscous": self.viscous}
        return stable_substep(self.extremes, self.dx, **limits)

    def begin(self, kick: float, drift: float) -> None:
        """Tell the device the length of a substep [s].

        Args:
            kick: For velocities.
            drift: For positions and F.
        """
        values = (kick, drift, self.time)
        if self._device == "cpu":
            self.values.numpy()[:] = values
        else:
            self.values.assign(np.array(values))

    def finish(self, drift: float, *, violent: bool = False) -> None:
        """Count a substep of length `drift` [s]; after a violent one the limits are remeasured."""
        self.time += drift
        self.substeps += 1
        self.since_measured += self.interval if violent else 1

    def count(self, limiter: str, substeps: int = 1, *, needed: float) -> None:
        """Count substeps that a limit determined; `needed` is their sum before rounding up."""
        self.limiters[limiter] = self.limiters.get(limiter, 0) + substeps
        self.needed[limiter] = self.needed.get(limiter, 0.0) + needed

    def snapshot(self) -> dict[str, Any]:
        """The state to continue from, as plain data."""
        return {
            "time": self.time,
            "last_dt": self.last_dt,
            "substeps": self.substeps,
            "since_measured": self.since_measured,
            "interval": self.interval,
            "strain_rate": self.strain_rate,
            "extremes": list(self.extremes),
            "limiters": dict(self.limiters),
            "needed": dict(self.needed),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self.time, self.last_dt = snapshot["time"], snapshot["last_dt"]
        self.substeps, self.since_measured = snapshot["substeps"], snapshot["since_measured"]
        self.interval = snapshot.get("interval", MEASURE_EVERY)
        self.strain_rate = snapshot.get("strain_rate", 0.0)
        self.extremes = self.recent = Extremes(*snapshot["extremes"])
        self.limiters, self.needed = dict(snapshot["limiters"]), dict(snapshot["needed"])
