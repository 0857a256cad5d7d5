"""State: what changes every substep, on the device; Group: a run of particles of one law."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.transfer import Law
from phy124.materials import Material


@dataclass(frozen=True)
class Group:
    """A run of particles of one law."""

    law: Law
    start: int
    stop: int
    theta: wp.array
    """Parameters of the law, one row, or one row per particle."""

    def rows(self, part: slice) -> wp.array:
        """The parameters of a part of its particles, which a thread works on."""
        if len(self.theta) == 1:
            return self.theta
        return cast("wp.array", self.theta[part.start - self.start : part.stop - self.start])


def parameters(
    materials: Sequence[Material],
    material: NDArray,
    share: NDArray | None,
    *,
    dx: float,
    cfl: float,
) -> NDArray[np.float64]:
    """Parameters of particles of one law: one row if they are all alike, else one row each.

    `material [P]` are indices into `materials`, `share [P]` multiplies what is proportional to E.
    """
    found = np.unique(material)
    rows = np.array([materials[i].theta_on(dx, cfl) for i in found])
    scaled = np.array([materials[i].scaled for i in found])
    if share is None or not scaled.any():
        return rows if len(found) == 1 else rows[np.searchsorted(found, material)]
    own = np.searchsorted(found, material)
    column = np.arange(rows.shape[1]) < scaled[own][:, None]
    return rows[own] * np.where(column, share[:, None], 1.0)


@dataclass
class State:
    """What changes every substep."""

    x: wp.array
    """Positions [P,3], m."""
    residue: wp.array
    """What rounding took from the positions [P,3], m."""
    v: wp.array
    """Velocities [P,3], m/s, half a substep behind the positions."""
    C: wp.array
    """APIC velocity gradients [P,3,3], 1/s."""
    F: wp.array
    """Elastic deformation gradients [P,3,3]."""
    history: wp.array
    """History variables of the law [P,2]; empty unless a law has some."""
    total: wp.array
    """Total deformation gradients [P,3,3]; empty unless a law is plastic."""

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def deformation(self) -> wp.array:
        """What the Gaussians follow: F, or F_total where it differs."""
        return self.total if len(self.total) else self.F

    def copy(self) -> dict[str, wp.array]:
        """A snapshot to restore from."""
        return {name: wp.clone(array) for name, array in self.arrays().items()}

    def restore(self, snapshot: dict[str, wp.array]) -> None:
        """Go back to a snapshot."""
        for name, array in self.arrays().items():
            wp.copy(array, snapshot[name])


def part_of(array: wp.array, part: slice) -> wp.array:
    """A slice of an array that may be empty because no law needs it."""
    return cast("wp.array", array[part]) if len(array) else array
