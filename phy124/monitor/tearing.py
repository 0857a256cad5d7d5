"""Tearing: material that its law keeps whole, stretched until its particles lose each other.

The grid knows nothing of neighbours. Particles hold together because they share nodes, and where
stretching has carried them more than about a cell apart they no longer do: the material parts
though no law said so (numerical fracture). A bar pulled apart holds up to a mean spacing of about
one cell, at which its worst places reach `APART` (docs/results/stability.md). A finer grid does not
help, since it resolves sharper corners, which are stretched more; more particles per cell do.

Two signs are looked for: particles that are stretched so far, and pieces that came off. The first
warns of a tear and misses that of a thin stem, the second is a tear.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from phy124.kernels.stretch import make_apart
from phy124.monitor import diagnosis
from phy124.monitor.pieces import Pieces

if TYPE_CHECKING:
    from phy124.mpm import Solver

APART = 1.2
"""Spacing of particles [cells] from which they may part."""
MANY, FEW = 5e-3, 3
"""So many, in particles of a section through all (P^2/3), are a tear; a few part at any corner.

Of the pressed, dropped and bounced ducks that were looked at, those below 5.2e-3 were whole; one
at 6.7e-3 lost its head, another at 7.9e-3 did not.
"""
REACH = 1.5
"""How far a particle's spline reaches [cells]; nothing holds across a wider empty layer."""
MEMORY = ("count", "first", "stretch", "loose")
"""What a paused run keeps."""
LOOSE, FLAKE = 2e-3, 8
"""Share of the elastic particles, and their least number, that have to come off for a tear."""
REMEDY = (
    "A larger accuracy.ppc, a stiffer material, more material.damping or a gentler motion helps; "
    "a finer grid does not."
)


class Tearing:
    """Follows how far the particles of elastic materials are stretched apart, once per frame.

    What flows (a law with a return mapping) parts and joins as it should and is not looked at.
    """

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        self._elastic = [group for group in solver.groups if group.law.project is None]
        self.count, self.first, self.stretch = 0, 0, 1.0
        """Most particles at once beyond `APART`, the lowest of them, and the greatest stretch."""
        self.loose = 0
        """Most particles at once that were off the piece they belong to."""
        self._chosen = np.zeros(len(solver.rest), bool)
        for group in self._elastic:
            self._chosen[group.start : group.stop] = True
        self._pieces = Pieces(solver.rest[self._chosen], REACH * solver.dx)

    @property
    def torn(self) -> bool:
        """Whether a visible piece came off."""
        return self.loose >= max(FLAKE, LOOSE * int(self._chosen.sum()))

    @property
    def likely(self) -> bool:
        """Whether a piece came off, or enough particles lost their neighbours that one may."""
        return self.torn or self.count > max(FEW, MANY * len(self._solver.rest) ** (2 / 3))

    def memory(self) -> dict[str, Any]:
        """What `recall` needs, as plain data."""
        return {name: getattr(self, name) for name in MEMORY}

    def recall(self, memory: dict[str, Any]) -> None:
        """Go on as when `memory` was taken."""
        for name in MEMORY:
            setattr(self, name, memory[name])

    def look(self) -> None:
        """At the end of a frame."""
        s = self._solver
        found = wp.array([0, len(s.rest)], dtype=int, device=s.device)
        greatest = wp.zeros(1, dtype=s.real, device=s.device)
        for group in self._elastic:
            part = slice(group.start, group.stop)
            inputs = [s.volume[part], APART * s.dx, group.start, s.state.F[part]]
            count = group.stop - group.start
            kernel, outputs = make_apart(s.real), [found, greatest]
            wp.launch(kernel, count, inputs=inputs, outputs=outputs, device=s.device)
        count, first = found.numpy().tolist()
        if count > self.count:
            stretch: Any = greatest.numpy()
            self.count, self.first = count, first
            self.stretch = max(self.stretch, float(np.asarray(stretch)[0]))
        x: Any = s.state.x.numpy()
        whole = self._chosen.all()
        self.loose = max(self.loose, self._pieces.loose(x if whole else x[self._chosen]))

    def note(self) -> str | None:
        """What the user should know, or None."""
        if not self.likely:
            return None
        if self.torn:
            share = self.loose / self._chosen.sum()
            return (
                f"{self.loose} particles ({share:.1%}) came off the piece they belong to: the grid "
                f"tore what the material holds together. {REMEDY}"
            )
        return (
            f"{self.count} particles were stretched, up to {self.stretch:.1f} times, until they "
            f"lay more than {APART} cells apart, first "
            f"{diagnosis.describe(self._solver, self.first)}. "
            f"There the grid may tear what the material holds together. {REMEDY}"
        )

    @property
    def briefly(self) -> str:
        """The same in a few words."""
        if self.torn:
            return "the grid tears the material"
        return f"the material is stretched {self.stretch:.1f} times and the grid may tear it"

    def report(self) -> dict[str, Any]:
        """For the report of the run."""
        return {
            "apart": self.count,
            "stretch": self.stretch,
            "loose": self.loose,
            "likely": self.likely,
        }
