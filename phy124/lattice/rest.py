"""Builds the lattices of bodies at rest: nodes, cells, weights of points, masses and tied nodes.

Node i is at (i + 1/2) dx, in the middle of cell i, and its quadratic B-spline covers the cells i -
1 to i + 1. A cell's eight points (phy124/particles/lattice.py) therefore use the same 27 nodes, and
each weight is a single polynomial in the cell. If the points were between nodes instead, some
motions of partly filled cells would have no stiffness.

If a body only partly fills its cells, some nodes have almost no mass and stiffness. Nodes lighter
than `LIGHTEST` are tied: their motion is extrapolated linearly from heavier nodes. The transpose of
this extrapolation distributes a tied node's force and mass over these heavier nodes, so that
momentum and angular momentum are conserved.
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
from phy124.particles.lattice import PER_CELL

LIGHTEST = 1e-3
"""A node is tied if its mass is less than this fraction of the mass of a node inside the body. With
a value of 0.01, plates with a thickness of 0.3 cells would be 4 to 14 % too stiff.
"""
CORNER = 0.01
"""Like `LIGHTEST`, but for a node that belongs to a single cell. Even if such a node moves by many
cells, the points of the cell are only slightly strained, so large forces would turn the cell inside
out.
"""
LIGHT, GIVING = 0.02, 0.2
"""Nodes that are not tied get at least the mass `LIGHT`; the added mass is taken from nodes with at
least the mass `GIVING`. Both values are relative to the mass of a node inside the body. Lighter
nodes would vibrate too fast in squeezed parts of the body.
"""
DONORS, NEAR = 27, 3.0
"""The motion of a tied node is extrapolated from at most `DONORS` nodes closer than `NEAR` [cells].
"""
ROW = 9
"""Number of rows per cell; a row is three nodes along z."""
STEPS = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Indices of the 27 nodes of a cell, relative to the cell's middle node."""


