"""Repair: resets particles with invalid deformations to their rest shape.

A few particles at a corner may be inverted although all other particles are valid. Particles with
deformations that no law can handle are reset to F = I and counted. In plastic and fluid material
F_total grows without bound, so its norm is limited.
"""

from collections.abc import Iterable, Iterator
from typing import Any

import warp as wp

from phy124.kernels.diagnostics import make_limit_total, make_reset
from phy124.kernels.transfer import Law
from phy124.mpm.clock import Clock
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model, State

SOUND_J = (1e-5, 1e6)
"""Range of valid volume ratios; a particle outside this range is reset and counted."""
SOUND_F = 1e3
"""Largest valid norm of a deformation gradient."""
NARROWEST = 1e-5
"""If the ratio of the smallest to the largest stretch is smaller, the volume ratio may be wrong."""
MAX_TOTAL = 1e6
"""Largest norm of the total deformation gradient F_total. The visible shape of a particle already
stops growing at a stretch of 4.
"""
AFTER_STRAIN = 1.0
"""Deformations are checked again after this strain (the sum of |C| dt over substeps)."""
NO_PARTICLE = 2**31 - 1
"""A number that is larger than the index of any particle."""


class Repair(Kept):
    """Repairs the deformations of a run's particles, after the first call of `begin`.

    Call `begin` and `end` for each frame; the solver calls `substep`.
    """

    kept = ("count", "first")

    def __init__(self, model: Model, state: State, *, needed: bool = True) -> None:
        """Record the kernel launches that repair particles.

        Deformations on lattices need no repair, since they are computed from the nodes.
        """
        self.count, self.first = 0, NO_PARTICLE
        """Number of particles reset in finished frames, and the lowest index of such particles."""
        self._resets = wp.zeros(2, dtype=int, device=model.device)
        real, limits = model.real, [*SOUND_J, SOUND_F, NARROWEST]
        outputs, count = [state.F, state.C, self._resets], len(model) if needed else 0
        self._reset = model.launch(make_reset(real), count, limits, outputs)
        inputs, flowing = [MAX_TOTAL, state.F], len(state.total)
        self._limit = model.launch(make_limit_total(real), flowing, inputs, [state.total])
        self._started, self._strain, self._last = False, 0.0, 0.0

    def begin(self, clock: Clock) -> None:
        """Repair the deformations of the particles at the start of each attempt at a frame."""
        self._resets.assign([self.count, self.first])
        self._launch(self._reset)
        self.count, self.first = self._resets.numpy().tolist()
        self._started, self._strain, self._last = True, 0.0, clock.time

    def substep(self, clock: Clock) -> None:
        """Repair deformations if the strain since the last check exceeds `AFTER_STRAIN`."""
        if not self._started:
            return
        self._strain += clock.extremes.gradient * (clock.time - self._last)
        self._last = clock.time
        if self._strain > AFTER_STRAIN:
            self._launch(self._reset)
            self._launch(self._limit)
            self._strain = 0.0

    def end(self) -> None:
        """Finish a frame: read the number of repaired particles, and limit F_total."""
        self.count, self.first = self._resets.numpy().tolist()
        self._launch(self._limit)

    @staticmethod
    def _launch(launch: wp.Launch | None) -> None:
        if launch is not None:
            launch.launch()


def kernels(laws: Iterable[Law], real: Any) -> Iterator[Any]:
    """Yield the kernels that reset particles and, if a law is plastic, limit F_total."""
    yield make_reset(real)
    if any(law.project is not None for law in laws):
        yield make_limit_total(real)
