"""Nodes near walls: kept as they are before walls act, so that what walls give can be measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from phy124.boundaries import Boundary
from phy124.boundaries.base import Corners, swept
from phy124.kernels.reduction import along_rows
from phy124.mpm import Grid, Model


class NodesNear:
    """The nodes that some walls may touch; call `fit` when the grid's window is a new one."""

    def __init__(self, walls: Sequence[Boundary], model: Model) -> None:
        self._reach, self._device = reach_of(walls, model), model.device
        self.threads: tuple[int, ...] = ()
        """Of a kernel over parts of rows of these nodes."""
        self.read: list[Any] = []
        """What such a kernel reads: length of a part, box, window, and the grid's nodes."""
        self.kept: wp.array | None = None
        """Room for a copy of them."""

    def fit(self, grid: Grid) -> None:
        """Find them in the grid's present window."""
        start, extent = grid.nodes_within(*self._reach)
        corners = np.stack([start, extent]).astype(np.int32)
        box = wp.array(corners, dtype=wp.vec3i, device=self._device)
        self.kept = wp.empty(int(np.prod(extent)), dtype=grid.vec4, device=self._device)
        self.threads, each = along_rows(extent, self._device)
        self.read = [each, box, grid.window, grid.nodes]


def reach_of(walls: Sequence[Boundary], model: Model) -> Corners:
    """Corners of a box that contains every node a wall may touch [m]."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for wall in walls:
        corners, track = wall.bounds(model), wall.track(model)
        if track is not None:
            corners = swept(corners, track)
        lower, upper = np.minimum(lower, corners[0]), np.maximum(upper, corners[1])
    return lower, upper
