"""Solids, and the solver of their lattice."""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from phy124.lattice.rest import RestLattice, splines
from phy124.lattice.solver import LatticeSolver
from phy124.materials import NeoHookean
from phy124.mpm import Model, State
from phy124.particles.lattice import PER_CELL, _find_cells, _points_of_pieces, lattice_of
from phy124.particles.solid import Solid
from phy124.scene import Scene
from phy124.studies.validation.bodies import fill_solid

DX = 0.1
SOFT = NeoHookean(E=1e5, nu=0.3, density=1000)
DAMPED = SOFT.model_copy(update={"damping": 300.0})


def block(size, low=(0, 0, 0), per=2, dx=DX):
    """Return a solid box; all lengths are multiples of dx / per."""
    counts = [round(length * per / dx) for length in size]
    first = np.array([round(x * per / dx) for x in low])
    return Solid(first, dx / per, np.ones(counts, np.float32))


def integration_points(solid, dx):
    """Return the integration points of all cells [8C,3] and their volumes [8C], in float64."""
    x, volume, *_ = _points_of_pieces(solid, dx, _find_cells(solid, dx))
    return x, volume


def fork(*, prongs=2, thick=1.0, gap=0.4, root=2, long=10, wide=2, low=(0, 0, 0), per=10):
    """Return prongs along x, one above the other, joined by a root; lengths are in cells."""
    count = [round(n * per) for n in (root + long, wide, 2 * thick + gap)]
    thick, step, start = round(thick * per), round((thick + gap) * per), round(root * per)
    count[2] = max(count[2], (prongs - 1) * step + thick)
    fraction = np.ones(count, np.float32)
    height = np.arange(count[2])
    fraction[start:, :, (height % step >= thick) | (height >= prongs * step)] = 0
    return Solid(np.array([round(x * per) for x in low]), DX / per, fraction)


def rod(thick, along, start, *, long=12, per=2):
    """Return a round rod from `start` - 2 to `start` + `long`; lengths are in cells."""
    along = np.array(along) / np.linalg.norm(along)

    def distance(x):
        arm = x / DX - start
        s = arm @ along
        away = np.linalg.norm(arm - s[..., None] * along, axis=-1) - thick / 2
        return DX * np.maximum(away, np.maximum(-s - 2, s - long))

    ends = np.array([start - 2 * along, start + long * along])
    low, high = (ends.min(axis=0) - thick) * DX, (ends.max(axis=0) + thick) * DX
    return fill_solid(distance, low, high, DX / per)


def make(solid, material=SOFT, *, v=None, C=None, precision="float64", **options):
    """Return a solver of a solid's lattice."""
    points = lattice_of(solid, density=material.density, dx=DX)
    x = points.x.astype(np.float64)
    model = Model.of(x, points.volume, [material], dx=DX, precision=precision)
    motion = None if v is None else np.tile(np.asarray(v, float), (len(x), 1))
    options = {"threads": 1, "copies": points.copies, **options}
    return LatticeSolver(model, points.surface, State.of(model, motion, C), **options)


def lattice_scene(name="drop", frames=4, **accuracy):
    """Return a preset on the lattice at 8 cells."""
    data = Scene.named(name).data()
    data["accuracy"] = {"cells": 8, "solver": "lattice", **accuracy}
    data["time"]["frames"] = frames
    return Scene.from_data(data)


def make_bodies(solids, *materials, v=None, held=(), precision="float64", **options):
    """Return a solver of several solids on their lattices, of one material or of one each."""
    materials = materials or (DAMPED,)
    points = [lattice_of(solid, density=DAMPED.density, dx=DX) for solid in solids]
    surfaces = [each.surface + [0, 0, 0, 0, 0, 0, i, 0] for i, each in enumerate(points)]
    body = np.repeat(np.arange(len(points)), [len(each) for each in points])
    x = np.concatenate([each.x for each in points]).astype(float)
    volume = np.concatenate([each.volume for each in points])
    chosen = {"material": body, "body": body, "held": held, "precision": precision}
    if len(materials) == 1:
        del chosen["material"]
    model = Model.of(x, volume, materials, dx=DX, **chosen)
    motion = None if v is None else np.asarray(v, float)[body]
    state = State.of(model, motion)
    options = {"threads": 1, **options}
    return LatticeSolver(model, np.concatenate(surfaces), state, **options)


def fork_at(x):
    """Return the distance from two prongs, 0.1 m thick and 0.2 m apart, on a root [m]."""
    root = np.abs(x - [0.2, 0.1, 0.05]) - [0.2, 0.1, 0.05]
    prongs = np.abs(np.abs(x - [0.2, 0.1, 0.4]) - [0.15, 0, 0]) - [0.05, 0.1, 0.4]
    return np.minimum(root.max(axis=-1), prongs.max(axis=-1))


E = 1e5
"""Young's modulus [Pa]; Poisson's ratio is 0."""


class Statics:
    """Linear statics of a solid with nu = 0, to compare its stiffness with beam theory.

    Nodes are held if `held` is true for their positions [cells].
    """

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
