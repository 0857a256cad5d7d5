"""Adds measuring stages before and after forces and boundaries.

Velocities are copied before a force or wall acts, and compared with the velocities afterwards.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from phy124.boundaries import Boundary
from phy124.boundaries.base import Corners, swept
from phy124.kernels.reduction import along_rows
from phy124.kernels.work import make_wall_copy
from phy124.mpm import Attachable, Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks


class Measured:
    """Combines forces or boundaries, and adds stages that measure their effect."""

    def __init__(
        self,
        inner: Sequence[Attachable],
        measure: Callable[[Sequence[Stage], Model, State], tuple[Stage, ...]],
    ) -> None:
        self._inner, self._measure = inner, measure

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the measuring stage, the inner stages, and the measuring stages that follow."""
        stages = [stage for item in self._inner for stage in item.attach(model, state, tracks)]
        if not stages:
            return []
        before, *after = self._measure(stages, model, state)
        return [before, *stages, *after]


class NodesNear:
    """The nodes that the measured walls may change; call `fit` if the grid's window has changed."""

    def __init__(self, walls: Sequence[Boundary], model: Model) -> None:
        self._corners, self._model = _reach(walls, model), model
        self.threads: tuple[int, ...] = ()
        """Launch shape of a kernel that processes the rows of these nodes in segments."""
        self.read: list[Any] = []
        """First inputs of a kernel that runs over these segments: segment length, box, window,
        nodes."""
        self.copy: wp.array | None = None
        """Memory for a copy of the nodes."""

    def fit(self, grid: Grid) -> None:
        """Determine the nodes for the grid's current window."""
        start, extent = grid.nodes_within(*self._corners)
        corners = np.stack([start, extent]).astype(np.int32)
        box = wp.array(corners, dtype=wp.vec3i, device=self._model.device)
        self.copy = wp.empty(int(np.prod(extent)), dtype=grid.vec4, device=self._model.device)
        self.threads, each = along_rows(extent, self._model.device)
        self.read = [each, box, grid.window, grid.nodes]

    def record_copy(self, grid: Grid) -> wp.Launch | None:
        """Fit to the grid's current window, and record the launch that copies the nodes."""
        self.fit(grid)
        kernel = make_wall_copy(self._model.real)
        return self._model.launch(kernel, self.threads, self.read, [self.copy])


def _reach(walls: Sequence[Boundary], model: Model) -> Corners:
    """Return the corners of a box around every node that a wall may change [m]."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for wall in walls:
        corners, track = wall.bounds(model), wall.track(model)
        if track is not None:
            corners = swept(corners, track)
        lower, upper = np.minimum(lower, corners[0]), np.maximum(upper, corners[1])
    return lower, upper
