"""Arranges copies of nodes in memory so that each cell still uses rows of three nodes along z.

A node has copies if separate pieces of a body lie in the support of the node
(phy124/particles/pieces.py). A node that belongs to several rows is stored in each of them. A
repeated node is tied, with weight 1, to the node that it repeats.
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray


class Layout(NamedTuple):
    """Order of D distinct nodes of lattices in memory; some nodes are stored repeatedly."""

    node: NDArray[np.int64]
    """Index of the distinct node that is stored at each position in memory [N]."""
    home: NDArray[np.int64]
    """For each distinct node, the position in memory that stands for the node [D]. At all other
    positions, the node is repeated.
    """
    rows: NDArray[np.int64]
    """For each cell, positions in memory of its nine rows of three nodes along z [C,9]."""

    @property
    def repeats(self) -> NDArray[np.bool_]:
        """Whether each position in memory repeats a node [N]."""
        mask: NDArray[np.bool_] = self.home[self.node] != np.arange(len(self.node))
        return mask

    def repeat(
        self,
        tied: NDArray[np.int64],
        ties: scipy.sparse.csr_matrix,
        pushes: scipy.sparse.csr_matrix,
    ) -> tuple[NDArray[np.int64], scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """Return the tied nodes (with repeated nodes), their weights [T,N], and the weights of
        forces [N,N].

        Args:
            tied: Indices of the distinct nodes that are tied.
            ties: Weights of the donors of these nodes [T,D].
            pushes: Weights of forces on distinct nodes [D,D], as in `RestLattice.pushes`.
        """
        count, distinct = len(self.node), len(self.home)
        follows = np.zeros(distinct, bool)
        follows[tied] = True
        at_home = _ones(np.arange(distinct), self.home, (distinct, count))
        gathered = _ones(self.node, np.arange(count), (distinct, count))
        still = scipy.sparse.diags_array((~follows).astype(float))
        motion = still + _ones(tied, np.arange(len(tied)), (distinct, len(tied))) @ ties
        moved = np.flatnonzero(self.repeats | follows[self.node])
        pushed = at_home.T @ (scipy.sparse.eye_array(distinct) + pushes) @ gathered
        pushed = scipy.sparse.csr_matrix(pushed - at_home.T @ at_home)
        pushed.eliminate_zeros()
        return moved, scipy.sparse.csr_matrix((motion.tocsr() @ at_home)[self.node[moved]]), pushed


def lay_out(index: NDArray[np.int64], copy: NDArray, cells: NDArray[np.int64]) -> Layout:
    """Arrange the nodes of lattices, including copies of nodes, in memory.

    Args:
        index: Indices of the distinct nodes, sorted by x, y, z and copy [D,3].
        copy: Copy number of each node [D]; 0 for a node without copies.
        cells: The distinct nodes of each cell [C,27].
    """
    rows, which = np.unique(cells.reshape(-1, 3), axis=0, return_inverse=True)
    which = which.reshape(-1)
    apart = copy[rows].any(axis=1)
    chains = _chain(rows[apart])
    first = np.flatnonzero(copy == 0)
    lengths = np.array([len(chain) for chain in chains], np.int64)
    node = np.concatenate([first, *chains]).astype(np.int64)
    run = np.concatenate(
        [np.zeros(len(first), np.int64), np.repeat(np.arange(len(chains)) + 1, lengths)]
    )
    order = np.lexsort((index[node, 2], run, index[node, 1], index[node, 0]))
    place = np.empty(len(node), np.int64)
    place[order] = np.arange(len(node))
    # The main position of a first copy is among the nodes without copies; the main position of any
    # other copy is in the first chain that contains it.
    home = np.full(len(index), len(node))
    np.minimum.at(home, node[len(first) :], place[len(first) :])
    home[first] = place[: len(first)]
    start = np.empty(len(rows), np.int64)
    start[~apart] = home[rows[~apart, 0]]
    begin = len(first)
    known = {}
    for chain in chains:
        for k in range(len(chain) - 2):
            known[chain[k], chain[k + 1], chain[k + 2]] = place[begin + k]
        begin += len(chain)
    start[apart] = [known[row] for row in map(tuple, rows[apart].tolist())]
    return Layout(node[order], home, start[which].reshape(-1, 9))


def _chain(rows: NDArray[np.int64]) -> list[list[int]]:
    """Join rows of three nodes that overlap by two nodes; return lists of nodes."""
    chains: list[list[int]] = []
    open_ends: dict[tuple[int, int], list[int]] = {}
    for a, b, c in rows.tolist():
        chain = open_ends.pop((a, b), None)
        if chain is None:
            chain = [a, b]
            chains.append(chain)
        chain.append(c)
        open_ends[b, c] = chain
    return chains


def _ones(rows: NDArray, columns: NDArray, shape: tuple[int, int]) -> scipy.sparse.csr_matrix:
    return scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), shape=shape)
