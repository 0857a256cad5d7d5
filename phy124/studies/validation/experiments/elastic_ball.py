"""An elastic ball on a rigid smooth plate by finite elements, beyond the limits of Hertz's theory.

Hertz treats the ball as a half-space of small strain near its contact. Here it is a whole,
neo-Hookean ball like that of the particles: a static, axisymmetric solution with linear
quadrilaterals, finer towards the contact (Bonet and Wood 2008, chapter 9), and contact by an active
set (Alart and Curnier 1991). It shares no code with the material point method, so it can validate
it.
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
"""Corners of the reference square."""
PAIRS = np.array([[0, 0, 1, 1, 2], [0, 1, 0, 1, 2]])
"""Components of F that do not vanish: rr, rz, zr, zz, and across the plane."""
FINER = 3.5
"""Grading of the elements towards the contact; 0 would be a uniform mesh."""
LARGEST_STEP = 0.02
"""Largest step of the plate, in radii."""
DEPTHS = (0.01, 0.03, 0.05, 0.08, 0.11, 0.15)
"""Depths to which a law is fitted, in radii."""


@dataclass(frozen=True)
class Law:
    """Force of a ball on a plate: Hertz's times 1 + a s + b s^2 + ..., s^2 the depth in radii."""

    nu: float
    """Poisson's ratio."""
    terms: tuple[float, ...] = ()
    """a, b ...; empty for Hertz's law, which treats both bodies as half-spaces."""

    def force(self, depth: float) -> float:
        """Return the force over E R^2 at a depth in radii."""
        powers = (term * depth ** (k / 2) for k, term in enumerate((1.0, *self.terms)))
        return 4 / 3 / (1 - self.nu**2) * depth**1.5 * sum(powers)

    def slope(self, depth: float) -> float:
        """Return the derivative of the force with respect to the depth in radii."""
        terms = enumerate((1.0, *self.terms), start=3)
        return 2 / 3 / (1 - self.nu**2) * sum(k * a * depth ** (k / 2 - 1) for k, a in terms)


@cache
def fit_law(nu: float, *, whole: bool) -> Law:
    """Fit the law of a neo-Hookean ball to finite elements up to a depth of 0.15 radii.

    Args:
        nu: Poisson's ratio.
        whole: True for a ball on a plate, pushed by its inertia; False for a ball between plates.
    """
    s = np.sqrt(DEPTHS)
    hertz = [Law(nu).force(depth) for depth in DEPTHS]
    more = plate_forces(DEPTHS, nu, whole=whole) / hertz - 1
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
    """True for half a section of a whole ball, False for a quarter (the upper half of the ball)."""


