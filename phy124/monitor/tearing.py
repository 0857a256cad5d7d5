"""Tearing: numerical fracture of material that its law would keep whole.

The grid knows no neighbours. Particles hold together because they share nodes; once stretching has
moved them more than about a cell apart, they no longer do, and the material separates although no
law says so. A bar that is pulled apart holds up to a mean spacing of about one cell, at which its
worst places reach `APART` (docs/results/stability.md). A finer grid does not help, since it
resolves sharper corners, which are stretched more; more particles per cell do help.

Two signs are checked: particles that are stretched this far, and pieces that came off. The first
warns of a tear, but misses that of a thin stem; the second is a tear.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.stretch import make_apart
from phy124.kernels.transfer import Law
from phy124.monitor import diagnosis
from phy124.monitor.pieces import Pieces
from phy124.mpm import Model, State

APART = 1.2
"""Spacing of particles [cells] from which they may separate."""
MANY, FEW = 5e-3, 3
"""How many such particles make a tear: a fraction of P^(2/3), the particles of a cross-section,
and a smallest number, since a few separate at any corner.

Of the pressed, dropped and bounced ducks examined, those below 5.2e-3 were whole; one at 6.7e-3
lost its head, another at 7.9e-3 did not.
"""
REACH = 1.5
"""Reach of a particle's spline [cells]; nothing holds across a wider empty layer."""
LOOSE, FLAKE = 2e-3, 8
"""Smallest fraction of the elastic particles, and smallest number, that come off in a tear."""
ALONE, STURDY = 1.0, 1e9
"""Spacing at rest [cells] from which a particle has no neighbours, and a stretch none reaches."""
REMEDY = (
    "A larger accuracy.particles_per_axis, binding = particles, a stiffer material, more "
    "material.damping or a gentler motion helps; a finer grid does not."
)


class Tearing:
    """Checks once per frame how far the particles of elastic materials are stretched apart.

    Flowing material (a law with a return mapping) separates and joins as it should and is not
    checked.
    """

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._state = model, state
        self._elastic = [group for group in model.groups if group.law.project is None]
        self.count, self.first, self.stretch = 0, 0, 1.0
        """Largest number of particles beyond `APART` in a frame, the first of them, and the largest
        stretch."""
        self.loose = 0
        """Largest number of particles in a frame that were off the piece they belong to."""
        self._chosen = np.zeros(len(model), bool)
        for group in self._elastic:
            self._chosen[group.particles] = True
        spacing = np.cbrt(model.volume.numpy().astype(np.float64)) / model.dx
        # What has a cell to itself at rest is held to nothing that it could be torn from.
        stretch = np.where(spacing < ALONE, APART / spacing, STURDY)
        self._most = wp.array(stretch**2, dtype=model.real, device=model.device)
        """The square of the stretch from which a particle is beyond `APART` [P]."""
        self._pieces = Pieces(model.rest[self._chosen], REACH * model.dx, self._bodies())

    def _bodies(self) -> NDArray[np.int64] | None:
        """The body of each particle that is checked; None: there is only one."""
        model = self._model
        if model.bodies == 1:
            return None
        body = np.empty(len(model), np.int64)
        for group in model.groups:
            body[group.particles] = group.body
        return body[self._chosen]

    @property
    def torn(self) -> bool:
        """Whether a visible piece came off."""
        return self.loose >= max(FLAKE, LOOSE * int(self._chosen.sum()))

    @property
    def likely(self) -> bool:
        """Whether a piece came off, or enough particles lost their neighbours that one may."""
        return self.torn or self.count > max(FEW, MANY * len(self._model) ** (2 / 3))

    def snapshot(self) -> dict[str, Any]:
        """The state to continue from, as plain data."""
        return {
            "count": self.count, "first": self.first, "stretch": self.stretch, "loose": self.loose
        }  # fmt: skip

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self.count, self.first = snapshot["count"], snapshot["first"]
        self.stretch, self.loose = snapshot["stretch"], snapshot["loose"]

    def look(self) -> None:
        """Check the state; call at the end of a frame."""
        model, device = self._model, self._model.device
        found = wp.array([0, len(model)], dtype=int, device=device)
        max_stretch = wp.zeros(1, dtype=model.real, device=device)
        for group in self._elastic:
            part = group.particles
            inputs = [self._most[part], group.start, self._state.F[part]]
            kernel, outputs = make_apart(model.real), [found, max_stretch]
            wp.launch(kernel, len(group), inputs=inputs, outputs=outputs, device=device)
        count, first = found.numpy().tolist()
        if count > self.count:
            stretch: Any = max_stretch.numpy()
            self.count, self.first = count, first
            self.stretch = max(self.stretch, float(np.asarray(stretch)[0]))
        x: Any = self._state.x.numpy()
        whole = self._chosen.all()
        self.loose = max(self.loose, self._pieces.loose(x if whole else x[self._chosen]))

    def note(self) -> str | None:
        """A sentence that the user should know, or None."""
        if not self.likely:
            return None
        if self.torn:
            fraction = self.loose / self._chosen.sum()
            return (
                f"{self.loose} particles ({fraction:.1%}) came off the piece they belong to: the "
                f"grid tore what the material holds together. {REMEDY}"
            )
        return (
            f"{self.count} particles were stretched, up to {self.stretch:.1f} times, until they "
            f"lay more than {APART} cells apart, first "
            f"{diagnosis.particle(self._model, self._state, self.first)}. "
            f"There the grid may tear what the material holds together. {REMEDY}"
        )

    @property
    def briefly(self) -> str:
        """The note in a few words."""
        if self.torn:
            return "the grid tears the material"
        return f"the material is stretched {self.stretch:.1f} times and the grid may tear it"

    def report(self) -> dict[str, Any]:
        """The findings as plain data, for the report of the run."""
        return {
            "apart": self.count,
            "stretch": self.stretch,
            "loose": self.loose,
            "likely": self.likely,
        }


def kernels(laws: Iterable[Law], real: Any) -> Iterator[Any]:
    """What looks at particles of these laws: of plastic ones it looks at none."""
    if any(law.project is None for law in laws):
        yield make_apart(real)
