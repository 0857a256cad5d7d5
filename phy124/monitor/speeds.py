"""Speeds: notes which materials moved too fast for their law or for their simulated stiffness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Frame
from phy124.materials import Material
from phy124.monitor.diagnostics import compute_speeds
from phy124.monitor.observer import Observed, Observer, Subject

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver


class Speeds(Observer):
    """Measures the largest speed of each material.

    Within a frame, only the largest speed of all particles is known. It is attributed to the
    material that is fastest at the start or at the end of the frame.
    """

    kept = ("_fastest", "_last")

    def __init__(self, materials: Sequence[Material], material: NDArray) -> None:
        """Store the materials and the index of each particle's material, `material` [P]."""
        self._materials, self._material = materials, material
        self._fastest = np.zeros(len(materials))
        """Largest speed of each material in all valid frames [M], m/s."""
        self._attempted = 0.0
        """Largest speed in the current attempt to compute a frame [m/s]."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether any material has a note about its speed."""
        return any(section.notes_at(math.inf) for section in subject.materials)

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        return cls(setup.subject.materials, setup.particles.material)

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Measure the speeds at the start."""
        self._solver = solver
        self._last = self._measure()

    def before_attempt(self, *, closely: bool = False) -> None:
        """Forget the speeds of an earlier attempt."""
        self._attempted = 0.0

    def after_substep(self) -> None:
        """Store the largest speed of all particles in the attempt."""
        # The clock also measures free solids, which are not particles.
        if not self._solver.free.all:
            self._attempted = max(self._attempted, self._solver.clock.recent.speed)

    def after_frame(self, frame: Frame) -> Frame:
        """Count the speeds of the last attempt, because its frame is valid."""
        now = self._measure()
        ends = np.maximum(self._last, now)
        self._fastest = self._with_attempt(np.maximum(self._fastest, ends), ends)
        self._last, self._attempted = now, 0.0
        return frame

    def notes(self) -> list[str]:
        """Return the notes of the fastest material of each law."""
        fastest = self._with_attempt(self._fastest, self._last)
        noted: dict[type, list[str]] = {}
        for number in np.argsort(-fastest, kind="stable").tolist():
            section = self._materials[number]
            if notes := section.notes_at(float(fastest[number])):
                noted.setdefault(type(section), notes)
        return [note for notes in noted.values() for note in notes]

    def _measure(self) -> NDArray[np.float64]:
        """Return the largest speed of each material at present [M], m/s."""
        fastest = np.zeros(len(self._materials))
        np.maximum.at(fastest, self._material, compute_speeds(self._solver.state))
        return fastest

    def _with_attempt(
        self, fastest: NDArray[np.float64], ends: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        raised = fastest.copy()
        first = int(ends.argmax())
        raised[first] = max(raised[first], self._attempted)
        return raised
