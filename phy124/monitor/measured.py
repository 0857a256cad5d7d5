"""Adds stages to a substep that measure the effect of forces and boundaries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp

from phy124.boundaries import Boundary
from phy124.boundaries.base import Corners, swept
from phy124.kernels.reduction import along_rows
from phy124.kernels.work import make_wall_copy
from phy124.mpm import Attachable, Grid, Model, Stage, State
from phy124.mpm.stage import divide_forces
from phy124.mpm.tracks import Tracks


class Measured:
    """Several forces or boundaries, with stages that measure their joint effect."""

    def __init__(
        self,
        inner: Sequence[Attachable],
        measure: Callable[[Sequence[Stage], Model, State], tuple[Stage, ...]],
    ) -> None:
        self._inner, self._measure = inner, measure

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages of the forces or boundaries, preceded and followed by measurements."""
        stages = [stage for item in self._inner for stage in item.attach(model, state, tracks)]
        if not stages:
            return []
        before, *after = self._measure(stages, model, state)
        return [before, *stages, *after]

    def in_part(self, part: Model, whole: Model) -> Measured:
        """Return the measured forces for a part of a divided model (`Force.in_part`)."""
        return Measured(divide_forces(self._inner, part, whole), self._measure)


class NodesNear:
    """The grid nodes that the measured walls may change.

    Call `fit` when the stored range of nodes has changed.
    """

    def __init__(self, walls: Sequence[Boundary], model: Model) -> None:
        self._corners, self._model = _reach(walls, model), model
        self.threads: tuple[int, ...] = ()
        """Numbers of threads along each axis for a kernel whose threads process segments of rows of
        these nodes.
        """
        self.read: list[Any] = []
        """First inputs of such a kernel: segment length, box of nodes, stored range, and nodes."""
        self.copy: wp.array | None = None
        """Copy of the nodes in the box."""

    def fit(self, grid: Grid) -> None:
        """Find the nodes in the stored range."""
        start, extent = grid.nodes_within(*self._corners)
        corners = np.stack([start, extent]).astype(np.int32)
        box = wp.array(corners, dtype=wp.vec3i, device=self._model.device)
        self.copy = wp.empty(int(np.prod(extent)), dtype=grid.vec4, device=self._model.device)
        self.threads, each = along_rows(extent, self._model.device)
        self.read = [each, box, grid.window, grid.nodes]

    def record_copy(self, grid: Grid) -> wp.Launch | None:
        """Call `fit`, and record the kernel launch that copies the nodes."""
        self.fit(grid)
        kernel = make_wall_copy(self._model.real)
        return self._model.launch(kernel, self.threads, self.read, [self.copy])


def _reach(walls: Sequence[Boundary], model: Model) -> Corners:
    """Return the corners of a box around all nodes that the walls may change [m]."""
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for wall in walls:
        corners, track = wall.bounds(model), wall.track(model)
        if track is not None:
            corners = swept(corners, track)
        lower, upper = np.minimum(lower, corners[0]), np.maximum(upper, corners[1])
    return lower, upper
