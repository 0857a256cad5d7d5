"""Clamps on a lattice, and the transfer of contact impulses from clamped nodes to clamps.

Nodes inside a clamp have the clamp's velocity. The node next to the clamp's surface moves in the
opposite direction to its free neighbour, so that the interpolated motion vanishes at the surface.
"""

from __future__ import annotations

import math
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
from phy124.mpm.tracks import STILL, Tracks

HELD = 0.5
"""Distance from the clamp's surface [cells] up to which a clamped node moves opposite to its free
neighbour. Nodes farther inside the clamp do not move.
"""
THINNEST = 0.75
"""Smallest depth of a clamp below all its surfaces [cells]. A thinner clamp acts as if it had this
depth. Otherwise, it might contain no node, or nodes about which the material could turn.
"""
INSET = 0.2
"""Depth inside a clamp at which the motion of the material is set to zero [cells]. A B-spline that
vanishes at the surface of a clamp is also flat there. A plate that is clamped exactly at the
surface of the clamp would therefore be too short by about this depth.
"""


class Clamp:
    """The nodes in a clamp, and the kernel launches that give these nodes the clamp's velocity."""

    def __init__(
        self,
        part: Any,
        model: Model,
        lattice: RestLattice,
        nodes: Any,
        tracks: Tracks,
        sums: wp.array,
        row: int,
        holder: wp.array,
    ) -> None:
        """Find the nodes in a clamp.

        Raises:
            InputError: The clamp fixes only some directions.
        """
        if part.contact != "sticky":
            raise InputError(
                f"boundaries.{type(part).__name__.lower()}.contact",
                part.contact,
                "a body on a lattice can only be fixed in all directions.",
                'Use contact = "sticky", or accuracy.solver = "mpm".',
            )
        self._model, self._nodes, self._tracks, self._sums = model, nodes, tracks, sums
        self._row, self._holder = row, holder
        self.slot = tracks.add(part.track(model) or STILL)
        step, depth = columns_of(part, model, lattice.x)
        affected = acts_on(part, model, lattice.body)
        middle = np.flatnonzero(affected & (np.abs(depth) <= HELD))
        self.pairs, ratios = pins(lattice, middle, step[middle], depth[middle])
        """Pairs of neighbouring nodes at the clamp's surface: inside and outside [K,2]."""
        single = np.setdiff1d(middle[depth[middle] > 0], self.pairs[:, 0])
        self.held = np.union1d(np.flatnonzero(affected & (depth > HELD)), single)
        """Indices of the nodes that lie inside the clamp."""
        self._ratios = model.array(ratios, model.real)
        self.nodes = np.concatenate([self.held, self.pairs.ravel()])
        """Indices of the nodes whose velocities the clamp changes."""

    def record(self, earlier: Sequence[Clamp], later: Sequence[Clamp]) -> list[wp.Launch | None]:
        """Record the kernel launches of one substep.

        The clamps `earlier` and `later` come before and after this clamp in the scene. If a node is
        inside several active clamps, it belongs to the last of them. A clamp that contains a node
        has precedence over a clamp whose surface is at the node.
        """
        model, nodes, tracks = self._model, self._nodes, self._tracks
        inputs = [self._row, self.slot, nodes.inverse, nodes.rest, nodes.u, tracks.values]
        inputs += [tracks.rates, nodes.before]
        outputs = [nodes.v, nodes.movable, self._holder, self._sums]
        inside = [(clamp.slot, clamp.held) for clamp in later]
        others = [*inside, *((clamp.slot, clamp.held) for clamp in earlier)]
        others += [(clamp.slot, clamp.pairs.ravel()) for clamp in later]
        held = wp.array(self.held.astype(np.int32), dtype=int, device=model.device)
        pairs = wp.array(self.pairs.astype(np.int32), dtype=wp.vec2i, device=model.device)
        taken = [slots_at(self.pairs[:, end], others, model.device) for end in (0, 1)]
        holds = [held, slots_at(self.held, inside, model.device), *inputs]
        pinned = [pairs, self._ratios, *taken, *inputs]
        return [
            model.launch(make_hold(model.real), len(self.held), holds, outputs),
            model.launch(make_pin(model.real), len(self.pairs), pinned, outputs),
        ]


