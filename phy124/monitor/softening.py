"""Softening: changes Young's modulus over time, frame by frame.

The factor multiplies the parameters of a law that are proportional to E (`Material.scaled`). The
resulting change of the elastic energy counts as external work, since stiffening increases the
energy of a bent body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.observer import Observed, Observer, Subject, find
from phy124.mpm.model import Group
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver


class Softening(Observer):
    """Multiplies Young's moduli by a factor that changes in time."""

    def __init__(self, scene: Scene, material: NDArray) -> None:
        """Store the scene and the index of each particle's material, `material` [P]."""
        self._scene, self._material = scene, material
        self.factor = 1.0

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the stiffness may change."""
        return subject.changes or subject.scene.stiffness_profile is not None

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        return cls(setup.scene, setup.particles.material)

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Store the parameters for the factor 1."""
        self._solver, self._external = solver, find(observers, ExternalWork)
        model = solver.model
        scaled = np.array([section.scaled for section in model.materials])[self._material]
        self._groups: list[tuple[Group, NDArray, NDArray]] = []
        for group in model.groups:
            theta: NDArray = np.array(group.theta.numpy())
            columns = scaled[group.particles][: len(theta)]
            self._groups.append((group, theta, np.arange(group.law.width) < columns[:, None]))

    def change(self, scene: Scene) -> None:
        """Use the stiffness of another scene from now on."""
        self._scene = scene

    def before_frame(self, time: float) -> None:
        """Set the factor for the frame that starts at `time` [s]."""
        self.follow(self._scene.softness(time))

    def follow(self, factor: float) -> None:
        """Set the factor; add the change of energy to the external work."""
        if factor == self.factor:
            return
        before = diagnose(self._solver).elastic
        self._multiply(factor)
        if self._external is not None:
            self._external.store(diagnose(self._solver).elastic - before)
        # The stable substep has changed, so the limits must be measured again.
        self._solver.clock.expire()

    def notes(self) -> list[str]:
        """Return a note if the stiffness profile repeats in less than the time of two frames."""
        profile, fps = self._scene.stiffness_profile, self._scene.time.fps
        if profile is None or not 0 < profile.period < 2 / fps:
            return []
        return [
            f"stiffness_profile repeats every {profile.period:.2g} s and is read once at the start "
            f"of each frame, every {1 / fps:.2g} s; changes between two frames are "
            "missed. A larger time.fps resolves these changes."
        ]

    def snapshot(self) -> dict[str, Any]:
        """Return the factor."""
        return {"factor": self.factor}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Set the factor without adding work, since the restored state includes the work."""
        self._multiply(snapshot["factor"])

    def _multiply(self, factor: float) -> None:
        self.factor = self._solver.softened = factor
        for group, theta, varies in self._groups:
            group.theta.assign(np.where(varies, factor * theta, theta).astype(theta.dtype))
