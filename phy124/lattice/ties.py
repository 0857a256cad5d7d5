"""Ties nodes with almost no mass to heavier nodes, and gives other light nodes more mass.

The motion of a tied node is extrapolated from heavier nodes. The transpose of this extrapolation
distributes the tied node's force and mass over these nodes, so that momentum and angular momentum
are conserved. The extrapolation is exact for linear functions.

A node's mass is compared with the mass of a node deep inside a body whose density equals the local
density. Otherwise, all nodes of a material 1000 times lighter than the rest of the body would be
tied.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

LIGHTEST = 1e-3
"""A node that belongs to several cells is tied if its mass is less than this fraction of the mass
of a node inside the body. With a fraction of 0.01, plates with a thickness of 0.3 cells would be 4
to 14 % too stiff.
"""
CORNER = 0.01
"""A node that belongs to a single cell is tied if its mass is less than this fraction of the mass
of a node inside the body. If a node that belongs to a single cell moved by many cells, the points
of the cell would be only slightly strained. Large forces on such a node would therefore turn the
cell inside out.
"""
LIGHT = 0.02
"""Smallest mass of nodes that are not tied, relative to the mass of a node inside the body. Nodes
with a smaller mass would vibrate too fast.
"""
GIVING = 0.2
"""A node gives mass to light nodes only if its mass is at least this fraction of the mass of a node
inside the body.
"""
BENT, THIN = 3.0, 0.6
"""In thin parts of a body, the donors' weights are fitted to reproduce products of two coordinates
as well. `BENT` is the weight of these products in the fit. A part of a body is thin if each node
that gives mass (donor) has less than the fraction `THIN` of the mass of a node inside the body.
Without the products, a plate with a thickness of 0.3 cells on the border of two layers of cells
would be 20 % too stiff.
"""
DONORS = 27
"""Largest number of nodes from which the motion of a tied node is extrapolated (its donors)."""
NEAR = 3.0
"""Largest distance of a tied node from the nodes that determine its motion (donors) [cells]."""
FAR = 6.0
"""Largest distance of donors if the nodes within `NEAR` do not determine the motion [cells]."""


def tie_light(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    mass: NDArray,
    least: NDArray,
    corner: NDArray[np.bool_],
) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix, NDArray[np.float64]]:
    """Return the tied nodes, the weights of their donors, and the masses of all nodes (0 if tied).

    Args:
        index: Indices of the nodes [N,3].
        cells: The nodes of each cell [C,27].
        mass: Masses of the nodes [N], kg.
        least: A node is tied if its mass is smaller [N], kg.
        corner: Whether each node is tied regardless of its mass [N].
    """
    candidates, light, whole = mass, corner, least / LIGHTEST
    # Weights can be negative, so nodes that would lose their mass are tied as well.
    while True:
        candidates = np.where(light, 0, candidates)
        tied, ties = _tie(index, cells, candidates, least, least, whole, far=True)
        result: NDArray[np.float64] = mass + ties.T @ mass[tied]
        result[tied] = 0
        light = (result < least / 2) & (candidates > 0)
        light[tied] = False
        if not light.any():
            return tied, ties, result


def share_mass(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    mass: NDArray[np.float64],
    least: NDArray,
    giving: NDArray,
) -> tuple[NDArray[np.float64], scipy.sparse.csr_matrix]:
    """Move mass from heavy nodes to nodes lighter than `least`; return the new masses.

    The total mass and its centre are preserved. No node loses more than half of its mass. Forces
    are moved along with the mass, because the moved mass gets the acceleration of the light node;
    the returned matrix [N,N] moves them.

    Args:
        index: Indices of the nodes [N,3].
        cells: The nodes of each cell [C,27].
        mass: Masses of the nodes [N], kg; 0 if tied.
        least: Nodes that are not tied get at least this mass [N], kg.
        giving: Mass is taken from nodes with at least this mass [N], kg.
    """
    light, weights = _tie(index, cells, mass, least, giving, giving / GIVING)
    light, weights = light[mass[light] > 0], weights[mass[light] > 0]
    wanted = least[light] - mass[light]
    taken = abs(weights).T @ wanted
    part = np.ones(len(mass))
    np.divide(0.5 * mass, taken, out=part, where=taken > 0.5 * mass)
    links = weights.tocoo()
    worst = np.ones(len(light))
    np.minimum.at(worst, links.row, part[links.col])
    gained = np.zeros(len(mass))
    gained[light] = worst * wanted
    result: NDArray[np.float64] = mass + gained - weights.T @ gained[light]
    gains = rows_of_identity(light, len(mass))
    shares = (gains - weights).T @ gains.multiply((gained[light] / mass[light])[:, None])
    return result, scipy.sparse.csr_matrix(shares)


def rows_of_identity(chosen: NDArray[np.int64], count: int) -> scipy.sparse.csr_matrix:
    """Return some rows of the identity matrix of a given size."""
    shape, ones = (len(chosen), count), np.ones(len(chosen))
    return scipy.sparse.csr_matrix((ones, (np.arange(len(chosen)), chosen)), shape=shape)


def _tie(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    mass: NDArray,
    least: NDArray,
    giving: NDArray,
    whole: NDArray,
    *,
    far: bool = False,
) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix]:
    """Return the nodes lighter than `least`, and the weights that extrapolate their motion.

    The weights reproduce every linear function that is determined by the nearby nodes with a mass
    of at least `giving`. Nodes in a common cell with the light node are preferred, because other
    nodes may belong to another part of the body, such as a leaf near a stem. If the heavy nodes
    nearby do not determine the motion and `far` is true, heavy nodes up to a distance of `FAR` are
    used. `whole` is the mass of a node deep inside a body with the local density. All masses are in
    kg [N].
    """
    count, thin = len(index), mass < THIN * whole
    light, heavy = np.flatnonzero(mass < least), np.flatnonzero(mass >= giving)
    if not len(light) or not len(heavy):
        return np.zeros(0, np.int64), scipy.sparse.csr_matrix((0, count))
    donors, distance = _nearest_in_cells(index, cells, light, heavy)
    weight, complete = _extrapolate(index, light, donors, distance, thin)
    alone = np.flatnonzero(~complete)
    if len(alone) and _have_copies(index):
        # The nearest node may belong to another piece.
        donors[alone], away = _nearest_in_cells(index, cells, light[alone], heavy, chained=True)
        weight[alone], _ = _extrapolate(index, light[alone], donors[alone], away, thin)
    elif len(alone):
        tree = scipy.spatial.KDTree(index[heavy])
        ranks = np.arange(DONORS) + 1
        away, near = tree.query(index[light[alone]], k=ranks, distance_upper_bound=NEAR)
        donors[alone] = heavy[np.where(np.isfinite(away), near, 0)]
        weight[alone], _ = _extrapolate(index, light[alone], donors[alone], away, thin)
    tied = _are_determined(weight)
    lost = np.flatnonzero(~tied)
    if far and len(lost):
        donors[lost], away = _nearest_in_cells(
            index, cells, light[lost], heavy, chained=True, near=FAR
        )
        weight[lost], _ = _extrapolate(index, light[lost], donors[lost], away, thin)
        tied = _are_determined(weight)
    row, column = np.nonzero(weight[tied])
    entries = (weight[tied][row, column], (row, donors[tied][row, column]))
    return light[tied], scipy.sparse.csr_matrix(entries, shape=(int(tied.sum()), count))


def _are_determined(weight: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return, for each tied node, whether the weights of its donors [T,K] have the sum 1 [T]."""
    determined: NDArray[np.bool_] = np.abs(weight.sum(axis=1) - 1) < 1e-6
    return determined


