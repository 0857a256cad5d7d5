"""Experiment: the force on a ball between two plates, and the contact time of a bouncing ball."""

import math
from collections.abc import Sequence
from functools import partial

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.materials import NeoHookean
from phy124.mpm import Model
from phy124.studies.validation.bodies import (
    fill_part_of_ball,
    make_lattice_solver,
    measure_wall_force,
    mirrors,
    part_of_ball,
)
from phy124.studies.validation.experiments import restitution
from phy124.studies.validation.experiments.elastic_ball import Law, fit_law
from phy124.studies.validation.experiments.experiment import (
    Experiment,
    Quantity,
    Values,
    repeat_with_mpm,
)
from phy124.studies.validation.experiments.pressed_block import hold_plates

RADIUS, E, NU = 0.5, 1e5, 0.3
"""Radius [m], Young's modulus [Pa] and Poisson's ratio of the pressed ball."""
DEPTHS = (0.03, 0.05)
"""Indentation by each plate [m]."""
PLACES = (0.0, 0.5)
"""Final positions of the plate relative to a grid node [cells]. The forces at these positions are
averaged.
"""
MOVE, HOLD = 0.4, 0.4
"""Durations for which the plate moves and then rests [s]."""


def hertz(depth: float) -> float:
    """Return Hertz's force at a depth d [m]: `4/3 E / (1 - nu^2) sqrt(R) d^(3/2)` [N]."""
    return 4 / 3 * E / (1 - NU**2) * math.sqrt(RADIUS) * depth**1.5


def press(cells: int, depth: float, *, stiffer: float = 1.0) -> float:
    """Return the mean force of a plate on the ball [N]. An eighth of the ball is simulated.

    Args:
        cells: Cells across the radius.
        depth: Indentation [m].
        stiffer: Factor on E, for the control.
    """
    dx = RADIUS / cells
    solver = make_lattice_solver(
        fill_part_of_ball(RADIUS, dx, 3),
        dx,
        _rubber(stiffer),
        boundaries=[_plate(depth), *mirrors(0, 1, 2)],
        threads=1,
    )
    force = measure_wall_force(solver, MOVE + HOLD / 2, MOVE + HOLD)
    return 4 * abs(float(force[2]))


def press_particles(
    cells: int,
    depth: float,
    *,
    stiffer: float = 1.0,
    precision: str = "float32",
    per_axis: int = 2,
    phase: float = 0.5,
) -> float:
    """Return the mean force of a plate on the ball with MPM [N].

    Args:
        cells: Cells across the radius.
        depth: Indentation [m].
        stiffer: Factor on E, for the control.
        precision: float32 or float64.
        per_axis: Particles per cell and axis.
        phase: Final position of the plate relative to a node [cells], 0 to 1.
    """
    dx = RADIUS / cells
    x, volume = part_of_ball(RADIUS, dx / per_axis, 3)
    low = (-0.75 * dx, -0.75 * dx, (RADIUS - depth) % dx - (1 + phase) * dx)
    model = Model.of(x, volume, [_rubber(stiffer)], dx=dx, origin=low, precision=precision)
    _, force = hold_plates(model, [_plate(depth)], MOVE, HOLD)
    return 4 * force


def _plate(depth: float) -> HalfSpace:
    motion = Path(times=(0.0, MOVE), points=((0, 0, 0), (0, 0, -depth)))
    return HalfSpace(point=(0, 0, RADIUS), normal=(0, 0, -1.0), friction=0, motion=motion)


def _rubber(stiffer: float) -> NeoHookean:
    return NeoHookean(E=stiffer * E, nu=NU, damping=30.0)


def publish() -> tuple[Quantity, ...]:
    """Return the forces and the contact time from finite elements, relative to Hertz's theory."""
    forces = [
        Quantity.within(
            f"force at depth {part:g} R", fit_law(NU, whole=False).force(part) / half, 0.05
        )
        for part, half in ((depth / RADIUS, Law(NU).force(depth / RADIUS)) for depth in DEPTHS)
    ]
    return (
        *forces,
        Quantity.within("time of contact", turning_time(fit_law(0.0, whole=True)), 0.01),
    )


def turning_time(of: Law) -> float:
    """Return the contact time of a bouncing ball for a force law, relative to Hertz's law.

    The contact time begins when the ball moves downwards at half its initial speed, and ends when
    the ball moves upwards at half its initial speed.
    """
    depth = restitution.SHALLOW
    turning = [restitution.solve_theory(0.0, depth, law).turning for law in (of, Law(0.0))]
    return turning[0] / turning[1]


def measure(cells: int, *, stiffer: float = 1.0) -> Values:
    """Measure the forces and the contact time, relative to Hertz's theory; `stiffer` scales E."""
    forces = [press(cells, depth, stiffer=stiffer) for depth in DEPTHS]
    bounce = restitution.bounce(cells, 0.0, restitution.SHALLOW, stiffer=stiffer)
    return _over_theory(forces, bounce)


def measure_particles(cells: int, *, stiffer: float = 1.0) -> Values:
    """Measure the values of `measure` with MPM.

    Each force is the mean of two runs, with different positions of the plate between grid nodes.
    """
    forces = [
        sum(press_particles(cells, depth, stiffer=stiffer, phase=place) for place in PLACES)
        / len(PLACES)
        for depth in DEPTHS
    ]
    bounce = restitution.bounce_particles(cells, 0.0, restitution.SHALLOW, stiffer=stiffer)
    return _over_theory(forces, bounce)


def _over_theory(forces: Sequence[float], bounce: restitution.Bounce) -> Values:
    theory = restitution.solve_theory(0.0, restitution.SHALLOW, Law(0.0))
    ratios = [force / hertz(depth) for force, depth in zip(forces, DEPTHS, strict=True)]
    return (*ratios, bounce.turning / theory.turning)


EXPERIMENT = Experiment(
    name="hertz",
    title="Hertz: force on a pressed ball, and contact time of a bouncing ball",
    source="finite elements of the whole neo-Hookean ball, which approach Hertz's law (1882) for "
    "small depths (`phy124/studies/validation/experiments/elastic_ball.py`)",
    measured="The force on the plate at two depths is computed from the plate's impulses. The "
    "contact time of a bouncing ball begins when its downward speed has fallen to half the initial "
    "speed, and ends when its upward speed has risen to half the initial speed. All values are "
    "relative to Hertz's theory, which treats both bodies as half-spaces with small strain.",
    band="forces: ±5 %; time: ±1 %",
    published=publish,
    run=measure,
    control=partial(measure, stiffer=1.3),
    mistake="E is 30 % too large",
    grids=(12, 16, 22),
    across="the radius",
    unit="over Hertz's",
    seconds=45,
)
MPM = repeat_with_mpm(
    EXPERIMENT, measure_particles, partial(measure_particles, stiffer=1.3), seconds=45
)