@dataclass(frozen=True, eq=False)
class RestLattice:
    """The nodes of bodies at rest (sorted by body, then x, y, z), and the weights of points."""

    dx: float
    """Side of a cell [m]."""
    index: NDArray[np.int64]
    """Indices of the nodes [N,3]."""
    rows: NDArray[np.int32]
    """First node of each of a cell's nine rows of three nodes along z [C,9]."""
    offset: NDArray[np.float64]
    """Position of each point relative to its cell's first node [P,3], in cells, about 0.5 to 1.5.
    """
    mass: NDArray[np.float64]
    """Mass of each node, including its tied nodes [N], kg; 0 for a tied node."""
    tied: NDArray[np.int64]
    """Indices of the tied nodes [T]."""
    ties: scipy.sparse.csr_matrix
    """Weights of all nodes in the motion of each tied node [T,N]."""
    pushes: scipy.sparse.csr_matrix
    """Weights with which pushes on other nodes are added to the push on each node [N,N]. A push on
    a tied node, or on mass that was moved to another node, then acts on the node with the mass. A
    uniform push therefore accelerates all nodes equally.
    """
    body: NDArray[np.int64]
    """Index of the body of each node [N]."""
    source: NDArray[np.int64]
    """Index of the node that each node repeats [N]; the node's own index if it repeats no other
    node.
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
        """Return the lattices for the integration points of all bodies; no node belongs to two
        bodies.

        Args:
            x: Positions of the points at rest [P,3], m; eight consecutive points form a cell.
            mass: Masses of the points [P], kg.
            volume: Volumes of the points [P], m^3.
            dx: Side of a cell [m].
            spans: Points of each body, in order.
            copies: Copy of each of the 27 nodes that a cell uses [C,27]; None: nodes have no
                copies.

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
        """Return the lattice of one body; raises ValueError."""
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
        of_nodes = np.bincount(
            np.repeat(number, PER_CELL, axis=0).ravel(),
            (weights * mass[:, None]).ravel(),
            len(nodes),
        )
        density = float(mass.sum() / volume.sum())
        # In a body of needles or thin sheets, no node is as heavy as a node inside a body.
        whole = min(density * dx**3, of_nodes.max() / GIVING)
        corner = (np.bincount(number.ravel()) == 1) & (of_nodes < CORNER * whole)
        tied, ties, of_nodes = _tie_light(index, number, of_nodes, LIGHTEST * whole, corner)
        of_nodes, shares = _share(index, number, of_nodes, LIGHT * whole, GIVING * whole)
        carried = ties.T @ _rows(tied, len(index))
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
        """Return the number of nodes."""
        return len(self.index)

    @property
    def x(self) -> NDArray[np.float64]:
        """Positions of the nodes at rest [N,3], m."""
        return (self.index.astype(np.float64) + 0.5) * self.dx

    @cached_property
    def copied(self) -> NDArray[np.bool_]:
        """Whether each node has copies or is a copy [N]."""
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
        """Number of the piece to which each cell belongs [C]; 0 for a cell whose nodes have no
        copies.

        Cells that use the same copy of a node belong to the same piece.
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
        """Return the nodes at a given step from each node [K]; -1 if there is no such node.

        If there are copies, the result is the copy in the piece of the first node: some cell
        contains both nodes.

        Args:
            nodes: Indices of nodes [K].
            step: Steps of one node along one axis [K,3].
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

    @property
    def across(self) -> int:
        """Sum, over all bodies, of the largest extent [cells]."""
        bodies = [self.index[self.body == body] for body in np.unique(self.body)]
        return sum(int(np.ptp(index, axis=0).max()) - 1 for index in bodies)

    def respond(self, force: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the accelerations of the points [P], m/s^2, due to forces [P], N, along one
        direction.

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

    def find(self, index: NDArray, body: NDArray | int = 0) -> NDArray[np.int64]:
        """Return the indices of the nodes at given grid positions; -1 if there is no node.

        If a node has copies, the first copy is returned.

        Args:
            index: Indices of nodes [...,3].
            body: Indices of the bodies of these nodes [...].
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
    """Return the copies that the cells of a body use; None if nodes have no copies.

    Args:
        copies: Copies of all bodies [C,27].
        span: Points of the body.
    """
    if copies is None:
        return None
    start, stop = (end // PER_CELL if end is not None else None for end in (span.start, span.stop))
    mine: NDArray[np.int64] = copies[start:stop].astype(np.int64)
    return mine if mine.any() else None


def splines(offset: NDArray) -> NDArray[np.float64]:
    """Return the quadratic B-spline weights of three nodes [...,3] for offsets from the first
    node.
    """
    parts = [0.5 * (1.5 - offset) ** 2, 0.75 - (offset - 1) ** 2, 0.5 * (offset - 0.5) ** 2]
    return np.stack(parts, axis=-1)


def _weights(offset: NDArray) -> NDArray[np.float64]:
    """Return the weights of a cell's 27 nodes at points [P,27]."""
    x, y, z = np.moveaxis(splines(offset), 1, 0)
    product: NDArray[np.float64] = np.einsum("pi,pj,pk->pijk", x, y, z)
    return product.reshape(len(offset), 27)


def _tie_light(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    mass: NDArray,
    least: float,
    corner: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix, NDArray[np.float64]]:
    """Return the tied nodes, the weights of their donors, and the masses of all nodes (0 if tied).

    Args:
        index: Indices of the nodes [N,3].
        cells: The nodes of each cell [C,27].
        mass: Masses of the nodes [N], kg.
        least: A node is tied if its mass is smaller [kg].
        corner: Whether each node is tied regardless of its mass [N].
    """
    candidates, light = mass, corner
    # Weights can be negative, so nodes that would lose their mass are tied as well.
    while True:
        candidates = np.where(light, 0, candidates)
        tied, ties = _tie(index, cells, candidates, least, least)
        result: NDArray[np.float64] = mass + ties.T @ mass[tied]
        result[tied] = 0
        light = (result < least / 2) & (candidates > 0)
        light[tied] = False
        if not light.any():
            return tied, ties, result


def _share(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    mass: NDArray[np.float64],
    least: float,
    giving: float,
) -> tuple[NDArray[np.float64], scipy.sparse.csr_matrix]:
    """Move mass from heavy nodes to nodes lighter than `least` [kg]; return the new masses.

    The total mass and its centre are preserved. No node loses more than half of its mass. The
    returned matrix [N,N] moves forces along with the mass, since the moved mass has the
    acceleration of the light node.
    """
    light, weights = _tie(index, cells, mass, least, giving)
    light, weights = light[mass[light] > 0], weights[mass[light] > 0]
    wanted = least - mass[light]
    taken = abs(weights).T @ wanted
    part = np.minimum(1.0, 0.5 * mass / np.maximum(taken, 1e-300))
    links = weights.tocoo()
    worst = np.ones(len(light))
    np.minimum.at(worst, links.row, part[links.col])
    gained = np.zeros(len(mass))
    gained[light] = worst * wanted
    result: NDArray[np.float64] = mass + gained - weights.T @ gained[light]
    gains = _rows(light, len(mass))
    shares = (gains - weights).T @ gains.multiply((gained[light] / mass[light])[:, None])
    return result, scipy.sparse.csr_matrix(shares)


def _rows(chosen: NDArray[np.int64], count: int) -> scipy.sparse.csr_matrix:
    """Return some rows of the identity matrix of a given size."""
    shape, ones = (len(chosen), count), np.ones(len(chosen))
    return scipy.sparse.csr_matrix((ones, (np.arange(len(chosen)), chosen)), shape=shape)


def _tie(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    mass: NDArray,
    least: float,
    giving: float,
) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix]:
    """Return the nodes lighter than `least` [kg], and the weights that extrapolate their motion.

    The weights reproduce every linear function that is determined by the nearby nodes with a mass
    of at least `giving` [kg]. Nodes in a common cell with the light node are preferred. Other nodes
    may belong to another part of the body, such as a leaf near a stem, to which the light node
    would then be glued. A light node without a heavy node nearby is not tied.
    """
    count = len(index)
    light, heavy = np.flatnonzero(mass < least), np.flatnonzero(mass >= giving)
    if not len(light) or not len(heavy):
        return np.zeros(0, np.int64), scipy.sparse.csr_matrix((0, count))
    donors, distance = _nearest_in_cells(index, cells, light, heavy)
    weight, complete = _extrapolate(index, light, donors, distance)
    alone = np.flatnonzero(~complete)
    if (
        len(alone) and len(np.unique(index, axis=0)) < count
    ):  # The nearest node may be on another piece.
        donors[alone], away = _nearest_in_cells(index, cells, light[alone], heavy, chained=True)
        weight[alone], _ = _extrapolate(index, light[alone], donors[alone], away)
    elif len(alone):
        tree = scipy.spatial.KDTree(index[heavy])
        ranks = np.arange(DONORS) + 1
        away, near = tree.query(index[light[alone]], k=ranks, distance_upper_bound=NEAR)
        donors[alone] = heavy[np.where(np.isfinite(away), near, 0)]
        weight[alone], _ = _extrapolate(index, light[alone], donors[alone], away)
    tied = np.abs(weight.sum(axis=1) - 1) < 1e-6
    row, column = np.nonzero(weight[tied])
    entries = (weight[tied][row, column], (row, donors[tied][row, column]))
    return light[tied], scipy.sparse.csr_matrix(entries, shape=(int(tied.sum()), count))


