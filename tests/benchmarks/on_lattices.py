"""Runs the experiments of `phy124 validate` that use particles, with their bodies on lattices.

    nice python tests/benchmarks/on_lattices.py hertz restitution middle-axis incline pressed-block

The program prints each value, its published value and the difference, for each grid. The table is
in docs/lab/solvers.md. docs/design/lattice.md compares it with the default solver.
"""

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.forces import Gravity
from phy124.lattice.solver import LatticeSolver
from phy124.materials import Material, NeoHookean, Rigid
from phy124.mpm import Model, State
from phy124.particles.lattice import lattice_of
from phy124.particles.solid import Solid
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import (
    fill_solid,
    make_lattice_solver,
    mean_acceleration,
    mirrors,
)
from phy124.studies.validation.experiments import (
    find_experiment,
    hertz,
    incline,
    middle_axis,
    pressed_block,
    restitution,
)
from phy124.studies.validation.experiments.elastic_ball import Law

Values = tuple[float, ...]


def box(edges: tuple[float, float, float], dx: float, *, middle: bool = False) -> Solid:
    """Return a box from the origin, or around it, on voxels of half a cell."""
    counts = [round(2 * edge / dx) for edge in edges]
    first = [-(count // 2) if middle else 0 for count in counts]
    return Solid(np.array(first), dx / 2, np.ones(counts, np.float32))


def ball(radius: float, dx: float, planes: int) -> Solid:
    """Return a ball around the origin, cut by the first planes of x, y and z through its centre."""
    low = [0.0 if axis < planes else -radius for axis in range(3)]
    return fill_solid(lambda x: np.linalg.norm(x, axis=-1) - radius, low, (radius,) * 3, dx / 2)


def force_on(solver: LatticeSolver, wall: int, start: float, end: float) -> NDArray[np.float64]:
    """Return the mean force on a body from a wall between two times [3], N."""
    solver.advance(start)
    before = solver.walls.sums.numpy()[wall, :3].copy()
    solver.advance(end)
    return (solver.walls.sums.numpy()[wall, :3] - before) / (end - start)


def press_ball(cells: int) -> Values:
    """The values of `hertz`, for an eighth of the pressed ball and a quarter of the other one."""
    dx, values = hertz.RADIUS / cells, []
    rubber = NeoHookean(E=hertz.E, nu=hertz.NU, damping=30.0)
    for depth in hertz.DEPTHS:
        motion = Path(times=(0.0, hertz.MOVE), points=((0, 0, 0), (0, 0, -depth)))
        plate = HalfSpace(
            point=(0, 0, hertz.RADIUS), normal=(0, 0, -1.0), friction=0, motion=motion
        )
        eighth, walls = ball(hertz.RADIUS, dx, 3), [plate, *mirrors(0, 1, 2)]
        solver = make_lattice_solver(eighth, dx, rubber, boundaries=walls, threads=1)
        end = hertz.MOVE + hertz.HOLD
        force = force_on(solver, 0, end - hertz.HOLD / 2, end)
        values.append(4 * abs(float(force[2])) / hertz.hertz(depth))
    theory = restitution.solve_theory(0.0, restitution.SHALLOW, Law(0.0))
    return (*values, bounce(cells, 0.0, restitution.SHALLOW).turning / theory.turning)


def bounce(cells: int, loss: float, depth: float) -> restitution.Bounce:
    """Simulate the ball of `restitution`."""
    dx, v = restitution.RADIUS / cells, restitution.speed(depth)
    damping = loss * restitution.duration(depth) * restitution.E / 2
    rubber = NeoHookean(E=restitution.E, nu=0.0, density=restitution.DENSITY, damping=damping)
    floor = HalfSpace(point=(0, 0, -restitution.RADIUS - 0.5 * dx), normal=(0, 0, 1.0), friction=0)
    quarter, walls = ball(restitution.RADIUS, dx, 2), [floor, *mirrors(0, 1)]
    solver = make_lattice_solver(quarter, dx, rubber, v=(0, 0, -v), boundaries=walls, threads=1)
    return restitution.observe(solver, depth)


def rebound(cells: int) -> Values:
    """The values of `restitution`."""
    return tuple(bounce(cells, loss, restitution.DEEP).restitution for loss in restitution.LOSSES)


def tumble(cells: int) -> Values:
    """The values of `middle-axis`."""
    dx = middle_axis.EDGES[2] / cells
    points = lattice_of(box(middle_axis.EDGES, dx, middle=True), density=1000, dx=dx)
    wx, wy, wz = middle_axis.SPIN
    C, x = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]]), points.x.astype(float)
    body: Material = Rigid(nu=0.3, speed=2.0, strain=0.02)
    model = Model.of(x, points.volume, [body], dx=dx)
    state = State.of(model, x @ C.T, np.broadcast_to(C, (len(x), 3, 3)))
    solver = LatticeSolver(model, points.surface, state, threads=1)
    return middle_axis.observe(solver)


