"""An elastic ball on a rigid smooth plate by finite elements: what Hertz leaves out.

Hertz's ball is a half-space near its contact, of small strain. This one is whole, and neo-Hookean
as the particles are: a static, axisymmetric solution with linear quadrilaterals, finer towards the
contact (Bonet and Wood 2008, chapter 9), and contact by an active set (Alart and Curnier 1991).
It shares nothing with the material point method, so that it can judge it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], float)
"""Of the reference square."""
PAIRS = np.array([[0, 0, 1, 1, 2], [0, 1, 0, 1, 2]])
"""Components of F that do not vanish: rr, rz, zr, zz, and across the plane."""
FINER = 3.5
"""How much finer the elements are at the contact; 0 would be evenly."""
LARGEST_STEP = 0.02
"""How far the plate moves at once, in radii."""
DEPTHS = (0.01, 0.03, 0.05, 0.08, 0.11, 0.15)
"""To which a law is fitted, in radii."""


@dataclass(frozen=True)
class Law:
    """Force of a ball on a plate: Hertz's times 1 + a s + b s^2 + ..., s^2 the depth in radii."""

    nu: float
    """Poisson's ratio."""
    terms: tuple[float, ...] = ()
    """a, b ...; none: Hertz's law, which takes both bodies for half-spaces."""

    def force(self, depth: float) -> float:
        """Over E R^2, at a depth in radii."""
        powers = (term * depth ** (k / 2) for k, term in enumerate((1.0, *self.terms)))
        return 4 / 3 / (1 - self.nu**2) * depth**1.5 * sum(powers)

    def slope(self, depth: float) -> float:
        """Derivative of the force by the depth in radii."""
        terms = enumerate((1.0, *self.terms), start=3)
        return 2 / 3 / (1 - self.nu**2) * sum(k * a * depth ** (k / 2 - 1) for k, a in terms)


@cache
def law(nu: float, *, whole: bool) -> Law:
    """That of a neo-Hookean ball, fitted to finite elements up to a depth of 0.15 radii.

    Args:
        nu: Poisson's ratio.
        whole: On one plate, pushed by its inertia; else between two.
    """
    s = np.sqrt(DEPTHS)
    hertz = [Law(nu).force(depth) for depth in DEPTHS]
    more = forces(DEPTHS, nu, whole=whole) / hertz - 1
    terms = np.linalg.lstsq(s[:, None] ** (1, 2, 3), more)[0]
    return Law(nu, tuple(terms.tolist()))


@dataclass(frozen=True)
class Mesh:
    """Half a section through a ball of radius 1, or a quarter of one, that touches z = 1."""

    x: Array
    """Distance from the axis, and height, of the nodes [N,2]."""
    quads: NDArray[np.int64]
    """Nodes of the elements [M,4]."""
    surface: NDArray[np.int64]
    """Nodes of the surface, from the contact on."""
    whole: bool
    """Half a section, of a whole ball; else its upper half."""


def mesh(fine: int, *, whole: bool) -> Mesh:
    """Quadrilaterals between circles and rays, `fine` of them from the middle to the contact.

    Args:
        fine: Elements along the radius.
        whole: Whether the ball is whole; else it ends at z = 0, a plane of symmetry.
    """
    many = (3 if whole else 2) * fine
    turn = _towards_zero(many) * math.pi / (1 if whole else 2)
    radius = 1 - _towards_zero(fine)[:-1]
    x = radius[:, None, None] * np.stack([np.sin(turn), np.cos(turn)], axis=-1)
    x[:, 0, 0] = 0.0
    x[:, -1, 0 if whole else 1] = 0.0
    rows = np.arange(fine * (many + 1)).reshape(fine, many + 1)
    middle = np.full((1, many + 1), rows.size)
    rows = np.concatenate([rows, middle])
    quads = np.stack([rows[1:, :-1], rows[1:, 1:], rows[:-1, 1:], rows[:-1, :-1]], axis=-1)
    return Mesh(np.concatenate([x.reshape(-1, 2), [[0, 0]]]), quads.reshape(-1, 4), rows[0], whole)


def _towards_zero(count: int) -> Array:
    """Places from 0 to 1, closer together at 0."""
    return np.sinh(FINER * np.linspace(0, 1, count + 1)) / math.sinh(FINER)


