"""Contact of surface points on lattices with particle bodies (material point method).

In each substep, contact is computed on the particles' grid after the grid update, before walls.
"""

import math
from collections.abc import Callable, Iterator
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.contacts import SUMS
from phy124.kernels.lattice import grid as kernels
from phy124.kernels.lattice.rows import rows_for
from phy124.kernels.launches import put
from phy124.lattice.clamps import PassedOn
from phy124.lattice.surface import Surface
from phy124.lattice.walls import Nodes
from phy124.mpm.grid import Grid
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.pairs import Pair
from phy124.mpm.stage import Named


class Material(Kept):
    """Contact of one body's surface points with one particle body."""

    kept = ("force", "space", "sums", "due", "_near", "_starts")

    def __init__(
        self,
        surface: Surface,
        nodes: Nodes,
        model: Model,
        pair: Pair,
        fill: float,
        *,
        body: int,
        moves: bool,
    ) -> None:
        """Prepare the contact with particles; initially, no surface points are listed.

        `fill` [1/kg] is the volume fraction around a node per unit mass of particles at the node.
        """
        self.pair, self._model, self._nodes = pair, model, nodes
        self._fill, self._moves = fill, int(moves)
        self._mine = (surface.body == body) & surface.meets_bodies
        t, count, device = types(model.real), surface.count, model.device

        def zeros(kind: Any) -> wp.array:
            return wp.zeros(count, dtype=kind, device=device)

        self._near: NDArray[np.int32] = np.zeros(0, np.int32)
        self._list, self._flags, self._bodies = zeros(int), zeros(int), zeros(int)
        self._gap, self._on, self._place = zeros(t.vec4), zeros(t.vec4), zeros(t.vec3)
        self._yields, self.force = zeros(model.real), zeros(t.vec3)
        self.sums = wp.zeros(SUMS, dtype=wp.float64, device=device)
        """Impulse of the particles on the body, and the impulse's moment about the origin."""
        self.space = wp.full(count, -math.inf, dtype=model.real, device=device)
        """Distance from the material at which contact with each point begins [S], m; -inf before
        the point is first near the material.
        """
        self._starts = pair.sticky
        """Whether points that touch the material in the next substep begin to stick to it."""
        self._normal = model.array(surface.normal, t.vec3)
        self._points = nodes.points
        self.due = True
        """Whether the next substep must list the surface points near the particles."""
        self._passed: wp.Launch | None = None
        self.most = 0
        """Largest number of surface points near the particles so far."""

    def record(self, grid: Grid, clock: wp.array, recovery: float) -> None:
        """Record the kernel launches for the current window of the particles' grid.

        `recovery` [1/s] is the speed at which points inside the material are moved out, divided by
        depth.
        """
        model, nodes, rows = self._model, self._nodes, self._nodes.rows
        on_grid = [grid.lattice, grid.window, grid.nodes]
        count = len(self._list)
        kernel = kernels.make_grid_near(model.real, rows)
        inputs = [*self._points, nodes.u, *on_grid]
        self._look = model.launch(kernel, count, inputs, [self._flags])
        inputs = [self._list, 0, self._fill, self._moves, 0, *self._points, self._normal]
        inputs += [nodes.movable, nodes.u, clock, *on_grid]
        outputs = [self.space, nodes.v, self._gap, self._on, self._place, self._yields, self.force]
        touch = model.launch(kernels.make_grid_touch(model.real, rows), 1, inputs, outputs)
        inputs = [self._list, 0, recovery, self.pair.friction, self._moves, *self._points[:2]]
        inputs += [nodes.movable, self._gap, self._on, self._yields, clock, *on_grid[1:]]
        kernel = kernels.make_grid_resist(self.pair.sticky, model.real, rows)
        resist = model.launch(kernel, 1, inputs, [nodes.v, self.force])
        inputs = [self._list, 0, self._bodies, self._place, self.force, clock]
        total = model.launch(kernels.make_grid_sum(model.real), 1, inputs, [self.sums])
        self._launches = [cast("wp.Launch", launch) for launch in (touch, resist, total)]

    def stages(self, passed: PassedOn | None) -> list[list[Named]]:
        """Return the kernel launches of a substep that apply, correct and sum contact impulses."""
        near = self._list, self._points[:2], self.force
        self._passed = None if passed is None else passed.of(*near)
        return [[("pairs", self._stage(number))] for number in range(3)]

    def _stage(self, number: int) -> Callable[[], None]:

        def act() -> None:
            if number == 0 and self.due:
                self._list_near()
            if number == 2:
                self._starts = False
            if len(self._near):
                launch = self._launches[number]
                launch.set_param_at_index(1, len(self._near))
                if number == 0:
                    launch.set_param_at_index(4, int(self._starts))
                launch.launch()
                if number == 2 and self._passed is not None:
                    self._passed.set_dim(len(self._near))
                    self._passed.launch()

        return act

    def _list_near(self) -> None:
        self.due = False
        if self._look is None:
            return
        self._look.launch()
        near = np.flatnonzero((self._flags.numpy() > 0) & self._mine)
        if not np.array_equal(near, self._near):
            force = self.force.numpy()
            kept = np.zeros_like(force)
            kept[near] = force[near]
            self.force.assign(kept)
            self._near = near.astype(np.int32)
            self.most = max(self.most, len(near))
            put(self._list, self._near)

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        super().restore(snapshot)
        put(self._list, self._near)


def kernels_of(real: Any, device: str) -> Iterator[Any]:
    """Yield the kernels of contact with bodies of particles."""
    rows = rows_for(real, device)
    yield from (kernels.make_grid_near(real, rows), kernels.make_grid_touch(real, rows))
    yield from (kernels.make_grid_resist(False, real, rows), kernels.make_grid_sum(real))