def make_mesh(fine: int, *, whole: bool) -> Mesh:
    """Divide the section into quadrilaterals between circles and rays.

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
    """Return positions from 0 to 1, closer together at 0."""
    return np.sinh(FINER * np.linspace(0, 1, count + 1)) / math.sinh(FINER)


@dataclass(frozen=True)
class Elements:
    """Quantities at the points of integration (two by two in each element)."""

    gradient: Array
    """Maps displacements [M,8] to the five components of F - 1 [M,4,5,8]."""
    volume: Array
    """Volumes around the axis [M,4]."""
    dofs: NDArray[np.int64]
    """Indices of an element's displacements [M,8]."""
    weights: Array
    """Volume of each node [N]."""

    @classmethod
    def of(cls, make_mesh: Mesh) -> Elements:
        """Return the elements of a mesh."""
        at = CORNERS / math.sqrt(3)
        shape = np.prod(1 + at[:, None] * CORNERS, axis=-1) / 4
        slope = CORNERS * (1 + at[:, None] * CORNERS)[..., ::-1] / 4
        corners = make_mesh.x[make_mesh.quads]
        jacobian = np.einsum("qni,mnj->mqij", slope, corners)
        along = np.einsum("mqij,qnj->mqni", np.linalg.inv(jacobian), slope)
        r = corners[..., 0] @ shape.T
        volume = 2 * math.pi * r * np.linalg.det(jacobian)
        gradient = np.zeros((*r.shape, 5, 4, 2))
        gradient[:, :, 0:2, :, 0] = np.swapaxes(along, 2, 3)
        gradient[:, :, 2:4, :, 1] = np.swapaxes(along, 2, 3)
        gradient[:, :, 4, :, 0] = shape / r[..., None]
        dofs = (2 * make_mesh.quads[..., None] + [0, 1]).reshape(-1, 8)
        shares = (volume @ shape).ravel()
        weights = np.asarray(np.bincount(make_mesh.quads.ravel(), shares, len(make_mesh.x)), float)
        return cls(gradient.reshape(*r.shape, 5, 8), volume, dofs, weights)

    def forces(self, u: Array, mu: float, lam: float) -> tuple[Array, Array]:
        """Return the internal forces [2N] of displacements [2N], and their derivatives [M,8,8]."""
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
        nodal = np.einsum("mq,mqcd,mqc->md", self.volume, self.gradient, stress)
        weighed = self.volume[..., None, None] * (rate @ self.gradient)
        stiffness = np.einsum("mqcd,mqce->mde", self.gradient, weighed)
        return np.asarray(np.bincount(self.dofs.ravel(), nodal.ravel(), len(u)), float), stiffness


def plate_forces(depths: Sequence[float], nu: float, *, whole: bool, fine: int = 16) -> Array:
    """Return the force on the plate over E R^2, at each depth.

    Args:
        depths: Approach of the plate to the middle of the ball, in radii, ascending. The middle is
            the centre of mass of a whole ball, which is pushed by its weight or inertia, or the
            plane of symmetry of a ball between two plates.
        nu: Poisson's ratio.
        whole: True for a whole ball on a plate, False for a ball between two plates.
        fine: Elements along the radius.

    Raises:
        RuntimeError: The iteration does not converge.
    """
    ball = make_mesh(fine, whole=whole)
    lame = 0.5 / (1 + nu), nu / ((1 + nu) * (1 - 2 * nu))
    elements, u = Elements.of(ball), np.zeros(2 * len(ball.x) + 1)
    results, force = [], 0.0
    for last, to in itertools.pairwise((0.0, *depths)):
        steps = math.ceil((to - last) / LARGEST_STEP)
        for depth in np.linspace(last, to, steps + 1)[1:]:
            u, force = _press(ball, elements, u, lame, float(depth))
        results.append(force)
    return np.array(results)


def _press(
    make_mesh: Mesh, elements: Elements, u: Array, lame: tuple[float, float], depth: float
) -> tuple[Array, float]:
    """Return the displacements, with the body force that fixes the middle, and the force."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    size, many = len(u), 2 * len(make_mesh.x)
    axis, level = make_mesh.x[:, 0] == 0, (make_mesh.x[:, 1] == 0) & (not make_mesh.whole)
    fixed = np.zeros(size, bool)
    fixed[0:many:2], fixed[1:many:2], fixed[many] = axis, level, not make_mesh.whole
    push = np.zeros(many)
    push[1::2] = elements.weights
    rows = np.repeat(elements.dofs, 8, axis=1).ravel(), np.tile(elements.dofs, 8).ravel()
    border = np.arange(many), np.full(many, many)
    touch = 2 * make_mesh.surface + 1
    for _ in range(60):
        inner, stiffness = elements.forces(u[:many], *lame)
        off = np.append(inner + u[many] * push, push @ u[:many])
        height = make_mesh.x[make_mesh.surface, 1] + u[touch] - (1 - depth)
        held = touch[height - off[touch] > 0]
        free = ~fixed
        free[held] = False
        force = -off[held].sum()
        miss = np.where(free, off, 0.0)
        change = np.zeros(size)
        change[held] = 1 - depth - make_mesh.x[held // 2, 1] - u[held]
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