def _nearest_in_cells(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    some: NDArray,
    heavy: NDArray,
    *,
    chained: bool = False,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the heavy nodes in a common cell with each of some nodes, sorted by distance.

    Args:
        index: Indices of the nodes [N,3].
        cells: The nodes of each cell [C,27].
        some: The nodes whose neighbours are returned [T].
        heavy: The nodes that may be returned [H].
        chained: Whether to include neighbours of neighbours (by common cells).

    Returns:
        The neighbours [T,`DONORS`] and their distances [cells]; infinite if there is no neighbour.
    """
    of_cells = np.repeat(np.arange(len(cells)), cells.shape[1])
    entries = (np.ones(cells.size, np.float32), (cells.ravel(), of_cells))
    touches = scipy.sparse.csr_matrix(entries, shape=(len(index), len(cells)))
    near = touches[some] @ touches.T @ touches if chained else touches[some]
    common = (near @ touches[heavy].T).tocoo()
    row, donor = common.row, heavy[common.col]
    far = np.linalg.norm(index[donor] - index[some[row]], axis=1)
    order = np.lexsort((donor, far, row))
    order = order[far[order] < NEAR]
    row = row[order]
    place = np.arange(len(row)) - np.searchsorted(row, row)
    row, order, place = (values[place < DONORS] for values in (row, order, place))
    donors = np.full((len(some), DONORS), heavy[0])
    distance = np.full((len(some), DONORS), np.inf)
    donors[row, place], distance[row, place] = donor[order], far[order]
    return donors, distance


def _extrapolate(
    index: NDArray[np.int64], light: NDArray, donors: NDArray, distance: NDArray
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the weights of the donors [T,K], and whether the donors determine linear functions
    [T].

    Args:
        index: Indices of the nodes [N,3].
        light: The nodes that are extrapolated [T].
        donors: The nodes from which each light node is extrapolated [T,K].
        distance: Distances of the donors [T,K], cells; infinite if there is no donor.
    """
    arm = (index[donors] - index[light][:, None]).astype(np.float64)
    basis = np.concatenate([np.ones((*arm.shape[:2], 1)), arm], axis=2)
    importance = np.exp(-(distance**2) / 1.5)
    moments = np.einsum("tn,tna,tnb->tab", importance, basis, basis)
    size, axes = np.linalg.eigh(moments)
    determined = size > 1e-8 * size[:, -1:]
    part = np.where(determined, axes[:, 0], 0) / np.where(determined, size, 1)
    constant = np.einsum("tk,tjk->tj", part, axes)
    complete = np.asarray(determined.all(axis=1))
    return importance * np.einsum("tna,ta->tn", basis, constant), complete
