"""Finds pieces of a body that lie in one cell, or at one node, without being connected.

Parts that are connected only far away, such as two prongs, move independently: each piece of a cell
gets integration points, and each connected piece in the support of a node gets a copy of the node
(phantom nodes of Hansbo and Hansbo 2004, doi 10.1016/j.cma.2003.12.041; Nesme, Kry, Jerabkova and
Faure 2009, doi 10.1145/1531326.1531358).

Voxels are connected by faces, edges and corners, so that a thin slanted sheet stays whole. Specks
without connection to the body share the body's nodes. Large parts without connection are bodies of
their own here (phy124/particles/islands.py).
"""

from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

AHEAD = np.array([step for step in np.ndindex(3, 3, 3) if step > (1, 1, 1)]) - 1
"""Index offsets from a cell or voxel to half of its 26 neighbours; the others have opposite
signs.
"""
AROUND = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
"""Index offsets from a cell or node to itself and to its 26 neighbours."""
LEAST = 0.08
"""Smallest filled fraction of a separate sliver that is merged with another piece. With a limit
of 0.03, a thin disc turned inside out when it was pushed.
"""
TOUCH = np.abs(AROUND[:, None] - AROUND[None]).max(axis=2) <= 1
"""For each pair of offsets in `AROUND`: whether the two offsets lead to neighbours or to the same
place [27,27].
"""


class Pieces(NamedTuple):
    """Connected pieces of a body in the cells of its lattice, sorted by cell."""

    of_voxel: NDArray[np.int64]
    """Index of each voxel's piece [V]."""
    clump: NDArray[np.int64]
    """Index of each voxel's clump [V]. A clump consists of connected voxels in a cell, or of one
    voxel with only a trace of material.
    """
    links: NDArray[np.int64]
    """Distinct pairs of clumps that touch [M,2], without traces of material."""


def find_pieces(
    index: NDArray,
    place: NDArray,
    cell: NDArray,
    part: NDArray,
    clear: NDArray[np.bool_],
    sliver: float,
) -> Pieces:
    """Return the connected pieces of a body in each cell of its lattice.

    Args:
        index: Indices of the voxels that are not empty [V,3].
        place: Indices of the cells in which the voxels lie [V,3].
        cell: Index of each voxel's cell after slivers have been merged [V].
        part: Volume of each voxel, relative to a cell [V].
        clear: Whether each voxel connects its neighbours [V]; traces of material do not.
        sliver: In a cell with several pieces, a piece that fills less than this fraction of the
            cell joins a connected piece in a neighbouring cell.
    """
    clump, touching, contact = _find_clumps(index, place, clear)
    of = np.zeros(clump.max() + 1, np.int64)
    of[clump] = cell
    same = of[touching[:, 0]] == of[touching[:, 1]]
    count, of_clump = _components(touching[same], len(of))
    piece = of_clump[clump]
    size = np.bincount(piece, part, count)
    of = np.zeros(count, np.int64)
    of[piece] = cell
    joined = np.zeros(count, bool)
    joined[piece[clear]] = True
    order = np.lexsort((-size, ~joined, of))
    largest = order[np.flatnonzero(np.diff(of[order], prepend=-1))]
    target = np.arange(count)
    if len(largest) < count:
        links, contact = _distinct(of_clump[touching[~same]], count, contact[~same])
        _, island = _components(links, count)
        main = np.zeros(of.max() + 1, np.int64)
        main[of[largest]] = largest
        main = main[of]
        alone = ~joined | (island != island[main])
        target[alone] = main[alone]
        several = np.bincount(of[target == np.arange(count)], minlength=of.max() + 1)[of] > 1
        small = several & (size < sliver) & ~alone
        a, b = np.concatenate([links, links[:, ::-1]]).T
        contact = np.tile(contact, 2)
        fits = small[a] & (size[a] >= LEAST) & (size[b] >= sliver) & ~alone[b]
        a, b = a[fits], b[fits]
        # The last assignment counts, so a small piece joins the neighbour with the largest contact,
        # and among equals the fullest one. A fuller neighbour with little contact may be the root
        # of two prongs, which the small piece would connect. If the neighbour itself joins another
        # piece, the small piece follows it.
        order = np.lexsort((size[b], contact[fits], a))
        target[a[order]] = b[order]
        target = target[target]
    order = np.lexsort((np.arange(count), of))
    kept = order[(target == np.arange(count))[order]]
    number = np.zeros(count, np.int64)
    number[kept] = np.arange(len(kept))
    of_voxel = number[target[piece]]
    return Pieces(of_voxel, clump, touching)


