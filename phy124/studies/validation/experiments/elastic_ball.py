"""Finite elements for an elastic ball on a rigid smooth plate: a reference for the contact force.

Hertz's theory treats the ball near its contact as a half-space with small strain. These elements
cover the whole ball and use the same neo-Hookean law as the particles. The solution is static and
axisymmetric, with linear quadrilaterals (Bonet and Wood 2008, chapter 9) and an active set for the
contact (Alart and Curnier 1991).
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
"""Corners of the reference element."""
PAIRS = np.array([[0, 0, 1, 1, 2], [0, 1, 0, 1, 2]])
"""Indices of the nonzero components of F: rr, rz, zr, zz, and the hoop component."""
FINER = 3.5
"""Grading of the mesh near the contact; 0: a uniform mesh."""
LARGEST_STEP = 0.02
"""Maximum movement of the plate in one step, relative to the radius."""
DEPTHS = (0.01, 0.03, 0.05, 0.08, 0.11, 0.15)
"""Indentation depths, relative to the radius, to which a force law is fitted."""


@dataclass(frozen=True)
class Law:
    """Contact force as a function of the indentation depth.

    Hertz's force times `1 + a s + b s^2 + ...`, where s^2 is the depth / radius.
    """

    nu: float
    """Poisson's ratio."""
    terms: tuple[float, ...] = ()
    """Coefficients a, b, ...; empty for Hertz's law."""

    def force(self, depth: float) -> float:
        """Return the contact force, divided by `E R^2`; `depth` is relative to the radius."""
        powers = (term * depth ** (k / 2) for k, term in enumerate((1.0, *self.terms)))
        return 4 / 3 / (1 - self.nu**2) * depth**1.5 * sum(powers)

    def slope(self, depth: float) -> float:
        """Return the derivative of `force` with respect to the relative depth."""
        terms = enumerate((1.0, *self.terms), start=3)
        return 2 / 3 / (1 - self.nu**2) * sum(k * a * depth ** (k / 2 - 1) for k, a in terms)


@cache
def fit_law(nu: float, *, whole: bool) -> Law:
    """Fit a contact-force law to finite-element results for a neo-Hookean ball.

    With `whole`, the ball lies on one plate, and the ball's inertia presses the ball against the
    plate. Otherwise, the ball is between two plates.
    """
    s = np.sqrt(DEPTHS)
    hertz = [Law(nu).force(depth) for depth in DEPTHS]
    more = plate_forces(DEPTHS, nu, whole=whole) / hertz - 1
    terms = np.linalg.lstsq(s[:, None] ** (1, 2, 3), more)[0]
    return Law(nu, tuple(terms.tolist()))


@dataclass(frozen=True)
class Mesh:
    """A mesh of a ball's cross-section. The ball has the radius 1, and the plate is at z = 1."""

    x: Array
    """Nodes [N,2]: distance from the axis, and height."""
    quads: NDArray[np.int64]
    """Indices of each element's nodes [M,4]."""
    surface: NDArray[np.int64]
    """Indices of the nodes on the ball's surface, starting at the contact."""
    whole: bool
    """Whether the mesh covers the whole ball or only its upper half."""


def make_mesh(fine: int, *, whole: bool) -> Mesh:
    """Divide the ball's cross-section into quadrilaterals along circles and rays.

    `fine` is the number of elements along the radius. Without `whole`, z = 0 is a symmetry plane.
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
    """Return `count + 1` positions from 0 to 1, with smaller spacing near 0."""
    return np.sinh(FINER * np.linspace(0, 1, count + 1)) / math.sinh(FINER)


@dataclass(frozen=True)
class Elements:
    """The elements of a mesh, with two by two integration points each."""

    gradient: Array
    """Matrices [M,4,5,8] that map displacements [M,8] to the five components of F - 1."""
    volume: Array
    """Volume of each integration point [M,4], revolved around the axis."""
    dofs: NDArray[np.int64]
    """Indices of each element's unknowns [M,8]."""
    weights: Array
    """Volume that each node represents [N], revolved around the axis."""

    @classmethod
    def of(cls, mesh: Mesh) -> Elements:
        """Create the elements of a mesh."""
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
        """Return the elastic forces [2N] at the displacements u, and stiffness matrices [M,8,8].

        The Lame parameters mu and lam are divided by E.
        """
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
    """Return for each depth the force on the plate, divided by `E R^2`.

    Args:
        depths: Displacements of the plate in ascending order, relative to the radius. The plate
            moves towards the centre of mass of a whole ball, or else towards the symmetry plane.
        nu: Poisson's ratio.
        whole: True for a whole ball on one plate, False for a ball between two plates.
        fine: Number of elements along the radius.

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
    mesh: Mesh, elements: Elements, u: Array, lame: tuple[float, float], depth: float
) -> tuple[Array, float]:
    """Find the equilibrium at a depth with Newton's method and an active set.

    The last unknown is the body force that keeps the middle of the ball in place. Return the
    displacements and the body force [2N+1], and the force on the plate.
    """
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
    raise RuntimeError(f"no equilibrium of the ball found at a depth of {depth:g} radii")
