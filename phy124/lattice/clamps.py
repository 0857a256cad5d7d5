"""Clamps on a lattice, and the contact impulses that clamps take.

Nodes inside a clamp have the clamp's velocity. The node next to the clamp's surface moves in the
opposite direction to its free neighbour, so that the interpolated motion vanishes at the surface.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.kernels.arguments import types
from phy124.kernels.lattice.contact import make_distances
from phy124.kernels.lattice.impulses import make_pass_on
from phy124.kernels.lattice.nodes import make_hold, make_pin
from phy124.lattice.impulses import Impulses
from phy124.lattice.rest import RestLattice, splines
from phy124.mpm.model import Model
from phy124.mpm.tracks import Track, Tracks

HELD = 0.5
"""Up to this distance from a clamp's surface [cells], a held node moves opposite to its free
neighbour, so that the motion vanishes at the surface. Nodes farther inside do not move.
"""
INSET = 0.2
"""Depth inside a clamp at which the motion is set to zero [cells]. A B-spline that vanishes at a
surface is also flat there, so a plate held at the surface would be too short by about this depth.
"""
STILL = Track(((0.0, (0.0, 0.0, 0.0)),))
"""The track of a wall that never moves."""


class Clamp:
    """The nodes that a clamp holds, and the launch that sets their velocity to the clamp's."""

    def __init__(
        self,
        part: Any,
        model: Model,
        lattice: RestLattice,
        nodes: Any,
        tracks: Tracks,
        sums: wp.array,
    ) -> None:
        if part.contact != "sticky":
            raise InputError(
                f"boundaries.{type(part).__name__.lower()}.contact",
                part.contact,
                "a body on a lattice can only be held in all directions.",
                'Use contact = "sticky", or accuracy.solver = "mpm".',
            )
        self._model, self._nodes, self._tracks, self._sums = model, nodes, tracks, sums
        self._slot = tracks.add(part.track(model) or STILL)
        far = distances(part, model, lattice.x)
        far[:, 3] += INSET * model.dx
        held = np.flatnonzero((far[:, 3] < -HELD * model.dx) & acts_on(part, model, lattice.body))
        self._held = wp.array(held.astype(np.int32), dtype=int, device=model.device)
        pairs, ratios = pins(lattice, far, acts_on(part, model, lattice.body))
        self._pairs = wp.array(pairs.astype(np.int32), dtype=wp.vec2i, device=model.device)
        self._ratios = model.array(ratios, model.real)
        self.nodes = np.concatenate([held, pairs.ravel()])
        """Indices of the nodes whose velocities change."""

    def record(self) -> list[wp.Launch | None]:
        """Record the launches of one substep."""
        model, nodes, tracks = self._model, self._nodes, self._tracks
        inputs = [self._slot, nodes.inverse, nodes.rest, nodes.u, tracks.values, tracks.rates]
        inputs.append(nodes.before)
        outputs = [nodes.v, nodes.movable, self._sums]
        held = [self._held, *inputs]
        pinned = [self._pairs, self._ratios, *inputs]
        return [
            model.launch(make_hold(model.real), len(self._held), held, outputs),
            model.launch(make_pin(model.real), len(self._pairs), pinned, outputs),
        ]


class PassedOn:
    """Records launches that pass the contact impulses on held nodes to the clamps."""

    def __init__(
        self,
        model: Model,
        nodes: Any,
        clock: wp.array,
        clamps: Sequence[tuple[int, Clamp]],
        sums: wp.array,
        impulses: Impulses | None,
    ) -> None:
        """Store which clamp holds each node.

        Args:
            model: The constants of the run.
            nodes: Arrays of the nodes.
            clock: The clock of the substeps.
            clamps: The clamps in the order in which they act, with their rows of `sums`.
            sums: Sums of all simple walls [W,16].
            impulses: Sums per surface point and node; None if they are not kept.
        """
        holder = np.zeros(len(nodes.rest), np.int32)
        for row, clamp in clamps:
            holder[clamp.nodes] = row
        self._model, self._nodes, self._clock, self._sums = model, nodes, clock, sums
        self._holder = wp.array(holder, dtype=int, device=model.device)
        self._none = wp.zeros(0, dtype=wp.float64, device=model.device)
        nothing = wp.zeros(0, dtype=wp.vec3d, device=model.device)
        self._of_nodes = nothing if impulses is None else impulses.of_nodes

    def of(
        self,
        near: wp.array,
        points: tuple[wp.array, wp.array],
        force: wp.array,
        sums: wp.array | None = None,
    ) -> wp.Launch:
        """Record the launch for listed points; the launch has one thread per listed point.

        Args:
            near: Indices of the points.
            points: Nodes and weights of each point.
            force: Mean force on each point in a substep [S,3], N.
            sums: Sums of what exerts the force, which include its work; None: there are none.
        """
        nodes, kernel = self._nodes, make_pass_on(self._model.real)
        inputs = [near, *points, nodes.movable, nodes.inverse, self._holder, nodes.rest, nodes.u]
        inputs += [force, self._clock, nodes.before, nodes.v]
        outputs = [self._none if sums is None else sums, self._sums, self._of_nodes]
        return cast("wp.Launch", self._model.launch(kernel, max(1, len(near)), inputs, outputs))


def pins(
    lattice: RestLattice, far: NDArray[np.float64], affected: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs of a column's last held and first free node, and ratios of the pairs' motions.

    Args:
        lattice: The lattice at rest.
        far: Normal and distance of each node from the clamp [N,4].
        affected: Whether the clamp acts on the body of each node [N].
    """
    axis = np.argmax(np.abs(far[:, :3]), axis=1)
    lean = np.take_along_axis(far[:, :3], axis[:, None], axis=1)[:, 0]
    across = np.maximum(np.abs(lean), 1e-3) * lattice.dx
    middle = np.flatnonzero((np.abs(far[:, 3] / across) <= HELD) & affected)
    step = np.zeros((len(middle), 3), np.int64)
    step[np.arange(len(middle)), axis[middle]] = np.sign(lean[middle]).astype(np.int64)
    front = lattice.find(lattice.index[middle] + step, lattice.body[middle])
    # A node may be the front of one column only, so that no two threads write to it.
    present = np.flatnonzero(front >= 0)
    _, first = np.unique(front[present], return_index=True)
    chosen = present[first]
    offset = 1 + far[middle[chosen], 3] / across[middle[chosen]]
    weights = splines(offset)
    return np.stack([middle[chosen], front[chosen]], axis=1), -weights[:, 0] / weights[:, 1]


def acts_on(part: Any, model: Model, body: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether a simple wall acts on each of K bodies [K]."""
    if part.object is None:
        return np.ones(len(body), bool)
    return np.asarray(body == model.names.index(part.object))


def distances(part: Any, model: Model, x: NDArray) -> NDArray[np.float64]:
    """Return a simple wall's normals and signed distances [m] at points [N,3], as rows [N,4]."""
    t = types(model.real)
    shape, points = t.mat33(*np.ravel(part.geometry(model))), model.array(x, t.vec3)
    out = wp.zeros(len(x), dtype=t.vec4, device=model.device)
    kernel = make_distances(part.outline(), model.real)
    wp.launch(kernel, len(x), [shape, points], [out], device=model.device)
    far: NDArray[Any] = out.numpy()
    return far.astype(np.float64)
