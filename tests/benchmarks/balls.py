"""Force between two balls pressed on each other, against finite elements of the whole ball.

By symmetry each is a ball between two plates (phy124/experiments/elastic_ball.py). The particles
have the volumes that the ball cuts out of their cells, so that its surface is as smooth as the
grid is fine: shells or whole cells add up to 0.2 cells of their own.

    python tests/benchmarks/balls.py 12 16 24        # cells across a ball: a line per depth
    python tests/benchmarks/balls.py 16 --per-axis 3
"""

import argparse
import math

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.experiments.elastic_ball import law
from phy124.experiments.hertz import HOLD, MOVE, NU, RADIUS, E
from phy124.materials import NeoHookean
from phy124.mpm import Model, Pair, Solver

DEPTHS = (0.02, 0.035, 0.05)
"""How far each ball is pressed at its contact [m]."""
PHASES = (0.0, 0.25, 0.5, 0.75)
"""Where the contact is between two nodes."""
PARTS = 8
"""Points along each edge of a particle's cell that say how much of it is in the ball."""
LEAST = 0.03
"""Part of its cell below which there is no particle."""


def elements(depth: float) -> float:
    """Force by finite elements [N]."""
    return E * RADIUS**2 * law(NU, whole=False).force(depth / RADIUS)


def cut(h: float) -> tuple[NDArray, NDArray]:
    """Upper half of a ball about the origin: particles [P,3], m, and volumes, in cells of h [m]."""
    axis = (np.arange(round(RADIUS / h) + 1) + 0.5) * h
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
    x = x[np.linalg.norm(x, axis=1) < RADIUS + h]
    part = ((np.arange(PARTS) + 0.5) / PARTS - 0.5) * h
    points = x[:, None] + np.stack(np.meshgrid(part, part, part), -1).reshape(-1, 3)
    inside = np.linalg.norm(points, axis=2) < RADIUS
    kept = inside.mean(axis=1) > LEAST
    inside, points = inside[kept], points[kept]
    x = (points * inside[..., None]).sum(axis=1) / inside.sum(axis=1)[:, None]
    volume = inside.mean(axis=1)
    volume *= math.pi / 6 * RADIUS**3 / volume.sum()
    signs = np.array([[a, b, 1] for a in (1, -1) for b in (1, -1)])
    return (x * signs[:, None]).reshape(-1, 3), np.tile(volume, 4)


def plate(side: int, depth: float) -> HalfSpace:
    """The middle of the upper or lower ball (side 1, -1), which comes to the other by a depth."""
    path = Path(times=(0.0, MOVE), points=((0, 0, 0), (0, 0, -side * depth)))
    return HalfSpace(point=(0, 0, side * RADIUS), normal=(0, 0, -side), contact="slip", motion=path)


def pressed(cells: int, depth: float, phase: float = 0.5, per_axis: int = 2) -> float:
    """Mean force between the balls at rest [N].

    Args:
        cells: Cells across a ball.
        depth: How far each is pressed [m].
        phase: Where the contact is between two nodes, from 0 to 1.
        per_axis: Particles per cell and axis.
    """
    dx = 2 * RADIUS / cells
    x, volume = cut(dx / per_axis)
    lower, upper = x - [0, 0, RADIUS], x * [1, 1, -1] + [0, 0, RADIUS]
    first = -(math.ceil(RADIUS / dx) + 5)
    low = ((first - 0.25) * dx, (first - 0.25) * dx, (first - phase) * dx)
    rubber = NeoHookean(E=E, nu=NU, damping=30.0)
    body = np.repeat([0, 1], len(x))
    model = Model.of(
        np.vstack([lower, upper]), np.tile(volume, 2), [rubber], dx=dx, origin=low, body=body
    )
    walls = [plate(1, depth), plate(-1, depth)]
    solver = Solver(model, boundaries=walls, pairs=[Pair(0, 1, friction=0.0)], threads=1)
    solver.advance(MOVE + HOLD / 2)
    solver.pairs.begin()
    solver.advance(MOVE + HOLD)
    return float(solver.pairs.wrenches(HOLD / 2)[(0, 1)].force[2])


def main() -> None:
    """One line per grid and depth."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cells", type=int, nargs="*", default=[12, 16, 24])
    parser.add_argument("--per-axis", type=int, default=2)
    given = parser.parse_args()
    for cells in given.cells:
        for depth in DEPTHS:
            forces = [pressed(cells, depth, phase, given.per_axis) for phase in PHASES]
            errors = [force / elements(depth) - 1 for force in forces]
            told = ", ".join(f"{error:+.1%}" for error in errors)
            print(f"{cells} cells, depth {depth:g} m: {told}; mean {np.mean(errors):+.1%}")


if __name__ == "__main__":
    main()
