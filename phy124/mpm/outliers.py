"""Outliers: particles far from all others, which move in free flight without a grid.

The window grows with the particles, but a single particle that leaves at high speed must not make
the window grow without bound. The grid is therefore restricted to a box around the centre of the
particles. Only the uniform acceleration acts on particles outside the box. A particle that returns
to the box takes part in the transfers again.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.ballistic import make_fly, make_hide
from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model, State
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Part

MAX_NODES = 2**25
"""Largest number of nodes in a window of the grid."""
MIN_NODES = 2**20
"""A window of the grid with at most this number of nodes is always allowed."""
GROWTH = 16
"""Largest number of nodes in a window, relative to the number in the initial window."""
EVERYWHERE = 1e30
"""A coordinate that stands for infinity [m]; it is finite in float32."""


class Outliers(Kept):
    """The box to which the grid is restricted; infinite as long as the particles stay together."""

    kept = ("corners", "_half", "bounded", "most")

    def __init__(self, model: Model, state: State) -> None:
        self._model, self._state, self._half = model, state, np.zeros(3)
        corners = np.array([[-EVERYWHERE] * 3, [EVERYWHERE] * 3])
        self.corners = model.array(corners, types(model.real).vec3)
        """Lowest and highest corner of the box on the device [m]."""
        self.bounded = False
        self.indices = wp.zeros(0, dtype=int, device=model.device)
        """Indices of the particles that are currently outside the box of the grid."""
        # The extent of the particles at rest, without single distant particles.
        runs = [model.rest[model.particles(body)] for body in range(model.bodies)]
        first = sum(self._nodes(*np.quantile(rest, (0.05, 0.95), axis=0)) for rest in runs)
        self.allowed = min(MAX_NODES, max(MIN_NODES, GROWTH * min(first, MAX_NODES)))
        """Largest number of nodes of a window that contains all particles."""
        self.most, self.changed = 0, False
        """Largest number of outliers so far, and whether the last measurement changed `indices`."""

    @property
    def count(self) -> int:
        """Number of particles that are currently outside the box of the grid."""
        return len(self.indices)

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot; the particles must be restored first."""
        super().restore(snapshot)
        self.changed = False
        out = self._beyond() if self.bounded else []
        self.indices = wp.array(out, dtype=int, device=self._model.device)

    def confine(self, corners: Sequence[tuple[NDArray, NDArray]]) -> bool:
        """Adapt the box to the bodies' corners [3], m; return whether to measure the particles
        again.
        """
        if self.bounded:
            lower = np.min([low for low, _ in corners], axis=0)
            upper = np.max([high for _, high in corners], axis=0)
            if np.isfinite(lower).all():
                measured = self._beyond()
                self._centre((lower + upper) / 2)
                return self.changed or not np.array_equal(measured, self.indices.numpy())
        if not self.bounded and sum(self._nodes(*pair) for pair in corners) <= self.allowed:
            return False
        x = self._state.x.numpy().astype(np.float64)
        side = self._model.dx * (self.allowed ** (1 / 3) - 3 * MARGIN)
        self._half, self.bounded = np.full(3, side / 2), True
        # The box is centred at a particle, so that at least one particle is inside.
        self._centre(x[np.abs(x - np.median(x, axis=0)).max(axis=1).argmin()])
        return True

    def around(self, part: Part, gather: Recorded, grid: Grid, tracks: Tracks) -> list[Recorded]:
        """Return the kernel launches for the gather of `part`, including the launches that move
        outliers.

        Args:
            part: Some of the particles.
            gather: The recorded gather of these particles.
            grid: The grid from which the particles gather their velocities.
            tracks: The tracks, which include the uniform acceleration.
        """
        mine = part.among(np.asarray(self.indices.numpy(), np.int32))
        model, state, count = self._model, self._state, len(mine)
        if not count:
            return [gather]
        chosen = wp.array(mine, dtype=int, device=model.device)
        kept = wp.empty(count, dtype=state.x.dtype, device=model.device)
        away = wp.empty(count, dtype=int, device=model.device)
        inputs = [chosen, grid.lattice, part.nodes.window, grid.window]
        hide = model.launch(make_hide(model.real), count, inputs, [state.x, kept, away])
        inputs = [chosen, tracks.clock, tracks.values, kept, away]
        outputs = [state.x, state.residue, state.v]
        fly = model.launch(make_fly(model.real), count, inputs, outputs)
        return [("ballistic", hide), gather, ("ballistic", fly)]

    def _centre(self, middle: NDArray) -> None:
        low, high = middle - self._half, middle + self._half
        self.corners.assign(np.stack([low, high]).astype(self.corners.numpy().dtype))
        out = self._beyond()
        self.changed = not np.array_equal(out, self.indices.numpy())
        self.indices = wp.array(out, dtype=int, device=self._model.device)
        self.most = max(self.most, len(out))

    def _beyond(self) -> NDArray[np.int32]:
        """Return the indices of the outliers; their positions are compared in the device's
        precision.
        """
        (low, high), x = self.corners.numpy(), self._state.x.numpy()
        return np.flatnonzero(~np.all((x >= low) & (x <= high), axis=1)).astype(np.int32)

    def _nodes(self, lower: NDArray, upper: NDArray) -> float:
        """Return the number of nodes in a window over a box, as a float that cannot overflow."""
        cells = ((upper - lower) / self._model.dx).tolist()
        return math.prod(extent + 3 + 2 * MARGIN for extent in cells)
