"""Builds the lattices of bodies at rest: nodes, cells, weights of points, masses and tied nodes.

Node i is at (i + 1/2) dx, in the middle of cell i, and its quadratic B-spline covers the cells i -
1 to i + 1. A cell's eight points (phy124/particles/lattice.py) therefore use the same 27 nodes. If
the points were between nodes instead, some motions of partly filled cells would have no stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np
import scipy
import scipy.sparse.csgraph
from numpy.typing import NDArray

from phy124.lattice.copies import lay_out
from phy124.lattice.ties import (
    CORNER,
    GIVING,
    LIGHT,
    LIGHTEST,
    rows_of_identity,
    share_mass,
    tie_light,
)
from phy124.particles.lattice import PER_CELL

ROW = 9
"""Number of rows of nodes in a cell; a row is three nodes along z."""
STEPS = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Indices of the 27 nodes of a cell, relative to the cell's middle node."""


@dataclass(frozen=True, eq=False)
class RestLattice:
    """Nodes of bodies at rest, sorted by body, x, y and z, and weights of the nodes at points."""

    dx: float
    """Side of a cell [m]."""
    index: NDArray[np.int64]
    """Indices of the nodes along each axis [N,3]."""
    rows: NDArray[np.int32]
    """For each cell, the first node of each of its nine rows of three nodes along z [C,9]."""
    offset: NDArray[np.float64]
    """Position of each point relative to its cell's first node [P,3], cells, 0.5 to 1.5."""
    mass: NDArray[np.float64]
    """Mass of each node, including the nodes that are tied to it [N], kg; 0 for a tied node."""
    tied: NDArray[np.int64]
    """Indices of the tied nodes [T]."""
    ties: scipy.sparse.csr_matrix
    """Weights with which the motions of all nodes determine each tied node's motion [T,N]."""
    pushes: scipy.sparse.csr_matrix
    """Weights with which forces on other nodes are added to the force on each node [N,N]. With
    these weights, a uniform acceleration field accelerates all nodes equally.
    """
    body: NDArray[np.int64]
    """Body index of each node [N]."""
    source: NDArray[np.int64]
    """Index of the node that each node copies [N]; a node that is no copy has its own index here.
    """

    @classmethod
    def of(
        cls,
        x: NDArray,
        mass: NDArray,
        volume: NDArray,
        dx: float,
        spans: Sequence[slice] = (slice(None),),
        copies: NDArray | None = None,
    ) -> RestLattice:
        """Return the lattices for the integration points of all bodies; bodies share no nodes.

        Args:
            x: Positions of the points at rest [P,3], m; eight consecutive points form a cell.
            mass: Masses of the points [P], kg.
            volume: Volumes of the points [P], m^3.
            dx: Side of a cell [m].
            spans: Points of each body, in order.
            copies: For each cell, the copies of its 27 nodes that it uses [C,27]; None: no copies.

        Raises:
            ValueError: The points do not form cells of eight.
        """
        bodies = [
            cls._of_body(x[span], mass[span], volume[span], dx, _copies_in(copies, span))
            for span in spans
        ]
        if len(bodies) == 1:
            return bodies[0]
        counts = [len(body) for body in bodies]
        starts = np.cumsum([0, *counts])[:-1]

        def join(name: str, shifted: bool = False) -> NDArray:
            return np.concatenate(
                [
                    getattr(b, name) + (s if shifted else 0)
                    for b, s in zip(bodies, starts, strict=True)
                ]
            )

        ties, pushes = (
            scipy.sparse.csr_matrix(scipy.sparse.block_diag(parts, format="csr"))
            for parts in ([body.ties for body in bodies], [body.pushes for body in bodies])
        )
        return cls(
            float(dx),
            join("index"),
            join("rows", True).astype(np.int32),
            join("offset"),
            join("mass"),
            join("tied", True),
            ties,
            pushes,
            np.repeat(np.arange(len(bodies)), counts),
            join("source", True),
        )

    @classmethod
    def _of_body(
        cls, x: NDArray, mass: NDArray, volume: NDArray, dx: float, copies: NDArray | None
    ) -> RestLattice:
        if len(x) % PER_CELL:
            raise ValueError("the number of points is not a multiple of eight; use lattice_of")
        x = np.asarray(x, np.float64) / dx
        middle = x.reshape(-1, PER_CELL, 3).mean(axis=1)
        cell = np.floor(middle).astype(np.int64)
        low, size = cell.min(axis=0) - 1, np.ptp(cell, axis=0) + 3
        touched = cell[:, None] - low + STEPS
        keys = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(touched, -1, 0)), tuple(size)))
        room = 1
        if copies is not None:
            room = int(copies.max()) + 1
            keys = keys * room + copies
        distinct = np.unique(keys.reshape(-1), return_inverse=True)
        nodes, number = cast("tuple[NDArray[np.int64], NDArray[np.int64]]", distinct)
        number = number.reshape(len(cell), 27)
        index = np.stack(np.unravel_index(nodes // room, tuple(size)), axis=1) + low
        offset = x - np.repeat(cell, PER_CELL, axis=0) + 0.5
        weights = _weights(offset)
        of_nodes, filled = (
            _add_to_nodes(weights, each, number, len(nodes)) for each in (mass, volume)
        )
        density = np.full(len(nodes), float(mass.sum() / volume.sum()))
        np.divide(of_nodes, filled, out=density, where=filled > 0)
        # In a body of needles or thin sheets, no node is as heavy as a node inside a body.
        whole = density * min(dx**3, filled.max() / GIVING)
        # Shares of a cell that use the same nodes count as one cell.
        _, single = np.unique(number if room > 1 else number[:, :1], axis=0, return_index=True)
        uses = np.bincount(number[single].ravel(), minlength=len(nodes))
        corner = (uses == 1) & (of_nodes < CORNER * whole)
        tied, ties, of_nodes = tie_light(index, number, of_nodes, LIGHTEST * whole, corner)
        of_nodes, shares = share_mass(index, number, of_nodes, LIGHT * whole, GIVING * whole)
        carried = ties.T @ rows_of_identity(tied, len(index))
        pushes = scipy.sparse.csr_matrix(carried + shares + shares @ carried)
        rows, source = number[:, ::3], np.arange(len(index))
        # If cells use only later copies of a node, the first copy that they use becomes the node's
        # first copy.
        copy = np.arange(len(nodes)) - np.searchsorted(nodes // room, nodes // room)
        if copy.any():
            layout = lay_out(index, copy, number)
            tied, ties, pushes = layout.repeat(tied, ties, pushes)
            index, rows, source = index[layout.node], layout.rows, layout.home[layout.node]
            of_nodes = np.where(layout.repeats, 0, of_nodes[layout.node])
        body = np.zeros(len(index), np.int64)
        rows = rows.astype(np.int32)
        return cls(float(dx), index, rows, offset, of_nodes, tied, ties, pushes, body, source)

    def __len__(self) -> int:
        return len(self.index)

    @property
    def x(self) -> NDArray[np.float64]:
        """Positions of the nodes at rest [N,3], m."""
        return (self.index.astype(np.float64) + 0.5) * self.dx

    @cached_property
    def copied(self) -> NDArray[np.bool_]:
        """Whether separate pieces of the body use separate copies of each node [N]."""
        mask = np.zeros(len(self), bool)
        if (self.source == np.arange(len(self))).all():
            return mask
        homes = np.flatnonzero(self.source == np.arange(len(self)))
        rows = np.column_stack([self.body, self.index])
        _, which, count = np.unique(rows[homes], axis=0, return_inverse=True, return_counts=True)
        mask[homes] = count[which.reshape(-1)] > 1
        mask |= mask[self.source]
        return mask

    @property
    def sides(self) -> NDArray[np.int64]:
        """The number of the separate piece that each cell belongs to [C].

        The number is 0 if the nodes of the cell have no copies.
        """
        nodes = self.source[self.nodes_of()]
        cell, place = np.nonzero(self.copied[nodes])
        if not len(cell):
            return np.zeros(len(nodes), np.int64)
        ones, size = np.ones(len(cell), np.int8), len(nodes) + len(self)
        pairs = scipy.sparse.coo_matrix(
            (ones, (cell, len(nodes) + nodes[cell, place])), shape=(size, size)
        )
        _, group = scipy.sparse.csgraph.connected_components(pairs, directed=False)
        touching = np.zeros(len(nodes), bool)
        touching[cell] = True
        sides: NDArray[np.int64] = np.where(touching, group[: len(nodes)] + 1, 0)
        return sides

    def step_from(self, nodes: NDArray, step: NDArray) -> NDArray[np.int64]:
        """Return the neighbours of `nodes` [K] in the directions `step` [K,3]; -1: none.

        If the neighbour has copies, the result is the copy in the same piece as the first node.
        """
        target = self.find(self.index[nodes] + step, self.body[nodes])
        doubtful = np.flatnonzero((target >= 0) & (self.copied[nodes] | self.copied[target]))
        every = self.source[self.nodes_of()]
        for k in doubtful:
            cell, place = np.nonzero(every == self.source[nodes[k]])
            way = STEPS[place] + step[k]
            inside = (np.abs(way) <= 1).all(axis=1)
            targets = every[cell[inside], (way[inside] + 1) @ [9, 3, 1]]
            target[k] = targets.min(initial=len(self))
        return np.where(target < len(self), target, -1)

    def nodes_of(self, cells: NDArray | slice = slice(None)) -> NDArray[np.int64]:
        """Return the 27 nodes of some cells [K,27]."""
        rows = self.rows[cells].astype(np.int64)
        return (rows[:, :, None] + np.arange(3)).reshape(-1, 27)

    def points_of(self, cells: NDArray) -> NDArray[np.float64]:
        """Return the positions of the points of some cells at rest [K,8,3], cells."""
        first = self.index[self.rows[cells, 0]][:, None]
        points: NDArray[np.float64] = first + self.offset.reshape(-1, PER_CELL, 3)[cells] + 0.5
        return points

    def motion_of(self, points: NDArray[np.int64]) -> scipy.sparse.csr_matrix:
        """Return the weights [K,N] of the nodes with mass in the motion of integration points."""
        weights, shape = _weights(self.offset[points]), (len(points), len(self))
        nodes, starts = self.nodes_of(points // PER_CELL), np.arange(len(points) + 1) * 27
        direct = scipy.sparse.csr_matrix((weights.ravel(), nodes.ravel(), starts), shape=shape)
        heavy = self.mass > 0
        free = rows_of_identity(np.flatnonzero(heavy), len(self))
        follow = rows_of_identity(self.tied, len(self)).T @ self.ties
        motion = scipy.sparse.csr_matrix(direct @ (free.T @ free + follow))
        motion.sum_duplicates()
        motion.eliminate_zeros()
        return motion

    @property
    def across(self) -> int:
        """Sum of the largest extents of all bodies on lattices [cells]."""
        bodies = [self.index[self.body == body] for body in np.unique(self.body)]
        return sum(int(np.ptp(index, axis=0).max()) - 1 for index in bodies)

    def respond(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return accelerations of integration points [P], m/s^2, due to forces in one direction
        [P], N.

        Accelerations are computed only in cells on which forces act, and are 0 elsewhere.
        """
        chosen = np.repeat(force.reshape(-1, PER_CELL).any(axis=1), PER_CELL)
        rows = np.repeat(self.rows, PER_CELL, axis=0)[chosen]
        nodes = (rows[:, :, None] + np.arange(3)).reshape(-1, 27)
        weights = _weights(self.offset[chosen])
        push = np.bincount(
            nodes.ravel(), (weights * force[chosen, None]).ravel(), minlength=len(self)
        )
        push += self.pushes @ push
        a = np.divide(push, self.mass, out=np.zeros(len(self)), where=self.mass > 0)
        a[self.tied] = self.ties @ a
        result = np.zeros(len(force))
        result[chosen] = (weights * a[nodes]).sum(axis=1)
        return result

    def passes_to(self, pushed: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask of the nodes that receive part of the forces on the nodes `pushed` [N]."""
        receives: NDArray[np.bool_] = (abs(self.pushes) @ pushed.astype(np.float32)) > 0
        return receives

    def find(self, index: NDArray, body: NDArray | int = 0) -> NDArray[np.int64]:
        """Return the indices of the nodes of bodies at grid positions `index` [...,3]; -1: no node.

        If a node has copies, the first copy is returned.
        """
        low, size = self.index.min(axis=0), np.ptp(self.index, axis=0) + 1
        shape = (int(self.body[-1]) + 1, *size.tolist())
        keys: NDArray = np.asarray(np.ravel_multi_index((self.body, *(self.index - low).T), shape))
        order = np.argsort(
            keys, kind="stable"
        )  # The first copy of a node comes before the other copies.
        keys = keys[order]
        inside = ((index >= low) & (index < low + size)).all(axis=-1)
        at = np.clip(index - low, 0, size - 1)
        bodies = np.broadcast_to(body, at.shape[:-1])
        wanted = np.ravel_multi_index((bodies, *np.moveaxis(at, -1, 0)), shape)
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(inside & (keys[place] == wanted), order[place], -1)


def _copies_in(copies: NDArray | None, span: slice) -> NDArray[np.int64] | None:
    if copies is None:
        return None
    start, stop = (end // PER_CELL if end is not None else None for end in (span.start, span.stop))
    mine: NDArray[np.int64] = copies[start:stop].astype(np.int64)
    return mine if mine.any() else None


def _add_to_nodes(
    weights: NDArray, of_points: NDArray, number: NDArray[np.int64], count: int
) -> NDArray:
    """Distribute a quantity of the points [P] to the nodes `number` [C,27] of their cells [N]."""
    of_cells = (weights * of_points[:, None]).reshape(len(number), PER_CELL, 27).sum(axis=1)
    return np.bincount(number.ravel(), of_cells.ravel(), count)


def splines(offset: NDArray) -> NDArray[np.float64]:
    """Return quadratic B-spline weights of three nodes [...,3].

    `offset` is the position relative to the first node [cells].
    """
    parts = [0.5 * (1.5 - offset) ** 2, 0.75 - (offset - 1) ** 2, 0.5 * (offset - 0.5) ** 2]
    return np.stack(parts, axis=-1)


def _weights(offset: NDArray) -> NDArray[np.float64]:
    """Return the weights of a cell's 27 nodes at points [P,27]."""
    x, y, z = np.moveaxis(splines(offset), 1, 0)
    across = (x[:, :, None] * y[:, None, :]).reshape(-1, ROW, 1)
    product: NDArray[np.float64] = across * z[:, None, :]
    return product.reshape(len(offset), 27)
