"""State: what changes every substep, on the device."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.mpm.model import Model


@dataclass
class State:
    """What changes every substep."""

    x: wp.array
    """Positions [P,3], m."""
    residue: wp.array
    """Rounding errors of the positions [P,3], m, added again in the next substep."""
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

    @classmethod
    def of(cls, model: Model, v: NDArray | None = None, C: NDArray | None = None) -> State:
        """An undeformed state.

        Args:
            model: The particles.
            v: Their velocities [P,3], m/s; None: at rest.
            C: Their velocity gradients [P,3,3], 1/s; None: zero.
        """
        t, count = types(model.real), len(model)
        plastic = any(group.law.project is not None for group in model.groups)
        kept = count if plastic else 0
        v, C = (None if motion is None else _moving(motion, model) for motion in (v, C))
        identity = np.tile(np.eye(3), (count, 1, 1))
        return cls(
            x=model.array(model.rest, t.vec3),
            residue=model.array(np.zeros((count, 3)), t.vec3),
            v=model.array(np.zeros((count, 3)) if v is None else v, t.vec3),
            C=model.array(np.zeros((count, 3, 3)) if C is None else C, t.mat33),
            F=model.array(identity, t.mat33),
            history=model.array(model.history[:kept], t.vec2),
            total=model.array(identity[:kept], t.mat33),
        )

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def deformation(self) -> wp.array:
        """The deformation gradients that the Gaussians follow: F, or F_total where it differs."""
        return self.total if len(self.total) else self.F

    def snapshot(self) -> dict[str, Any]:
        """A copy on the device, for `restore`."""
        return {name: wp.clone(array) for name, array in self.arrays().items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot, on the device or read from a file."""
        for name, array in self.arrays().items():
            array.assign(snapshot[name])


def part_of(array: wp.array, part: slice) -> wp.array:
    """A slice of an array, or the array itself if it is empty because no law needs it."""
    return cast("wp.array", array[part]) if len(array) else array


def _moving(motion: NDArray, model: Model) -> NDArray:
    """Velocities or their gradients, zero for particles that never move."""
    if not model.held:
        return motion
    moves: NDArray = model.moves.reshape(-1, *[1] * (motion.ndim - 1))
    return np.where(moves, motion, 0.0)
