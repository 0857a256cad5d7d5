"""Two equal elastic balls that meet head-on, by finite elements: each meets a smooth plate."""

import numpy as np

from phy124.experiments.elastic_ball import Elements, mesh

COURANT = 0.3
"""Part of the time in which a wave passes the smallest element."""


def collision(radius, approach, *, E, nu, density, fine=6):
    """Largest force [N], and how long one acts [s], of neo-Hookean balls.

    Explicit central differences of the mesh of phy124/experiments/elastic_ball.py; nodes that pass
    the plate are put back on it. Force and places have the radius and E as units, means over 5 ms.

    Args:
        approach: Speed of one ball towards the other [m/s].
    """
    ball = mesh(fine, whole=True)
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
