"""Softening: Young's modulus that changes in time, frame by frame.

The parameters of a law that are proportional to E (`Material.scaled`) are multiplied where the
solver reads them. What the elastic energy changes by at that moment is external work: whoever
stiffens a bent thing stores energy in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import ExternalWork
from phy124.mpm import Solver
from phy124.mpm.model import Group
from phy124.scene import Scene


class Softening:
    """The factor on Young's modulus of one run."""

    def __init__(self, solver: Solver, external: ExternalWork, material: NDArray) -> None:
        """Remember the parameters at factor 1.

        Args:
            solver: The solver of the run.
            external: Where the work is added.
            material: Index into the model's materials of each particle [P].
        """
        self._solver, self._external = solver, external
        self.factor = 1.0
        """The factor now."""
        model = solver.model
        scaled = np.array([section.scaled for section in model.materials])[material]
        self._groups: list[tuple[Group, NDArray, NDArray]] = []
        for group in model.groups:
            theta: NDArray = np.array(group.theta.numpy())
            own = scaled[group.particles][: len(theta)]
            self._groups.append((group, theta, np.arange(group.law.width) < own[:, None]))

    def follow(self, factor: float) -> None:
        """Go on with another factor from now on, and count the work."""
        if factor == self.factor:
            return
        before = diagnose(self._solver).elastic
        self.restore(factor)
        self._external.store(diagnose(self._solver).elastic - before)
        # The limit of the substep is another one.
        self._solver.clock.since_measured = self._solver.clock.interval

    def restore(self, factor: float) -> None:
        """Return to a factor, with a state in which it acted already."""
        self.factor = factor
        for group, theta, varies in self._groups:
            group.theta.assign(np.where(varies, factor * theta, theta).astype(theta.dtype))


def notes(scene: Scene) -> list[str]:
    """A sentence if the stiffness is to repeat faster than frames follow each other."""
    profile = scene.stiffness_profile
    if profile is None or not 0 < profile.period < 2 / scene.time.fps:
        return []
    return [
        f"stiffness_profile repeats every {profile.period:.2g} s and is read once at the start of "
        f"each frame, every {1 / scene.time.fps:.2g} s: what happens in between is not seen. A "
        "larger time.fps sees it."
    ]