def _have_copies(index: NDArray[np.int64]) -> bool:
    """Return whether several nodes have the same indices [N,3]."""
    keys = np.ravel_multi_index((index - index.min(axis=0)).T, np.ptp(index, axis=0) + 1)
    return len(np.unique(keys)) < len(index)


def _nearest_in_cells(
    index: NDArray[np.int64],
    cells: NDArray[np.int64],
    some: NDArray,
    heavy: NDArray,
    *,
    chained: bool = False,
    near: float = NEAR,
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the heavy nodes that share a cell with each node in `some` [T], sorted by distance.

    The results are the neighbours [T,`DONORS`] and their distances [cells]; a distance is infinite
    if there is no neighbour. `chained` includes the neighbours of neighbours. `near` limits the
    distance [cells].
    """
    of_cells = np.repeat(np.arange(len(cells)), cells.shape[1])
    entries = (np.ones(cells.size, np.float32), (cells.ravel(), of_cells))
    touches = scipy.sparse.csr_matrix(entries, shape=(len(index), len(cells)))
    around = touches[some] @ touches.T @ touches if chained else touches[some]
    common = (around @ touches[heavy].T).tocoo()
    row, donor = common.row, heavy[common.col]
    far = np.linalg.norm(index[donor] - index[some[row]], axis=1)
    order = np.lexsort((donor, far, row))
    order = order[far[order] < near]
    row = row[order]
    place = np.arange(len(row)) - np.searchsorted(row, row)
    row, order, place = (values[place < DONORS] for values in (row, order, place))
    donors = np.full((len(some), DONORS), heavy[0])
    distance = np.full((len(some), DONORS), np.inf)
    donors[row, place], distance[row, place] = donor[order], far[order]
    return donors, distance


def _extrapolate(
    index: NDArray[np.int64],
    light: NDArray,
    donors: NDArray,
    distance: NDArray,
    thin: NDArray[np.bool_],
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the weights of each tied node's donors [T,K], and a mask [T].

    The mask is true where a linear function is known from its values at the donors. `distance`
    [T,K], cells, is infinite where there is no donor.
    """
    arm = (index[donors] - index[light][:, None]).astype(np.float64)
    basis = np.concatenate([np.ones((*arm.shape[:2], 1)), arm], axis=2)
    importance = np.exp(-(distance**2) / 1.5)
    # The pairs of the products are xx, xy, xz, yy, yz and zz.
    i, j = np.triu_indices(3)
    bent = np.where((thin[donors] | np.isinf(distance)).all(axis=1), BENT, 0)
    products = bent[:, None, None] * arm[:, :, i] * arm[:, :, j]
    heavy = importance[:, :, None] * products
    stiff = np.eye(len(i)) + np.einsum("tna,tnb->tab", products, heavy)
    rows = importance[:, :, None] * basis
    rows -= heavy @ np.linalg.solve(stiff, np.einsum("tna,tnb->tab", heavy, basis))
    moments = np.einsum("tna,tnb->tab", basis, rows)
    size, axes = np.linalg.eigh(moments)
    determined = size > 1e-8 * size[:, -1:]
    part = np.where(determined, axes[:, 0], 0) / np.where(determined, size, 1)
    constant = np.einsum("tk,tjk->tj", part, axes)
    complete = np.asarray(determined.all(axis=1))
    return np.einsum("tna,ta->tn", rows, constant), complete
