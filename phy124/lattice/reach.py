"""Finds the cells, points and nodes that forces on points reach.

Most forces act on a part of a body, such as the part that a hand holds. Positions and velocities
are then computed in each substep only for the points on which forces act. Only the nodes of these
points get a second kick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.lattice.rest import RestLattice
from phy124.lattice.workers import Worker
from phy124.mpm.stage import Stage
from phy124.particles.lattice import PER_CELL

MOST = 0.5
"""If forces reach a larger fraction of the cells, all cells are processed, which is simpler."""


class Reach(NamedTuple):
    """One worker's cells, points and nodes that the forces reach."""

    cells: NDArray[np.int64] | None
    """Indices of the cells; None: all cells of the worker."""
    points: wp.array
    """Indices of the points in these cells."""
    nodes: wp.array
    """Indices of the worker's nodes on which the forces act."""
    span: slice
    """Range of indices that contains these nodes."""


def cells_of(forces: Sequence[Stage], count: int) -> NDArray[np.int64] | None:
    """Return the cells (of `count`) with points on which forces act.

    The result is None if forces may act on all points, or on more than the fraction `MOST` of the
    cells.
    """
    reached = np.zeros(count, bool)
    for stage in forces:
        if stage.points is None:
            return None
        reached[stage.points // PER_CELL] = True
    return np.flatnonzero(reached) if reached.sum() <= MOST * count else None


def find_reach(
    cells: NDArray[np.int64] | None, lattice: RestLattice, workers: Sequence[Worker], device: str
) -> list[Reach]:
    """Return, for each worker, the cells, points and nodes that forces on points reach.

    Args:
        cells: Indices of the cells with these points, sorted; None: all cells.
        lattice: The lattice of the bodies.
        workers: The workers.
        device: Name of the device.
    """
    reached = np.ones(len(lattice), bool)
    if cells is not None:
        reached[:] = False
        reached[lattice.nodes_of(cells)] = True
        reached |= lattice.passes_to(reached)
    return [_in_worker(worker, cells, reached, device) for worker in workers]


def _in_worker(
    worker: Worker, cells: NDArray[np.int64] | None, reached: NDArray[np.bool_], device: str
) -> Reach:
    points = np.arange(worker.points.start, worker.points.stop)
    if cells is not None:
        cells = cells[np.isin(PER_CELL * cells, points)]
        points = (PER_CELL * cells[:, None] + np.arange(PER_CELL)).ravel()
    start = worker.nodes.start
    nodes = start + np.flatnonzero(reached[worker.nodes])
    span = slice(int(nodes[0]), int(nodes[-1]) + 1) if len(nodes) else slice(start, start)
    chosen = [wp.array(each.astype(np.int32), dtype=int, device=device) for each in (points, nodes)]
    return Reach(cells, chosen[0], chosen[1], span)
