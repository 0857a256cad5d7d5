"""Finds integration points in tips, hairs and edges, where they are surface points as well.

The weights of other surface points leave out tied nodes. A tip that is smaller than a cell could
therefore enter a wall while its surface points stay outside. The weights of the points in tips are
therefore exact: each tied node is replaced by the nodes from which its motion is extrapolated.
"""

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import KDTree

from phy124.lattice.rest import ROW, RestLattice
from phy124.particles.lattice import PER_CELL

SHARP, EDGE = 0.6, 0.85
"""A part of a body is sharp if the mean normal within a cell is shorter than `SHARP`. It is an edge
if the mean normal is longer than `SHARP` but shorter than `EDGE`.
"""
CLOSEST = 24
"""Largest number of nearby normals that are averaged to find sharp parts."""
CELLS = 4
"""Number of cells in which the integration point nearest to a protrusion is searched."""
ABOVE = 0.3
"""Integration points higher above the surface than this serve as surface points [cells]."""


def points_in_tips(
    points: NDArray, lattice: RestLattice
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the integration points in sharp parts and edges of a body that use tied nodes [K], and
    whether each is in an edge [K].

    `points` [S,8] are rows as in `Particles.surface`.
    """
    light = lattice.tied[lattice.source[lattice.tied] == lattice.tied]
    cells = np.flatnonzero(np.isin(lattice.nodes_of(), light).any(axis=1))
    if not len(cells) or not len(points):
        return np.zeros(0, np.int64), np.zeros(0, bool)
    inner = (cells[:, None] * PER_CELL + np.arange(PER_CELL)).ravel()
    rows = rows_of(inner, lattice)
    count = min(CLOSEST, len(points))
    distance, near = KDTree(points[:, :3]).query(
        rows[:, :3], k=count, distance_upper_bound=lattice.dx
    )
    distance, near = distance.reshape(len(rows), count), near.reshape(len(rows), count)
    near = np.minimum(near, len(points) - 1)
    same = np.isfinite(distance) & (points[near, 6] == rows[:, 6:7])
    total = (points[near, 3:6] * same[:, :, None]).sum(axis=1)
    length, number = np.linalg.norm(total, axis=1), same.sum(axis=1)
    nearest = points[near[:, 0]]
    height = ((rows[:, :3] - nearest[:, :3]) * nearest[:, 3:6]).sum(axis=1)
    sharp = (length < SHARP * number) | (same[:, 0] & (height > ABOVE * lattice.dx))
    chosen = sharp | (length < EDGE * number)
    return inner[chosen], ~sharp[chosen]


def rows_of(inner: NDArray[np.int64], lattice: RestLattice) -> NDArray[np.float64]:
    """Return rows [K,8] of integration points, as in `Particles.surface`; normals are zero."""
    cells = inner // PER_CELL
    x = lattice.points_of(cells)[np.arange(len(inner)), inner % PER_CELL] * lattice.dx
    body = lattice.body[lattice.rows[cells, 0]]
    return np.column_stack([x, np.zeros_like(x), body.astype(np.float64), np.zeros(len(x))])


def nearest_points(points: NDArray, lattice: RestLattice) -> NDArray[np.int64]:
    """Return an integration point near each of the surface points with rows `points` [K,8].

    This integration point is the nearest of those in the `CELLS` cells with the nearest centres.
    """
    x = lattice.points_of(np.arange(len(lattice.rows))) * lattice.dx
    body, nearest = lattice.body[lattice.rows[:, 0]], np.zeros(len(points), np.int64)
    for number in np.unique(points[:, 6]):
        cells, mine = np.flatnonzero(body == number), np.flatnonzero(points[:, 6] == number)
        count = min(CELLS, len(cells))
        _, near = KDTree(x[cells].mean(axis=1)).query(points[mine, :3], k=count)
        near = cells[near.reshape(len(mine), count)]
        inner = (PER_CELL * near[:, :, None] + np.arange(PER_CELL)).reshape(len(mine), -1)
        way = x.reshape(-1, 3)[inner] - points[mine, None, :3]
        best = np.linalg.norm(way, axis=2).argmin(axis=1)
        nearest[mine] = inner[np.arange(len(mine)), best]
    return nearest


def exact_weights(
    inner: NDArray[np.int64], x: NDArray, lattice: RestLattice
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the nodes with mass that move the integration points `inner`, and weights [K,27].

    The nodes form nine groups of three nodes that are consecutive in memory, like the nodes of
    other surface points. If nine groups do not contain all nodes, the weights are corrected to
    reproduce every linear function.
    """
    nodes, weights = _three_in_a_row(lattice.motion_of(inner))
    arm = lattice.index[nodes] + 0.5 - x[:, None] / lattice.dx
    basis = np.concatenate([np.ones((*arm.shape[:2], 1)), arm], axis=2)
    missed = np.array([1.0, 0, 0, 0]) - np.einsum("pn,pna->pa", weights, basis)
    short = np.abs(missed).max(axis=1) > 1e-9
    basis, part = basis[short], np.abs(weights[short])
    moments = np.einsum("pn,pna,pnb->pab", part, basis, basis)
    change = np.einsum("pab,pb->pa", np.linalg.pinv(moments, hermitian=True), missed[short])
    weights[short] += part * np.einsum("pna,pa->pn", basis, change)
    return nodes, weights


def _three_in_a_row(motion: scipy.sparse.csr_matrix) -> tuple[NDArray[np.int64], NDArray]:
    """Return nodes and weights [K,27] in nine groups of three nodes that are consecutive in memory.

    The groups with the largest weights are chosen, one after another. `motion` [K,N] are the
    weights of all nodes in the motion of each point.
    """
    count, sizes = motion.shape[1], np.diff(motion.indptr)
    row = np.repeat(np.arange(len(sizes)), sizes)
    place = np.arange(motion.nnz) - motion.indptr[row]
    shape = len(sizes), int(sizes.max(initial=0)) + 2
    node, weight = np.full(shape, 4 * count), np.zeros(shape)
    node[row, place], weight[row, place] = motion.indices, motion.data
    each = np.arange(len(sizes))
    nodes = np.zeros((len(sizes), ROW, 3), np.int64)
    weights = np.zeros(nodes.shape)
    for group in range(ROW):
        size = np.abs(weight)
        total = size[:, :-2].copy()
        for step in (1, 2):
            last = len(size[0]) - 2 + step
            near = node[:, step:last] < node[:, :-2] + 3
            total += size[:, step:last] * near
        best = total.argmax(axis=1)
        start = np.minimum(node[each, best], count - 3)
        nodes[:, group] = start[:, None] + np.arange(3)
        for step in range(3):
            to = node[each, best + step] - start
            inside = to < 3
            weights[each[inside], group, to[inside]] += weight[inside, best[inside] + step]
            weight[inside, best[inside] + step] = 0
    return nodes.reshape(-1, 3 * ROW), weights.reshape(-1, 3 * ROW)