def slide(cells: int, slope: float, friction: float, *, across: bool) -> float:
    """The acceleration of `incline`; `across` turns the block in its lattice."""
    dx, angle, half = incline.SIZE / cells, math.atan(slope), incline.SIZE / 2
    along, up = (math.cos(angle), 0.0, -math.sin(angle)), (math.sin(angle), 0.0, math.cos(angle))
    g, way, wall = (GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle)), (1.0, 0, 0), None
    block = box((incline.SIZE,) * 3, dx)
    if across:
        turn, middle = np.array([along, (0, 1, 0), up]), np.array([0, 0, half])

        def distance(x: NDArray) -> NDArray[np.float64]:
            return np.abs(x @ turn.T - middle).max(axis=-1) - half

        reach = 2 * incline.SIZE
        block = fill_solid(distance, (-reach,) * 3, (reach,) * 3, dx / 2)
        g, way, wall = (0.0, 0.0, -GRAVITY), along, up
    plane = HalfSpace(normal=wall or (0.0, 0.0, 1.0), friction=friction)
    rubber = NeoHookean(E=2e5, damping=600.0)
    solver = make_lattice_solver(
        block, dx, rubber, forces=[Gravity(g=g)], boundaries=[plane], threads=1
    )
    times = np.linspace(0, incline.SLIDING, incline.SAMPLES)
    return mean_acceleration(solver, way, incline.SETTLING, times) / GRAVITY


def slides(cells: int) -> Values:
    """The values of `incline`."""
    return tuple(
        slide(cells, slope, friction, across=across)
        for across in (False, True)
        for slope, friction in incline.CASES
    )


def press_block(cells: int) -> Values:
    """The values of `pressed-block`."""

    def press(moving: int, fixed: int) -> tuple[float, float]:
        half, dx = pressed_block.SIZE / 2, pressed_block.SIZE / 2 / cells
        axes = (2, 1, 0)[: moving + fixed]
        plates = [pressed_block._plate(axis, moves=n < moving) for n, axis in enumerate(axes)]
        rubber = NeoHookean(E=pressed_block.E, nu=pressed_block.NU, damping=200.0)
        walls = [*plates, *mirrors(0, 1, 2)]
        solver = make_lattice_solver(box((half,) * 3, dx), dx, rubber, boundaries=walls, threads=1)
        end = pressed_block.PRESS + pressed_block.HOLD
        force = force_on(solver, 0, end - pressed_block.HOLD / 2, end)
        x, rest = solver.state.x.numpy().astype(float), solver.model.rest
        slopes = [1 - np.polyfit(rest[:, axis], x[:, axis], 1)[0] for axis in range(3)]
        area = half**2 * (1 - slopes[0]) * (1 - slopes[1])
        return float(abs(force[2]) / area / slopes[2]), float(-slopes[0] / slopes[2])

    free, ratio = press(1, 0)
    E = pressed_block.E
    return ratio, free / E, press(1, 2)[0] / E, press(3, 0)[0] / E


RUNS: dict[str, Callable[[int], Values]] = {
    "hertz": press_ball,
    "restitution": rebound,
    "middle-axis": tumble,
    "incline": slides,
    "pressed-block": press_block,
}


def main() -> None:
    """Measure the experiments that are named."""
    how = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    how.add_argument("names", nargs="+", choices=list(RUNS))
    how.add_argument("--cells", nargs="+", type=int, help="default: the experiment's grids")
    args = how.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    for name in args.names:
        experiment = find_experiment(name)
        published = experiment.published()
        for cells in args.cells or experiment.grids:
            start = time.process_time()
            values = RUNS[name](cells)
            print(f"{name}, {cells} cells, {time.process_time() - start:.1f} s of CPU time")
            for quantity, value in zip(published, values, strict=True):
                exact = quantity.published
                inside = "in" if quantity.low <= value <= quantity.high else "outside"
                change = f" ({value / exact - 1:+.2%})" if exact else ""
                words = f"{value:.5f}{change}, published {exact:.5f}"
                print(f"  {quantity.name}: {words}, {inside} the band", flush=True)


if __name__ == "__main__":
    main()
