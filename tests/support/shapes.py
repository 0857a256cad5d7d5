"""Small objects made of Gaussians, clouds of particles, and observed runs."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from phy124.boundaries.base import Boundary
from phy124.forces.base import Force
from phy124.gaussians import Gaussians
from phy124.materials import NeoHookean
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.observer import Observer
from phy124.monitor.watchdog import Watchdog
from phy124.mpm import Solver
from phy124.studies.validation.bodies import block, make_solver, surface_of_ball


def ball(count: int = 2000, radius: float = 0.5) -> Gaussians:
    """Return a closed shell of flat Gaussians on a sphere, coloured by direction."""
    return surface_of_ball(count, radius)


def trimmed_ball(radius: float, h: float, *, parts: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Return particles [P,3], m, with the exact volumes that a ball cuts out of cells of side h
    [m].

    Args:
        parts: Sample points along each edge of a cell, which determine the fraction of the cell in
        the ball.
    """
    axis = (np.arange(round(radius / h) + 1) + 0.5) * h
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    x = x[np.linalg.norm(x, axis=1) < radius + h]
    part = ((np.arange(parts) + 0.5) / parts - 0.5) * h
    points = x[:, None] + np.stack(np.meshgrid(part, part, part), -1).reshape(-1, 3)
    inside = np.linalg.norm(points, axis=2) < radius
    kept = inside.mean(axis=1) > 0.03
    inside, points = inside[kept], points[kept]
    x = (points * inside[..., None]).sum(axis=1) / inside.sum(axis=1)[:, None]
    volume = inside.mean(axis=1)
    volume *= np.pi / 6 * radius**3 / volume.sum()
    signs = np.array(list(product((1, -1), repeat=3)))
    return (x * signs[:, None]).reshape(-1, 3), np.tile(volume, 8)


def random_gaussians(rng: np.random.Generator, count: int = 50, degree: int = 0) -> Gaussians:
    """Return random Gaussians of any position, shape and colour, with harmonics up to `degree`."""
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3))
    scales, opacities = np.exp(rng.normal(size=(count, 3)) - 4), rng.random(count)
    return Gaussians(rng.normal(size=(count, 3)), quats, scales, opacities, sh)


def splats(
    rng: np.random.Generator,
    count: int = 600,
    *,
    sizes: float = 0.03,
    degree: int = 0,
    spread: float = 0.35,
) -> Gaussians:
    """Return Gaussians of all shapes in a ball, some of them faint, some nearly opaque."""
    means = rng.normal(size=(count, 3)) * spread
    quats = rng.normal(size=(count, 4))
    scales = sizes * np.exp(0.7 * rng.normal(size=(count, 3)))
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.8 / (1 + degree)
    opacities = np.minimum(1, 1.2 * rng.beta(1.2, 1, count))  # a few have the largest alpha
    return Gaussians(means, quats, scales, opacities, sh)


def cloud(count: int, *, size: float, corner: float, dx: float) -> np.ndarray:
    """Return random particles [N,3] in a cube with edge `size` [m] at a corner, sorted by cell."""
    x = np.random.default_rng(0).random((count, 3)) * size + corner
    return x[np.lexsort(np.floor(x / dx - 0.5).T[::-1])]


def watch_run(solver: Solver, *observers: Observer) -> Watchdog:
    """Return a watchdog of a solver, together with its other observers."""
    watchdog = Watchdog()
    watchdog.bind(solver, observers)
    return watchdog


def thrown_block(
    walls: Sequence[Boundary],
    observer: Any = None,
    *,
    forces: Sequence[Force] = (),
    v: ArrayLike = (0, 0, 0),
    threads: int = 1,
) -> tuple[Solver, ExternalWork]:
    """Return a soft block of 216 particles in float64, and the sums of the work done on it.

    Args:
        observer: Also sums over the walls.
        v: Velocity of all particles [m/s].
    """
    x, external = block(middle=(0, 0, 0.5)), ExternalWork()
    observers = [external] if observer is None else [external, observer]
    inner = walls if observer is None else observer.wrap_walls(walls, walls)
    solver = make_solver(
        x,
        np.full(len(x), 1e-4),
        [NeoHookean(E=1e4)],
        dx=0.125,
        v=np.tile(v, (len(x), 1)),
        threads=threads,
        forces=external.wrap_forces(forces),
        boundaries=external.wrap_walls(walls, inner),
        accumulators=observers,
        precision="float64",
    )
    return solver, external