def find_copies(
    pieces: Pieces, cell: NDArray, place: NDArray, volume: NDArray
) -> NDArray[np.int8] | None:
    """Return the copies of its 27 nodes that each piece uses [E,27]; None if no node has copies.

    Args:
        pieces: The E pieces.
        cell: For each piece, the indices of the cell whose nodes the piece uses [E,3].
        place: Indices of the cells in which the voxels lie [V,3]; for merged slivers, these cells
            differ from the cells of the pieces.
        volume: Volumes of the voxels [V]. The largest connected piece in the support of a node
            uses the node's first copy.
    """
    # Voxels without neighbours, such as traces of material, do not separate pieces.
    piece, clump = pieces.of_voxel, pieces.clump
    linked = np.bincount(clump) > 1
    linked[pieces.links] = True
    used = linked[clump]
    if not used.any():
        return None
    of_used = np.zeros(len(cell), bool)
    of_used[piece[used]] = True
    used |= of_used[piece] & (place == cell[piece]).all(axis=1)
    place, piece, volume = place[used], piece[used], volume[used]
    low, shape = place.min(axis=0), np.ptp(place, axis=0) + 1
    keys = np.asarray(np.ravel_multi_index((place - low).T, shape)) * len(cell) + piece
    _, first, part = np.unique(keys, return_index=True, return_inverse=True)
    places, piece = place[first], piece[first]
    size = np.bincount(part, volume)
    of_clump = np.zeros(len(linked), np.int64)
    of_clump[clump[used]] = part
    copies = _copies_of_parts(places, piece, of_clump[pieces.links], size)
    if copies is None:
        return None
    # In the support of a node, a piece uses the copy that belongs to its largest part there.
    result = np.zeros((len(cell), 27), np.int8)
    copied = np.zeros(len(cell), bool)
    copied[piece[copies.any(axis=1)]] = True
    order = np.argsort(size, kind="stable")
    order = order[copied[piece[order]]]
    copies, piece, places = copies[order], piece[order], places[order]
    for k, step in enumerate(AROUND):
        way = cell[piece] + step - places
        near = np.flatnonzero((np.abs(way) <= 1).all(axis=1))
        result[piece[near], k] = copies[near, (way[near] + 1) @ [9, 3, 1]]
    return result if result.any() else None


def _copies_of_parts(
    cell: NDArray, piece: NDArray, pairs: NDArray, volume: NDArray
) -> NDArray[np.int8] | None:
    """Return the copies of the 27 nodes that each part of a piece would use [A,27]; None: no
    copies.

    A part lies in a single cell. Parts of one piece are connected, because they use common nodes.
    """
    count = len(cell)
    ones = np.ones(count, np.float32)
    of_piece = scipy.sparse.csr_matrix((ones, (np.arange(count), piece)))
    within = np.stack((of_piece @ of_piece.T).nonzero(), axis=1)
    links, _ = _distinct(np.concatenate([pairs, within]), count)
    low, shape = cell.min(axis=0) - 2, np.ptp(cell, axis=0) + 5
    keys = np.asarray(np.ravel_multi_index((cell - low).T, shape))
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    near = np.abs(cell[links[:, 0]] - cell[links[:, 1]]).max(axis=1) <= 1
    doubtful = _doubtful_nodes(keys, keys[links[near]], strides, int(shape.prod()))
    nodes = keys[:, None] + AROUND @ strides
    chosen = np.asarray(doubtful[nodes])
    if not chosen.any():
        return None
    entry = np.full(nodes.shape, -1)
    entry[chosen] = np.arange(chosen.sum())
    user = np.nonzero(chosen)[0]
    using = np.asarray(chosen.any(axis=1))
    a, b = links[using[links].all(axis=1)].T
    there = _same_nodes(cell[a] - cell[b])
    common = (there >= 0) & (entry[a] >= 0)
    link, node = np.nonzero(common)
    uses = np.stack([entry[a[link], node], entry[b[link], there[link, node]]], axis=1)
    number, group = _components(uses, len(user))
    _, island = _components(links, count)
    rank = _rank(group, nodes[chosen], island[user], volume[user], number)
    if not rank.any():
        return None
    copies = np.zeros(nodes.shape, np.int8)
    copies[chosen] = rank
    return copies


def _same_nodes(step: NDArray[np.int64]) -> NDArray[np.int8]:
    """Return the index of each node of a cell among the nodes of another cell [L,27]; -1: the other
    cell does not use the node. The other cell lies at the index offset `step` [L,3].
    """
    ways = np.array(list(np.ndindex(5, 5, 5)))[:, None] - 2 + AROUND
    table = np.where((np.abs(ways) <= 1).all(axis=2), (ways + 1) @ [9, 3, 1], -1).astype(np.int8)
    near = np.asarray((np.abs(step) <= 2).all(axis=1))
    code = np.where(near, (step + 2) @ [25, 5, 1], 0)
    return np.where(near[:, None], table[code], np.int8(-1))


