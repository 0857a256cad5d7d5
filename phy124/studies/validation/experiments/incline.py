"""Experiment: Coulomb friction of a block on an incline, aligned with or oblique to the grid."""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.forces import Gravity
from phy124.lattice.solver import LatticeSolver
from phy124.materials import NeoHookean
from phy124.mpm import Solver
from phy124.particles.solid import Solid
from phy124.studies.validation.accuracy.problems import FLOOR_NODE, GRAVITY
from phy124.studies.validation.bodies import (
    fill_box,
    fill_solid,
    lattice,
    make_lattice_solver,
    make_solver,
    mean_acceleration,
)
from phy124.studies.validation.experiments.experiment import (
    Experiment,
    Quantity,
    Values,
    repeat_with_mpm,
)

CASES = ((0.3, 0.0), (0.5, 0.3), (0.8, 0.4), (0.3, 0.5))
"""Slope tan(angle) and coefficient of friction; in the last case, nothing slides."""
SIZE, SETTLING, SLIDING = 0.4, 1.4, 0.4
"""Edge of the block [m], duration of settling [s], and duration of sliding [s]."""
SAMPLES = 41
"""Number of positions to which a parabola is fitted; the fit averages out the block's rocking."""
RUBBER = NeoHookean(E=2e5, damping=600.0)
Vector = tuple[float, float, float]


class Slope(NamedTuple):
    """An incline, with unit vectors along it and normal to it, and gravity [m/s^2]."""

    along: Vector
    up: Vector
    gravity: Vector


def acceleration(slope: float, friction: float) -> float:
    """Return the exact acceleration on a slope of angle `a`: `max(0, sin a - mu cos a)` [g]."""
    angle = math.atan(slope)
    return max(0.0, math.sin(angle) - friction * math.cos(angle))


def publish() -> tuple[Quantity, ...]:
    """Return the exact accelerations, first for tilted gravity and then for a tilted wall."""
    return tuple(
        Quantity(f"tan θ = {slope:g}, μ = {mu:g}, {how}", exact, exact - 0.002, exact + 0.002)
        for how in ("along the grid", "across it")
        for slope, mu in CASES
        for exact in [acceleration(slope, mu)]
    )


def slide(cells: int, slope: float, friction: float, *, across: bool) -> float:
    """Measure the acceleration along the incline, in units of gravity.

    Args:
        cells: Cells across the block.
        slope: Tangent of the incline's angle.
        friction: Coefficient of friction.
        across: True to tilt the wall against the grid, False to tilt gravity instead.
    """
    dx, incline = SIZE / cells, _tilt(slope, across=across)
    block = _turned_block(incline, dx) if across else fill_box((SIZE,) * 3, dx)
    plane, gravity = HalfSpace(normal=incline.up, friction=friction), Gravity(g=incline.gravity)
    solver = make_lattice_solver(block, dx, RUBBER, forces=[gravity], boundaries=[plane], threads=1)
    return _mean_acceleration(solver, incline)


def slide_particles(cells: int, slope: float, friction: float, *, across: bool) -> float:
    """Measure the acceleration of `slide` with MPM.

    Args:
        cells: Cells across the block.
        slope: Tangent of the incline's angle.
        friction: Coefficient of friction.
        across: True to tilt the wall against the grid, False to tilt gravity instead.
    """
    dx, incline = SIZE / cells, _tilt(slope, across=across)
    x = lattice((2 * cells,) * 3, dx / 2, (-SIZE / 2, -SIZE / 2, 0.0))
    if across:
        x = x @ np.array([incline.along, (0, 1, 0), incline.up])
    world = {
        "forces": [Gravity(g=incline.gravity)],
        "boundaries": [HalfSpace(normal=incline.up, friction=friction)],
        "origin": (0, 0, -FLOOR_NODE * dx),
    }
    solver = make_solver(x, (dx / 2) ** 3, [RUBBER], dx=dx, threads=1, **world)
    return _mean_acceleration(solver, incline)


def _tilt(slope: float, *, across: bool) -> Slope:
    """Return a tilted incline if `across` is true, else a level plane with tilted gravity."""
    sine, cosine = math.sin(math.atan(slope)), math.cos(math.atan(slope))
    if across:
        return Slope((cosine, 0.0, -sine), (sine, 0.0, cosine), (0.0, 0.0, -GRAVITY))
    return Slope((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (GRAVITY * sine, 0.0, -GRAVITY * cosine))


def _turned_block(incline: Slope, dx: float) -> Solid:
    axes, middle = np.array([incline.along, (0, 1, 0), incline.up]), np.array([0, 0, SIZE / 2])

    def distance(x: NDArray) -> NDArray[np.float64]:
        return np.abs(x @ axes.T - middle).max(axis=-1) - SIZE / 2

    return fill_solid(distance, (-2 * SIZE,) * 3, (2 * SIZE,) * 3, dx / 2)


def _mean_acceleration(solver: Solver | LatticeSolver, incline: Slope) -> float:
    solver.advance(SETTLING)
    times = np.linspace(0, SLIDING, SAMPLES)
    return mean_acceleration(solver, incline.along, SETTLING, times) / GRAVITY


def measure(cells: int, *, more: float = 0.0, simulate: Callable[..., float] = slide) -> Values:
    """Measure all accelerations with a coefficient of friction that is too large by `more`."""
    return tuple(
        simulate(cells, slope, mu + more, across=across)
        for across in (False, True)
        for slope, mu in CASES
    )


EXPERIMENT = Experiment(
    name="incline",
    title="Incline: Coulomb's friction",
    source="Coulomb's law: the acceleration is g (sin θ − μ cos θ), or zero if the block rests",
    measured="The experiment measures the acceleration of a block on an incline in units of "
    "gravity. In half of the cases, the incline is parallel to a plane of the grid, and gravity is "
    "tilted. In the other half, the incline is tilted relative to the grid.",
    band="±0.002 g, since the block still rocks slightly",
    published=publish,
    run=measure,
    control=partial(measure, more=0.05),
    mistake="friction is 0.05 too large",
    grids=(6, 8, 10),
    across="the block",
    unit="g",
    quick=True,
    seconds=40,
)
MPM = repeat_with_mpm(
    EXPERIMENT,
    partial(measure, simulate=slide_particles),
    partial(measure, more=0.05, simulate=slide_particles),
    seconds=40,
)
