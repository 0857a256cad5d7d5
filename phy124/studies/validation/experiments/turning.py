"""Experiment: the moments of inertia of a rolling ball and of a swinging plate on lattices.

Because mass is lumped at nodes, the moment of inertia per mass is too large by dx^2 / 2.
"""

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import HalfSpace
from phy124.forces import Grab, Gravity
from phy124.materials import NeoHookean
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import (
    fill_solid,
    find_zeros,
    make_lattice_solver,
    mean_acceleration,
    mean_along,
    record,
)
from phy124.studies.validation.experiments.experiment import Experiment, Quantity

RUBBER = NeoHookean(E=4e6, nu=0.3, density=1000.0, damping=50.0)
RADIUS, SLOPE, FRICTION = 0.1, 0.3, 0.8
"""Radius of the ball [m], tangent of the slope's angle, and coefficient of friction."""
SETTLING, ROLLING = 0.15, 0.35
"""Start and duration of the ball's measurement [s]."""
PLATE = (0.4, 0.0125, 0.1)
"""Edges of the plate [m], which swings in its plane about a point on its longest axis."""
HINGE, GRIP = 0.15, 0.04
"""Distance of the hinge from the plate's centre, and radius of the held material [m]."""
ANGLE = 0.1
"""Amplitude of the swing [rad]."""
STIFFNESS = 1e6
"""Stiffness of the hinge [N/m]."""
SAMPLES = 60


def publish() -> tuple[Quantity, ...]:
    """Return the ball's acceleration / gravity, and the plate's period [s]."""
    rolling = 5 / 7 * math.sin(math.atan(SLOPE))
    return (
        Quantity.within("acceleration of the ball [g]", rolling, 0.01),
        Quantity.within("period of the plate [s]", exact_period(), 0.01),
    )


def exact_period() -> float:
    """Return the plate's period [s] at the amplitude `ANGLE`, to fourth order in the angle."""
    inertia = (PLATE[0] ** 2 + PLATE[2] ** 2) / 12 + HINGE**2
    small = 2 * math.pi * math.sqrt(inertia / (GRAVITY * HINGE))
    return small * (1 + ANGLE**2 / 16 + 11 * ANGLE**4 / 3072)


def roll(cells: int, gravity: float) -> float:
    """Measure the acceleration / standard gravity of a ball on a slope.

    `cells` is the number of cells across the ball.
    """
    dx, angle = 2 * RADIUS / cells, math.atan(SLOPE)
    centre = np.array([0.0, 0.0, RADIUS])

    def distance(x: NDArray) -> NDArray[np.float64]:
        return np.linalg.norm(x - centre, axis=-1) - RADIUS

    ball = fill_solid(distance, centre - RADIUS, centre + RADIUS, dx / 2)
    g = (gravity * math.sin(angle), 0.0, -gravity * math.cos(angle))
    plane = HalfSpace(normal=(0.0, 0.0, 1.0), friction=FRICTION)
    solver = make_lattice_solver(
        ball, dx, RUBBER, forces=[Gravity(g=g)], boundaries=[plane], threads=1
    )
    times = np.linspace(0, ROLLING, SAMPLES)
    return mean_acceleration(solver, (1.0, 0, 0), SETTLING, times) / GRAVITY


def swing(cells: int, gravity: float) -> float:
    """Measure the period of a plate that hangs from a hinge [s]; its length is `cells` cells."""
    dx, edges = PLATE[0] / cells, np.array(PLATE)

    def distance(x: NDArray) -> NDArray[np.float64]:
        return (np.abs(x) - edges / 2).max(axis=-1)

    plate = fill_solid(distance, -edges / 2, edges / 2, dx / 2)
    hinge = (-HINGE, 0.0, 0.0)
    grab = Grab(
        point=hinge, radius=GRIP, times=(0.0, 1.0), targets=(hinge, hinge),
        stiffness=STIFFNESS, damping=100.0, strength=1e6,
    )  # fmt: skip
    g = (gravity * math.cos(ANGLE), 0.0, gravity * math.sin(ANGLE))
    solver = make_lattice_solver(plate, dx, RUBBER, forces=[Gravity(g=g), grab], threads=1)
    across = (-math.sin(ANGLE), 0.0, math.cos(ANGLE))
    times = np.linspace(0, 0.9 * exact_period(), SAMPLES)
    places = record(solver, times, partial(mean_along, solver, "x", across))
    first, second = find_zeros(times, places - np.dot(hinge, across))[:2]
    return float(2 * (second - first))


EXPERIMENT = Experiment(
    name="turning",
    title="Turning: a ball that rolls, and a plate that swings",
    source="rigid bodies: the ball's acceleration is 5/7 g sin θ; the plate's period is T = 2π "
    "√(I / m g d), corrected for an amplitude of 0.1 rad",
    measured="The experiment uses the lattice solver. The experiment measures the acceleration of "
    "a ball that rolls down a slope of tan θ = 0.3, in units of gravity. The experiment also "
    "measures the period of a plate of 0.4 × 0.1 × 0.0125 m that swings in its plane, about a "
    "point 0.15 m from its centre.",
    band="±1 %; the value on the finest grid (the grid of `standard`) is also within this band",
    published=publish,
    run=lambda cells: (roll(cells, GRAVITY), swing(cells, GRAVITY)),
    control=lambda cells: (roll(cells, 1.05 * GRAVITY), swing(cells, 1.05 * GRAVITY)),
    mistake="gravity is 5 % too strong",
    grids=(16, 24, 32),
    across="the ball, or along the plate",
    seconds=50,
)
