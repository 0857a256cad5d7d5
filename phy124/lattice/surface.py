"""Finds a body's surface points, with the nodes and weights by which contact acts on them.

A point takes its weights from a place a quarter of a cell further inside, without the tied nodes,
and corrected so that they reproduce every linear function at the point itself. The true weights at
the surface lean on the lightest nodes, which would chatter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.lattice.rest import STEPS, RestLattice, splines

INSIDE = 0.25
"""Depth at which weights are taken [cells]."""
SUPPORTED = 0.5
"""Smallest sum of weights of free nodes; points with less are dropped."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Points at which the body touches walls, and their weights."""

    x: NDArray[np.float64]
    """Positions at rest [S,3], m."""
    normal: NDArray[np.float64]
    """Outward normals at rest [S,3]; zero on sheets."""
    nodes: NDArray[np.int32]
    """Nodes of each point [S,27]; 0 where the weight is 0."""
    weights: NDArray[np.float64]
    """Weights of the nodes [S,27], with sum 1."""

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.x)


def make_surface(points: NDArray, lattice: RestLattice) -> Surface:
    """Return the surface points that the lattice supports.

    Args:
        points: Positions [m] and outward normals, as rows of six numbers [S,6].
        lattice: The lattice at rest.
    """
    x, normal = points[:, :3], points[:, 3:]
    at = x / lattice.dx - INSIDE * normal
    cell = np.floor(at).astype(np.int64)
    index = cell[:, None] + STEPS
    nodes = lattice.find(index)
    free = nodes >= 0
    free[free] = lattice.mass[nodes[free]] > 0
    a, b, c = np.moveaxis(splines(at - cell + 0.5), 1, 0)
    weights = np.einsum("pi,pj,pk->pijk", a, b, c).reshape(len(x), 27) * free
    supported = weights.sum(axis=1) > SUPPORTED
    x, normal, nodes, weights = (
        x[supported],
        normal[supported],
        nodes[supported],
        weights[supported],
    )
    arm = index[supported] + 0.5 - (x / lattice.dx)[:, None]
    first = np.einsum("pn,pna->pa", weights, arm)
    second = np.einsum("pn,pna,pnb->pab", weights, arm, arm)
    slope = -np.einsum("pab,pb->pa", np.linalg.pinv(second, hermitian=True), first)
    weights = weights * (1 + np.einsum("pna,pa->pn", arm, slope))
    weights /= weights.sum(axis=1, keepdims=True)
    return Surface(x, normal, np.where(weights != 0, nodes, 0).astype(np.int32), weights)