def _doubtful_nodes(
    keys: NDArray, linked: NDArray, strides: NDArray, count: int
) -> NDArray[np.bool_]:
    """Return a mask [K] of the nodes in whose support pieces of the body may be separate."""
    number = np.bincount(keys, minlength=count)
    filled = number > 0
    odd = number > 1
    cells = np.flatnonzero(filled)
    first, step = np.minimum(*linked.T), np.abs(linked[:, 0] - linked[:, 1])
    for jump in AHEAD @ strides:
        ahead = filled[cells + jump]
        joined = np.zeros(count, bool)
        joined[first[step == jump]] = True
        missing = cells[ahead & ~joined[cells]]
        odd[missing] = odd[missing + jump] = True
    around = AROUND @ strides
    doubtful = np.zeros(count, bool)
    doubtful[(np.flatnonzero(odd)[:, None] + around).ravel()] = True
    touched = np.zeros(count, bool)
    touched[(cells[:, None] + around).ravel()] = True
    nodes = np.flatnonzero(touched & ~doubtful)
    inside = (nodes[:, None] + around >= 0) & (nodes[:, None] + around < count)
    support = filled[np.clip(nodes[:, None] + around, 0, count - 1)] & inside
    codes, which = np.unique(support @ (1 << np.arange(27)), return_inverse=True)
    masks = (codes[:, None] >> np.arange(27)) & 1 > 0
    reached = np.zeros_like(masks)
    reached[np.arange(len(masks)), masks.argmax(axis=1)] = True
    touch = TOUCH.astype(np.float32)
    for _ in range(len(AROUND)):
        wider = (reached.astype(np.float32) @ touch > 0) & masks
        if np.array_equal(wider, reached):
            break
        reached = wider
    doubtful[nodes[(reached != masks).any(axis=1)[which.reshape(-1)]]] = True
    return doubtful


def _rank(
    group: NDArray, node: NDArray, island: NDArray, volume: NDArray, count: int
) -> NDArray[np.int64]:
    size = np.bincount(group, volume, count)
    of_node, of_island = np.zeros(count, np.int64), np.zeros(count, np.int64)
    of_node[group], of_island[group] = node, island
    order = np.lexsort((-size, of_node))
    first = np.flatnonzero(np.diff(of_node[order], prepend=-1))
    lengths = np.diff(np.append(first, count))
    joined = of_island[order] == np.repeat(of_island[order[first]], lengths)
    before = np.cumsum(joined)
    rank = np.zeros(count, np.int64)
    rank[order] = np.where(joined, before - np.repeat(before[first], lengths), 0)
    return np.minimum(rank, np.iinfo(np.int8).max)[group]


def _find_clumps(
    index: NDArray, place: NDArray, clear: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return each voxel's clump [V], distinct pairs of clumps that touch [M,2], and the number of
    contacts between their voxels [M].
    """
    low, shape = index.min(axis=0) - 1, np.ptp(index, axis=0) + 3
    flat = np.asarray(np.ravel_multi_index((index - low).T, shape))[clear]
    number = np.full(int(shape.prod()), -1, np.int32)
    voxels = np.flatnonzero(clear).astype(np.int32)
    number[flat] = voxels
    first, second = [], []
    for jump in AHEAD @ np.array([shape[1] * shape[2], shape[2], 1]):
        other = number[flat + jump]
        present = other >= 0
        first.append(voxels[present])
        second.append(other[present])
    a, b = np.concatenate(first), np.concatenate(second)
    low, shape = place.min(axis=0), np.ptp(place, axis=0) + 1
    where = np.asarray(np.ravel_multi_index((place - low).T, shape), np.int32)
    same = where[a] == where[b]
    count, clump = _components(np.stack([a[same], b[same]], axis=1), len(index))
    return clump, *_distinct(clump[np.stack([a[~same], b[~same]], axis=1)], count)


def _distinct(
    pairs: NDArray, count: int, size: NDArray | int = 1
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return all distinct pairs [L,2] of different items, the smaller item first, and the total
    size of each pair [L].
    """
    low, high = np.minimum(*pairs.T), np.maximum(*pairs.T)
    apart = low < high
    sizes = np.broadcast_to(np.asarray(size, np.int64), low.shape)
    entries = sizes[apart], (low[apart], high[apart])
    graph = scipy.sparse.coo_matrix(entries, shape=(count, count)).tocsr()
    rows = np.repeat(np.arange(count), np.diff(graph.indptr))
    return np.stack([rows, graph.indices], axis=1), graph.data


def _components(pairs: NDArray, count: int) -> tuple[int, NDArray[np.int64]]:
    ones = np.ones(len(pairs), np.int8)
    graph = scipy.sparse.coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    number, group = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return int(number), group.astype(np.int64)
