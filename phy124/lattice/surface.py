"""Finds the surface points of bodies, with the nodes and weights through which contact acts.

The weights of a surface point are computed for a position a quarter of a cell inside the body. Tied
nodes get no weight. The weights are then corrected to reproduce every linear function at the point.
With the exact weights at the surface, contact would act mostly on the lightest nodes, which would
vibrate.

The points are sorted into eight groups. Points of one group are at least about one cell apart. In
this order, the error after a Gauss-Seidel sweep is a tenth of the error after a sweep from row to
row.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from phy124.kernels.lattice.partners import OTHER
from phy124.lattice.rest import STEPS, RestLattice, splines
from phy124.lattice.tips import exact_weights, nearest_points, points_in_tips, rows_of
from phy124.particles.lattice import APART, PER_CELL

INSIDE = 0.25
"""Depth below the surface at which a surface point's weights of nodes are computed [cells]."""
SUPPORTED = 0.5
"""Surface points with a smaller sum of weights on nodes with mass are removed."""
LEAST = 1e-6
"""Corrected weights with a smaller sum, relative to the sum before the correction, are not used."""
FLAT, EVEN = 0.9, 10
"""A surface point lies at an edge if the mean normal within a cell is shorter than `FLAT`. The
evenness of flat parts is `EVEN`; smaller numbers are levels of the length of the mean normal.
"""
ON_SURFACE, PROTRUSION, IN_TIP, IN_EDGE = range(4)
"""Kinds of surface points: points on the surface, Gaussians outside the material, and integration
points in tips and in edges.
"""
REGULAR = 1e-5
"""Smallest det / trace^3 of matrices of second moments that are inverted by cofactors."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Points at which bodies can touch walls, with the points' weights."""

    x: NDArray[np.float64]
    """Positions of the surface points at rest [S,3], m."""
    normal: NDArray[np.float64]
    """Outward normals of the surface points at rest [S,3]; zero on sheets."""
    body: NDArray[np.int64]
    """Body index of each point [S]."""
    side: NDArray[np.int64]
    """Number of the separate piece of the body to which each point belongs [S]; 0 if the point's
    nodes have no copies.
    """
    nodes: NDArray[np.int32]
    """Nodes of each point [S,27]: nine groups of three nodes that are consecutive in memory."""
    weights: NDArray[np.float64]
    """Weights of each surface point's nodes [S,27], with sum 1."""
    kind: NDArray[np.int64]
    """Kind of each surface point [S]: `ON_SURFACE`, `PROTRUSION`, `IN_TIP` or `IN_EDGE`."""
    of_nodes: NDArray[np.float64]
    """Positions at rest of all nodes [N,3], m."""
    dx: float
    """Side of a cell [m]."""

    @property
    def count(self) -> int:
        """Number of surface points."""
        return len(self.x)

    @property
    def is_protrusion(self) -> NDArray[np.bool_]:
        """Whether each surface point is a Gaussian outside the material [S]."""
        return self.kind == PROTRUSION

    @property
    def is_inner(self) -> NDArray[np.bool_]:
        """Whether each surface point is an integration point inside the material [S]."""
        return (self.kind == IN_TIP) | (self.kind == IN_EDGE)

    @property
    def meets_bodies(self) -> NDArray[np.bool_]:
        """Whether each surface point can touch elastic bodies [S]; all points can touch walls.

        A block that slides along the edge of another block would be stopped by points in edges.
        """
        return (self.kind == ON_SURFACE) | (self.kind == IN_TIP)

    @cached_property
    def slopes(self) -> Lazy:
        """Weights of the nodes in the gradient at each point [S,27,3], 1/m."""
        compute = partial(_slopes_at, self.x, self.nodes, self.weights, self.of_nodes)
        return Lazy(np.zeros((self.count, 27, 3)), compute)

    @cached_property
    def evenness(self) -> Lazy:
        """Agreement of the normals near each point [S], from 0 to `EVEN`."""
        outer = np.flatnonzero(self.kind != IN_EDGE)
        around = outer, KDTree(self.x[outer])
        compute = partial(_evenness_at, self.x, self.normal, self.body, self.dx, around)
        return Lazy(np.zeros(self.count, np.int64), compute)

    def place(self, u: NDArray) -> NDArray[np.float64]:
        """Return the positions of all points [S,3], m.

        `u` [N,3], m, are the displacements of all nodes.
        """
        return self.x + (self.weights[:, :, None] * u[self.nodes]).sum(axis=1)

    def deform(
        self, points: NDArray[np.int64], u: NDArray
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return deformation gradients F [K,3,3], their cofactors, and normals [K,3] at K points.

        `u` [N,3], m, are the displacements of all nodes.
        """
        F = np.eye(3) + np.swapaxes(u[self.nodes[points]], 1, 2) @ self.slopes[points]
        turned = _cofactors(F)
        normal = (turned @ self.normal[points][:, :, None])[:, :, 0]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        return F, turned, normal


class Lazy:
    """A value for each surface point, which is computed only when it is first needed."""

    def __init__(
        self, values: NDArray[Any], compute: Callable[[NDArray[np.int64]], NDArray]
    ) -> None:
        self._values, self._compute = values, compute
        self._known = np.zeros(len(values), bool)

    def __getitem__(self, points: NDArray[np.int64]) -> NDArray[Any]:
        new = points[~self._known[points]]
        if len(new):
            self._values[new], self._known[new] = self._compute(new), True
        return self._values[points]


def _slopes_at(
    x: NDArray, nodes: NDArray, weights: NDArray, of_nodes: NDArray, points: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the weights in the gradient at some surface points [K,27,3], 1/m."""
    weights = weights[points]
    arm = of_nodes[nodes[points]] - x[points, None]
    arm *= (weights != 0)[:, :, None]
    weighted = weights[:, :, None] * arm
    slopes: NDArray[np.float64] = weighted @ _inverses(np.swapaxes(weighted, 1, 2) @ arm)
    return slopes


def _evenness_at(
    x: NDArray,
    normal: NDArray,
    body: NDArray,
    dx: float,
    around: tuple[NDArray[np.int64], KDTree],
    points: NDArray[np.int64],
) -> NDArray[np.int64]:
    outer, tree = around
    near = KDTree(x[points]).sparse_distance_matrix(tree, dx, output_type="ndarray")
    a, b = near["i"], outer[near["j"]]
    # Points on the opposite side of a thin part are ignored.
    aligned = (normal[points][a] * normal[b]).sum(axis=1) > OTHER
    same = (b == points[a]) | (aligned & (body[b] == body[points][a]))
    a, b = a[same], b[same]
    total = [np.bincount(a, n, len(points)) for n in normal[b].T]
    length = np.linalg.norm(total, axis=0)
    enough = FLAT * np.maximum(np.bincount(a, minlength=len(points)), 1)
    level = np.minimum((EVEN * length / enough).astype(np.int64), EVEN - 1)
    return np.where(length > enough, EVEN, level)


def make_surface(points: NDArray, lattice: RestLattice) -> Surface:
    """Return the surface points with enough weight on the nodes of the lattice.

    `points` [S,8] are rows as in `Particles.surface`.
    """
    protrudes = points[:, 7] > 0
    points, protrusions = points[~protrudes], points[protrudes]
    tips, in_edge = points_in_tips(points, lattice)
    inner = np.concatenate([np.full(len(points), -1), tips, nearest_points(protrusions, lattice)])
    kinds = np.repeat([ON_SURFACE, IN_TIP, PROTRUSION], [len(points), len(tips), len(protrusions)])
    kinds[len(points) : len(points) + len(tips)][in_edge] = IN_EDGE
    points = np.concatenate([points, rows_of(tips, lattice), protrusions])
    parity = np.floor(points[:, :3] / (APART * lattice.dx) - 1e-6).astype(np.int64) % 2
    order = np.argsort(parity @ [4, 2, 1], kind="stable")
    points, inner, kinds = points[order], inner[order], kinds[order]
    x, normal, body = points[:, :3], points[:, 3:6], points[:, 6].astype(np.int64)
    at = x / lattice.dx - INSIDE * normal
    within = inner >= 0
    at[within] = rows_of(inner[within], lattice)[:, :3] / lattice.dx
    cell = np.floor(at).astype(np.int64)
    index = cell[:, None] + STEPS
    nodes = lattice.find(index, body[:, None])
    side = np.zeros(len(x), np.int64)
    near = (lattice.copied[nodes] & (nodes >= 0)).any(axis=1)
    if near.any():
        piece = _nearest_pieces(at[near], body[near], lattice)
        nodes[near] = lattice.source[lattice.nodes_of(piece)]
        cell[near] = lattice.index[lattice.rows[piece, 0]] + 1
        at[near] = np.clip(at[near], cell[near] - INSIDE, cell[near] + 1 + INSIDE)
        index, side[near] = cell[:, None] + STEPS, lattice.sides[piece]
    free = nodes >= 0
    free[free] = lattice.mass[nodes[free]] > 0
    a, b, c = np.moveaxis(splines(at - cell + 0.5), 1, 0)
    weights = np.einsum("pi,pj,pk->pijk", a, b, c).reshape(len(x), 27) * free
    weights[near] = _within_rows(nodes[near], weights[near])
    supported = weights.sum(axis=1) > SUPPORTED
    x, normal, weights, inner = (values[supported] for values in (x, normal, weights, inner))
    body, side, nodes, kinds = (values[supported] for values in (body, side, nodes, kinds))
    arm = index[supported] + 0.5 - (x / lattice.dx)[:, None]
    weighted = weights[:, :, None] * arm
    first, second = weighted.sum(axis=1), np.swapaxes(weighted, 1, 2) @ arm
    slope = -np.einsum("pab,pb->pa", np.linalg.pinv(second, hermitian=True), first)
    corrected = weights * (1 + np.einsum("pna,pa->pn", arm, slope))
    # If all nodes of a point are in one plane, the corrected weights may be 0.
    sound = corrected.sum(axis=1) > LEAST * weights.sum(axis=1)
    weights = np.where(sound[:, None], corrected, weights)
    weights /= weights.sum(axis=1, keepdims=True)
    nodes, weights = _consecutive(nodes, weights, len(lattice))
    within = inner >= 0
    if within.any():
        nodes[within], weights[within] = exact_weights(inner[within], x[within], lattice)
    return Surface(x, normal, body, side, nodes, weights, kinds, lattice.x, lattice.dx)


def _nearest_pieces(
    at: NDArray[np.float64], body: NDArray[np.int64], lattice: RestLattice
) -> NDArray[np.int64]:
    """Return, for each position `at` [K,3], cells, the cell with the nearest integration
    point [K].
    """
    nearest = np.zeros(len(at), np.int64)
    of_cells = lattice.body[lattice.rows[:, 0]]
    for number in np.unique(body):
        cells, mine = np.flatnonzero(of_cells == number), body == number
        _, point = KDTree(lattice.points_of(cells).reshape(-1, 3)).query(at[mine])
        nearest[mine] = cells[point // PER_CELL]
    return nearest


def _within_rows(nodes: NDArray[np.int64], weights: NDArray) -> NDArray[np.float64]:
    """Keep, in each group, the weights of the three consecutive nodes with the largest sum [S,27].

    All other weights become 0. A copy of a node may be far away in memory from the other nodes of a
    group.
    """
    nodes, weights = nodes.reshape(-1, 1, 3), weights.reshape(-1, 1, 3)
    start = np.swapaxes(nodes, 1, 2)
    fits = (nodes >= start) & (nodes < start + 3)
    best = np.argmax((fits * weights).sum(axis=2), axis=1)
    kept: NDArray[np.float64] = weights[:, 0] * fits[np.arange(len(best)), best]
    return kept.reshape(-1, 27)


def _consecutive(
    nodes: NDArray[np.int64], weights: NDArray[np.float64], count: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return nodes and weights [S,27] in nine groups of three nodes that are consecutive in memory.

    The nodes of a lattice are sorted along z, so the existing nodes of a group are consecutive. A
    group of fewer than three nodes is completed by neighbours in memory with weight 0.
    """
    nodes, weights = nodes.reshape(-1, 3), weights.reshape(-1, 3)
    used = weights != 0
    start = np.minimum(np.where(used, nodes, count).min(axis=1), count - 3)
    shifted = np.zeros_like(weights)
    row, column = np.nonzero(used)
    shifted[row, nodes[row, column] - start[row]] = weights[row, column]
    rows = (start[:, None] + np.arange(3)).astype(np.int32)
    return rows.reshape(-1, 27), shifted.reshape(-1, 27)


def _inverses(moments: NDArray) -> NDArray[np.float64]:
    """Return the inverses of matrices of second moments [K,3,3], or pseudoinverses if singular."""
    turned = _cofactors(moments)
    det = (moments[:, 0] * turned[:, 0]).sum(axis=1)
    # The ratio of the smallest to the largest eigenvalue is at least det / trace^3.
    flat = ~(det > REGULAR * np.trace(moments, axis1=1, axis2=2) ** 3)
    inverses: NDArray[np.float64] = turned / np.where(flat, 1.0, det)[:, None, None]
    if flat.any():
        inverses[flat] = np.linalg.pinv(moments[flat], rcond=1e-6, hermitian=True)
    return inverses


def _cofactors(F: NDArray) -> NDArray[np.float64]:
    rows = [np.cross(F[:, (i + 1) % 3], F[:, (i + 2) % 3]) for i in range(3)]
    return np.stack(rows, axis=1)
