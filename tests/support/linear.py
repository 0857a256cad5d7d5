"""Linear statics of a solid on its lattice, to compare stiffness with beam theory."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from phy124.lattice.rest import RestLattice, splines
from phy124.particles.lattice import PER_CELL, lattice_of
from support.lattices import DX

E = 1e5
"""Young's modulus [Pa]; Poisson's ratio is 0."""


class Statics:
    """A solid with nu = 0; nodes are held if `held` is true for their positions [cells]."""

    def __init__(self, solid, held, *, whole=False):
        points = lattice_of(solid, density=1000, dx=DX)
        copies = None if whole else points.copies
        x = points.x.astype(np.float64)
        self.lattice = lattice = RestLattice.of(x, points.mass, points.volume, DX, copies=copies)
        self.x, self.volume = x / DX, points.volume
        count = len(lattice)
        o = lattice.offset.T
        values = splines(o)
        slopes = np.stack([o - 1.5, 2 - 2 * o, o - 0.5], axis=-1) / DX
        grad = [product((slopes if k == a else values)[k] for k in range(3)) for a in range(3)]
        nodes = np.repeat(lattice.nodes_of(), PER_CELL, axis=0)
        rows = np.repeat(np.arange(len(x)), 27)
        self.values, gx, gy, gz = (
            sp.csr_matrix((w.ravel(), (rows, nodes.ravel())), shape=(len(x), count))
            for w in (product(values), *grad)
        )
        zero = sp.csr_matrix(gx.shape)
        strains = [[gx, zero, zero], [zero, gy, zero], [zero, zero, gz]]
        strains += [[gy, gx, zero], [zero, gz, gy], [gz, zero, gx]]
        B = sp.bmat(strains, format="csr")
        weight = E * np.concatenate([self.volume] * 3 + [self.volume / 2] * 3)
        light = np.zeros(count, bool)
        light[lattice.tied] = True
        chosen = sp.csr_matrix((np.ones(light.sum()), (lattice.tied, np.arange(light.sum()))))
        chosen.resize(count, int(light.sum()))
        motion = sp.csr_matrix(sp.diags((~light).astype(float)) + chosen @ lattice.ties)
        self.ties = sp.block_diag([motion] * 3, format="csr")
        self.free = np.tile(~light & ~held(lattice.x / DX), 3)
        K = self.ties.T @ B.T @ sp.diags(weight) @ B @ self.ties
        # No node must be held if the forces are balanced.
        self.K = (K + 1e-9 * K.diagonal().max() * sp.eye(K.shape[0])).tocsc()

    def solve(self, force):
        """Return the displacements of the points [P,3] under forces on the points [P,3]."""
        push = self.ties.T @ np.concatenate([self.values.T @ f for f in force.T])
        u = np.zeros(len(push))
        u[self.free] = spsolve(self.K[self.free][:, self.free], push[self.free])
        return np.stack([self.values @ part for part in np.split(self.ties @ u, 3)], axis=1)

    def push(self, where, force):
        """Return forces [P,3] that push the points `where` with a total force [N]."""
        share = np.where(where, self.volume, 0)
        return np.outer(share / share.sum(), force)


def product(along):
    """Return the products [P,27] of the factors [P,3] of three nodes along each axis."""
    a, b, c = along
    return np.einsum("pi,pj,pk->pijk", a, b, c).reshape(len(a), 27)
