"""Repair: particles whose deformation no law can work with get their shape at rest back.

A few particles at a corner may be turned inside out where the rest of a run is sound. They are
given F = I, and counted. F_total of what flows for ever is held to a largest size.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from phy124.kernels.soundness import make_limit_total, make_reset
from phy124.mpm.clock import Clock
from phy124.mpm.model import Model
from phy124.mpm.state import State

SOUND_J = (1e-5, 1e6)
"""Volume ratios that a law can work with; a particle beyond is reset and counted."""
SOUND_F = 1e3
"""Largest norm of a sound deformation gradient."""
NARROWEST = 1e-5
"""Least ratio of the smallest stretch to the largest: beyond, rounding decides the sign of J."""
MAX_TOTAL = 1e6
"""Norm of F_total that flowing material is held to; what is seen of it stops growing at 4."""
AFTER_STRAIN = 1.0
"""Strain after which deformations are looked at again: |C| dt, summed over the substeps."""
NOBODY = 2**31 - 1


class Repair:
    """Mends the deformations of one run, from the first `begin` on.

    Call `begin` and `end` of each frame; the solver calls `substep`.
    """

    def __init__(self, model: Model, state: State) -> None:
        self.count, self.first = 0, NOBODY
        """How often a particle was reset in frames that were kept, and the lowest index."""
        self._found = wp.zeros(2, dtype=int, device=model.device)
        real, limits = model.real, [*SOUND_J, SOUND_F, NARROWEST]
        outputs = [state.F, state.C, self._found]
        self._reset = model.launch(make_reset(real), len(model), limits, outputs)
        inputs, flowing = [MAX_TOTAL, state.F], len(state.total)
        self._limit = model.launch(make_limit_total(real), flowing, inputs, [state.total])
        self._begun, self._strain, self._seen = False, 0.0, 0.0

    def begin(self, clock: Clock) -> None:
        """Before a frame, or before it is tried again."""
        self._found.assign([self.count, self.first])
        self._launch(self._reset)
        self.count, self.first = self._found.numpy().tolist()
        self._begun, self._strain, self._seen = True, 0.0, clock.time

    def substep(self, clock: Clock) -> None:
        """After a substep: mend again once the material has strained by `AFTER_STRAIN`."""
        if not self._begun:
            return
        self._strain += clock.extremes.gradient * (clock.time - self._seen)
        self._seen = clock.time
        if self._strain > AFTER_STRAIN:
            self._launch(self._reset)
            self._launch(self._limit)
            self._strain = 0.0

    def end(self) -> None:
        """After a frame that is kept."""
        self.count, self.first = self._found.numpy().tolist()
        self._launch(self._limit)

    def snapshot(self) -> dict[str, Any]:
        """What goes on from here, as plain data."""
        return {"count": self.count, "first": self.first}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to a snapshot."""
        self.count, self.first = snapshot["count"], snapshot["first"]

    @staticmethod
    def _launch(launch: wp.Launch | None) -> None:
        if launch is not None:
            launch.launch()
