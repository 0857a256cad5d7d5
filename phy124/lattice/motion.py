"""Creates the nodes of a lattice at the start of a run, with velocities from the points' motion."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.lattice.rows import rows_for
from phy124.lattice.rest import RestLattice
from phy124.lattice.surface import Surface
from phy124.lattice.walls import Nodes
from phy124.mpm.model import Model, State


def make_nodes(
    model: Model, lattice: RestLattice, surface: Surface, state: State, *, vectors: bool
) -> Nodes:
    """Return nodes at rest positions, with velocities from the points (exact for affine motions).

    Args:
        model: The constants of the run; the nodes of fixed bodies do not move.
        lattice: The lattice at rest.
        surface: Points that may touch walls and bodies.
        state: The motion of the points.
        vectors: Whether rows of nodes are read with vector instructions of a CPU.
    """
    t, count = types(model.real), len(lattice)
    free = (lattice.mass > 0) & ~np.isin(lattice.body, list(model.held))
    inverse = np.divide(1, lattice.mass, out=np.zeros(count), where=free)
    v = _motion(model, lattice, state)
    zeros = [model.array(np.zeros((count, 3)), t.vec3) for _ in range(3)]
    return Nodes(
        rest=model.array(lattice.x, t.vec3),
        u=zeros[0],
        residue=zeros[1],
        before=zeros[2],
        v=model.array(v, t.vec3),
        lagging=model.array(v, t.vec3),
        inverse=model.array(inverse, model.real),
        movable=model.array(inverse, model.real),
        points=(
            wp.array(surface.nodes, dtype=int, device=model.device),
            model.array(surface.weights, model.real),
            model.array(surface.x, t.vec3),
        ),
        rows=rows_for(model.real, model.device, vectors=vectors),
    )


def _motion(model: Model, lattice: RestLattice, state: State) -> NDArray[np.float64]:
    """Return the node velocities [N,3]: means of the cells' velocities, extrapolated with C."""
    v, C = (np.asarray(a.numpy(), np.float64) for a in (state.v, state.C))
    if not v.any() and not C.any():
        return np.zeros((len(lattice), 3))
    # Cells may use only later copies of a node, so all copies contribute to the node.
    nodes = np.repeat(lattice.source[lattice.nodes_of()], 8, axis=0)
    total, number = np.zeros((len(lattice), 3)), np.zeros(len(lattice))
    for k in range(27):
        n = nodes[:, k]
        there = v + np.einsum("pij,pj->pi", C, lattice.x[n] - model.rest)
        np.add.at(total, n, there)
        np.add.at(number, n, 1)
    home = lattice.source
    return total[home] / number[home, None]