class PassedOn:
    """Prepares kernel launches that add contact impulses on clamped nodes to the clamps' sums."""

    def __init__(
        self,
        model: Model,
        nodes: Any,
        clock: wp.array,
        holder: wp.array,
        sums: wp.array,
        impulses: Impulses | None,
    ) -> None:
        self._model, self._nodes, self._clock, self._sums = model, nodes, clock, sums
        self._holder = holder
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
        """Record the kernel launch that passes contact impulses on to clamps.

        Args:
            near: Indices of the points.
            points: Nodes and weights of each point.
            force: Mean force on each point in a substep [S,3], N.
            sums: Sums, including work, of the wall or body that exerts the force, or None.
        """
        nodes, kernel = self._nodes, make_pass_on(self._model.real)
        inputs = [near, *points, nodes.movable, nodes.inverse, self._holder, nodes.rest, nodes.u]
        inputs += [force, self._clock, nodes.before, nodes.v]
        outputs = [self._none if sums is None else sums, self._sums, self._of_nodes]
        return cast("wp.Launch", self._model.launch(kernel, max(1, len(near)), inputs, outputs))


def columns_of(
    part: Any, model: Model, x: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the step from each node to the next node on the shortest way out of a clamp [N,3], and
    the depth of the node below the clamp's surface along this way [N], cells.

    If the next node is inside as well, the depth is 1.
    """
    inset = INSET - max(0.0, THINNEST - thickness_of(part, model) / 2 / model.dx)
    far = distances(part, model, x)
    axis, each = np.argmax(np.abs(far[:, :3]), axis=1), np.arange(len(x))
    step = np.zeros((len(x), 3), np.int64)
    step[each, axis] = np.where(far[each, axis] < 0, -1, 1)
    lean = np.maximum(np.abs(far[each, axis]), 1e-3)
    here, ahead = (
        distance[:, 3] / model.dx + inset
        for distance in (far, distances(part, model, x + model.dx * step))
    )
    inside = np.where(ahead > 0, here / np.minimum(here - ahead, -1e-9), 1.0)
    return step, np.where(here <= 0, inside, -here / lean)


def pins(
    lattice: RestLattice, middle: NDArray, step: NDArray, depth: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return pairs of the last clamped node and the first free node of a column [K,2], and the
    ratios of the motions of the two nodes [K].

    Args:
        lattice: The lattice at rest.
        middle: The last clamped node of each column [M].
        step: Step from this node to the next node of the column [M,3].
        depth: Depth of the last clamped node below the surface of the clamp [M], cells.
    """
    front = lattice.step_from(middle, step)
    # A node may be in only one pair, so that no two threads write to it.
    present = np.flatnonzero((front >= 0) & ~np.isin(front, middle))
    _, first = np.unique(front[present], return_index=True)
    chosen = present[first]
    weights = splines(1 - depth[chosen])
    return np.stack([middle[chosen], front[chosen]], axis=1), -weights[:, 0] / weights[:, 1]


def slots_at(
    nodes: NDArray[np.int64], clamps: Sequence[tuple[int, NDArray[np.int64]]], device: str
) -> wp.array:
    """Return the indices of the motions (tracks) of the clamps at each node [K,L]; -1: no clamp.

    Each item of `clamps` contains the track and the nodes of a clamp.
    """
    among = [(slot, np.isin(nodes, theirs)) for slot, theirs in clamps]
    slots = [np.where(inside, slot, -1) for slot, inside in among if inside.any()]
    columns = np.stack(slots, axis=1) if slots else np.zeros((len(nodes), 0))
    return wp.array(columns.astype(np.int32), dtype=int, ndim=2, device=device)


def thickness_of(part: Any, model: Model) -> float:
    """Return the smallest thickness of a clamp [m]; infinite if the clamp is a half space."""
    if part.outline() == "half_space":
        return math.inf
    centre = np.array([part.geometry(model)[0]])
    return -2 * float(distances(part, model, centre)[0, 3])


def acts_on(part: Any, model: Model, body: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return, for each of K bodies, whether a simple wall acts on the body [K]."""
    if part.object is None:
        return np.ones(len(body), bool)
    if part.object not in model.names:
        return np.zeros(len(body), bool)
    return np.asarray(body == model.names.index(part.object))


def distances(part: Any, model: Model, x: NDArray) -> NDArray[np.float64]:
    """Return a simple wall's normal and signed distance [m] at points, as rows [N,4]."""
    return distances_from(part.outline(), part.geometry(model), model, x)


def distances_from(shape: str, geometry: Any, model: Model, x: NDArray) -> NDArray[np.float64]:
    """Return a shape's normal and signed distance [m] at points, as rows [N,4].

    Args:
        shape: Name of the shape.
        geometry: Vectors that define the shape [3,3] (phy124/kernels/distance.py).
        model: The model, with the precision and the device.
        x: The points [N,3], m.
    """
    t = types(model.real)
    vectors, points = t.mat33(*np.ravel(geometry)), model.array(x, t.vec3)
    out = wp.zeros(len(x), dtype=t.vec4, device=model.device)
    kernel = make_distances(shape, model.real)
    wp.launch(kernel, len(x), [vectors, points], [out], device=model.device)
    far: NDArray[Any] = out.numpy()
    return far.astype(np.float64)
