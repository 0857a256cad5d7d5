"""Experiment: Coulomb friction of a block on an incline, aligned with or oblique to the grid."""

import math

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.forces import Gravity
from phy124.materials import NeoHookean
from phy124.studies.validation.accuracy.problems import FLOOR_NODE, GRAVITY
from phy124.studies.validation.bodies import lattice, make_solver, mean_acceleration
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values

CASES = ((0.3, 0.0), (0.5, 0.3), (0.8, 0.4), (0.3, 0.5))
"""Slope tan(angle) and coefficient of friction; in the last case, nothing slides."""
SIZE, SETTLING, SLIDING = 0.4, 1.4, 0.4
"""Edge of the block [m], duration of settling [s], and duration of sliding [s]."""
SAMPLES = 41
"""Number of positions to which a parabola is fitted; the fit averages out the block's rocking."""


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
    dx, angle = SIZE / cells, math.atan(slope)
    along, up = (math.cos(angle), 0.0, -math.sin(angle)), (math.sin(angle), 0.0, math.cos(angle))
    x = lattice((2 * cells,) * 3, dx / 2, (-SIZE / 2, -SIZE / 2, 0.0))
    g, way, wall = (GRAVITY * math.sin(angle), 0.0, -GRAVITY * math.cos(angle)), (1.0, 0, 0), None
    if across:
        x, g, way, wall = x @ np.array([along, (0, 1, 0), up]), (0.0, 0.0, -GRAVITY), along, up
    plane = HalfSpace(normal=wall or (0.0, 0.0, 1.0), friction=friction)
    rubber = NeoHookean(E=2e5, damping=600.0)
    world = {"forces": [Gravity(g=g)], "boundaries": [plane], "origin": (0, 0, -FLOOR_NODE * dx)}
    solver = make_solver(x, (dx / 2) ** 3, [rubber], dx=dx, threads=1, **world)
    solver.advance(SETTLING)
    return mean_acceleration(solver, way, SETTLING, np.linspace(0, SLIDING, SAMPLES)) / GRAVITY


def measure(cells: int, more: float) -> Values:
    """Measure all accelerations with a coefficient of friction that is too large by `more`."""
    return tuple(
        slide(cells, slope, mu + more, across=across)
        for across in (False, True)
        for slope, mu in CASES
    )


EXPERIMENT = Experiment(
    name="incline",
    title="Incline: Coulomb's friction",
    source="Coulomb's law: the acceleration is g (sin θ − μ cos θ), or zero if the block rests",
    measured="The experiment measures the acceleration of a block on an incline in units of "
    "gravity. In half of the cases, the incline is parallel to a plane of the grid, and gravity is "
    "tilted. In the other half, the incline is tilted against the grid.",
    band="±0.002 g, since the block still rocks slightly",
    published=publish,
    run=lambda cells: measure(cells, 0.0),
    control=lambda cells: measure(cells, 0.05),
    mistake="friction is 0.05 too large",
    grids=(6, 8, 10),
    across="the block",
    unit="g",
    quick=True,
    seconds=40,
)
