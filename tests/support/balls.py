"""Two equal balls that are pressed together or collide, computed by particles and by finite
elements.

The force of a ball between two plates is computed by finite elements
(phy124/studies/validation/experiments/elastic_ball.py). By symmetry, it equals the force between
two balls.
"""

import math

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.materials import NeoHookean
from phy124.mpm import FreeBody, Model, Pair, Solver
from phy124.studies.validation.experiments.elastic_ball import Elements, fit_law, make_mesh
from phy124.studies.validation.experiments.hertz import HOLD, MOVE, NU, RADIUS, E
from support.shapes import trimmed_ball

RUBBER = NeoHookean(E=E, nu=NU, damping=30.0)
BOX = FreeBody("box", "box", (RADIUS, RADIUS, 0.3), (0, 0, -0.3), density=1e9, friction=0.0)
"""A box so heavy that it does not move, with its top at z = 0."""


def elements(depth: float) -> float:
    """Return the force [N], by finite elements, on a ball that is pressed by a depth [m]."""
    return E * RADIUS**2 * fit_law(NU, whole=False).force(depth / RADIUS)


def upper_half(cells: int, per_axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the particles [P,3], m, of the upper half of a ball about the origin, and their
    volumes."""
    x, volume = trimmed_ball(RADIUS, 2 * RADIUS / cells / per_axis)
    above = x[:, 2] > 0
    return x[above], volume[above]


def plate(side: int, depth: float) -> HalfSpace:
    """Return the centre of the upper or lower ball (side 1 or -1), which is pressed to z = 0 by a
    depth."""
    path = Path(times=(0.0, MOVE), points=((0, 0, 0), (0, 0, -side * depth)))
    return HalfSpace(point=(0, 0, side * RADIUS), normal=(0, 0, -side), contact="slip", motion=path)


def _origin(cells: int, phase: float) -> tuple[float, float, float]:
    """Return the origin of the lattice [m], such that z = 0 is `phase` cells from a node."""
    dx, first = 2 * RADIUS / cells, -(math.ceil(cells / 2) + 5)
    return (first - 0.25) * dx, (first - 0.25) * dx, (first - phase) * dx


def pressed(cells: int, depth: float, phase: float = 0.5, per_axis: int = 2) -> float:
    """Return the mean force between two balls at rest [N].

    Args:
        cells: Cells across a ball.
        depth: Depth by which each ball is pressed [m].
        phase: Position of the contact between two nodes, from 0 to 1.
        per_axis: Particles per cell and axis.
    """
    x, volume = upper_half(cells, per_axis)
    both = np.vstack([x - [0, 0, RADIUS], x * [1, 1, -1] + [0, 0, RADIUS]])
    model = Model.of(
        both,
        np.tile(volume, 2),
        [RUBBER],
        dx=2 * RADIUS / cells,
        origin=_origin(cells, phase),
        body=np.repeat([0, 1], len(x)),
    )
    walls = [plate(1, depth), plate(-1, depth)]
    solver = Solver(model, boundaries=walls, pairs=[Pair(0, 1, friction=0.0)], threads=1)
    solver.advance(MOVE + HOLD / 2)
    solver.pairs.begin()
    solver.advance(MOVE + HOLD)
    return float(solver.pairs.wrenches(HOLD / 2)[(0, 1)].force[2])


def pressed_on_box(cells: int, depth: float, phase: float = 0.5, per_axis: int = 2) -> float:
    """Return the mean force of a ball on the box at rest [N]; for the arguments see `pressed`."""
    x, volume = upper_half(cells, per_axis)
    model = Model.of(
        x * [1, 1, -1] + [0, 0, RADIUS],
        volume,
        [RUBBER],
        dx=2 * RADIUS / cells,
        origin=_origin(cells, phase),
    )
    solver = Solver(model, boundaries=[plate(1, depth)], free=[BOX], threads=1)
    solver.advance(MOVE + HOLD / 2)
    solver.free.begin()
    solver.advance(MOVE + HOLD)
    return -float(solver.free.wrenches(HOLD / 2)[0].force[2])


COURANT = 0.3
"""Substep as a fraction of the time in which a wave crosses the smallest element."""


def collision(radius, approach, *, E, nu, density, fine=6):
    """Return the largest force [N] between colliding neo-Hookean balls, and its duration [s].

    The mesh of `experiments.elastic_ball` is integrated by explicit central differences; nodes
    beyond the plate are moved back to the plate. Lengths are in units of the radius and stresses in
    units of E. The force is averaged over 5 ms.

    Args:
        approach: Speed of one ball towards the other [m/s].
    """
    ball = make_mesh(fine, whole=True)
    elements, top = Elements.of(ball), ball.surface
    lame = 0.5 / (1 + nu), nu / ((1 + nu) * (1 - 2 * nu))
    mass = density * radius**2 / E * elements.weights
    u, v = np.zeros_like(ball.x), np.zeros_like(ball.x)
    v[:, 1] = approach / 2 / radius
    smallest = np.linalg.norm(np.diff(ball.x[top], axis=0), axis=1).min() * radius
    dt = COURANT * smallest * np.sqrt(density / E / 2)
    force, wide = [], max(1, round(0.005 / dt))
    while len(force) < 2 * wide or any(force[-2 * wide :]) or not any(force):
        inner, _ = elements.forces(u.ravel(), *lame)
        v -= dt * inner.reshape(-1, 2) / mass[:, None]
        v[ball.x[:, 0] == 0, 0] = 0.0
        beyond = np.maximum(ball.x[top, 1] + u[top, 1] + dt * v[top, 1] - 1, 0)
        v[top, 1] -= beyond / dt
        u += dt * v
        force.append(E * radius**2 * (mass[top] @ beyond) / dt**2)
        assert np.isfinite(force[-1]), "the steps are too long"
    smooth = np.convolve(force, np.full(wide, 1 / wide), "same")
    return smooth.max(), (smooth > 0.02 * smooth.max()).sum() * dt