@dataclass(frozen=True)
class Elements:
    """What is summed over the points of integration (two by two in each element)."""

    gradient: Array
    """Of displacements [M,8], gives the five components of F - 1 [M,4,5,8]."""
    volume: Array
    """Around the axis [M,4]."""
    dofs: NDArray[np.int64]
    """Numbers of an element's displacements [M,8]."""
    weights: Array
    """Volume that belongs to each node [N]."""

    @classmethod
    def of(cls, mesh: Mesh) -> Elements:
        """Those of a mesh."""
        at = CORNERS / math.sqrt(3)
        shape = np.prod(1 + at[:, None] * CORNERS, axis=-1) / 4
        slope = CORNERS * (1 + at[:, None] * CORNERS)[..., ::-1] / 4
        corners = mesh.x[mesh.quads]
        jacobian = np.einsum("qni,mnj->mqij", slope, corners)
        along = np.einsum("mqij,qnj->mqni", np.linalg.inv(jacobian), slope)
        r = corners[..., 0] @ shape.T
        volume = 2 * math.pi * r * np.linalg.det(jacobian)
        gradient = np.zeros((*r.shape, 5, 4, 2))
        gradient[:, :, 0:2, :, 0] = np.swapaxes(along, 2, 3)
        gradient[:, :, 2:4, :, 1] = np.swapaxes(along, 2, 3)
        gradient[:, :, 4, :, 0] = shape / r[..., None]
        dofs = (2 * mesh.quads[..., None] + [0, 1]).reshape(-1, 8)
        shares = (volume @ shape).ravel()
        weights = np.asarray(np.bincount(mesh.quads.ravel(), shares, len(mesh.x)), float)
        return cls(gradient.reshape(*r.shape, 5, 8), volume, dofs, weights)

    def forces(self, u: Array, mu: float, lam: float) -> tuple[Array, Array]:
        """Forces [2N] that the displacements [2N] raise, and their derivatives [M,8,8]."""
        F = np.zeros((*self.volume.shape, 3, 3))
        i, j = PAIRS
        F[..., i, j] = np.einsum("mqcd,md->mqc", self.gradient, u[self.dofs])
        F += np.eye(3)
        inverse, log_j = np.linalg.inv(F), np.log(np.linalg.det(F))
        f, g = F[..., i, j], inverse[..., j, i]
        stress = mu * (f - g) + lam * log_j[..., None] * g
        turned = inverse[..., j[:, None], i] * inverse[..., j, i[:, None]]
        rate = mu * np.eye(5) + (mu - lam * log_j)[..., None, None] * turned
        rate += lam * g[..., None] * g[..., None, :]
        own = np.einsum("mq,mqcd,mqc->md", self.volume, self.gradient, stress)
        weighed = self.volume[..., None, None] * (rate @ self.gradient)
        stiffness = np.einsum("mqcd,mqce->mde", self.gradient, weighed)
        return np.asarray(np.bincount(self.dofs.ravel(), own.ravel(), len(u)), float), stiffness


def forces(depths: Sequence[float], nu: float, *, whole: bool, fine: int = 16) -> Array:
    """Force on the plate over E R^2, at each depth.

    Args:
        depths: How far the plate comes towards the middle of the ball, in radii, ascending: the
            centre of mass of a whole ball that is pushed by its weight, or by its inertia; the
            plane of symmetry of one between two plates.
        nu: Poisson's ratio.
        whole: Whether the ball is whole; else it is between two plates.
        fine: Elements along the radius.

    Raises:
        RuntimeError: A solution is not found.
    """
    ball = mesh(fine, whole=whole)
    lame = 0.5 / (1 + nu), nu / ((1 + nu) * (1 - 2 * nu))
    elements, u = Elements.of(ball), np.zeros(2 * len(ball.x) + 1)
    found, force = [], 0.0
    for last, to in itertools.pairwise((0.0, *depths)):
        steps = math.ceil((to - last) / LARGEST_STEP)
        for depth in np.linspace(last, to, steps + 1)[1:]:
            u, force = _pressed(ball, elements, u, lame, float(depth))
        found.append(force)
    return np.array(found)


def _pressed(
    mesh: Mesh, elements: Elements, u: Array, lame: tuple[float, float], depth: float
) -> tuple[Array, float]:
    """Displacements, and the body force that keeps the middle in place, at a depth; the force."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    size, many = len(u), 2 * len(mesh.x)
    axis, level = mesh.x[:, 0] == 0, (mesh.x[:, 1] == 0) & (not mesh.whole)
    fixed = np.zeros(size, bool)
    fixed[0:many:2], fixed[1:many:2], fixed[many] = axis, level, not mesh.whole
    push = np.zeros(many)
    push[1::2] = elements.weights
    rows = np.repeat(elements.dofs, 8, axis=1).ravel(), np.tile(elements.dofs, 8).ravel()
    border = np.arange(many), np.full(many, many)
    touch = 2 * mesh.surface + 1
    for _ in range(60):
        inner, stiffness = elements.forces(u[:many], *lame)
        off = np.append(inner + u[many] * push, push @ u[:many])
        height = mesh.x[mesh.surface, 1] + u[touch] - (1 - depth)
        held = touch[height - off[touch] > 0]
        free = ~fixed
        free[held] = False
        force = -off[held].sum()
        miss = np.where(free, off, 0.0)
        change = np.zeros(size)
        change[held] = 1 - depth - mesh.x[held // 2, 1] - u[held]
        if max(np.abs(miss).max(), np.abs(change).max()) < 1e-11:
            return u, float(force)
        values = np.concatenate([stiffness.ravel(), push, push])
        places = (
            np.concatenate([rows[0], border[0], border[1]]),
            np.concatenate([rows[1], border[1], border[0]]),
        )
        K = coo_array((values, places), shape=(size, size)).tocsr()
        change[free] = np.asarray(spsolve(K[free][:, free].tocsc(), -(off + K @ change)[free]))
        u = u + change
    raise RuntimeError(f"the ball is not at rest at depth {depth:g} R")
