"""A ball between two plates, and a ball that bounces: Hertz's force and time of contact."""

from __future__ import annotations

import math

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.materials import NeoHookean
from phy124.monitor.wrenches import Wrenches
from phy124.mpm import Model, Solver
from phy124.studies.validation.bodies import ball_of_shells
from phy124.studies.validation.experiments import impact
from phy124.studies.validation.experiments.elastic_ball import Law, law
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.symmetry import mirrors

RADIUS, E, NU = 0.5, 1e5, 0.3
"""Of the pressed ball: m, Pa."""
DEPTHS = (0.03, 0.05)
"""How far each plate presses it [m]."""
PLACES = (0.0, 0.5)
"""Where the plate comes to rest between two nodes, of which the mean is taken."""
MOVE, HOLD = 0.4, 0.4
"""Seconds to go to the depth and to stay there."""


def hertz(depth: float) -> float:
    """4/3 E / (1 - nu^2) sqrt(R) d^(3/2) [N]; both bodies count as half-spaces."""
    return 4 / 3 * E / (1 - NU**2) * math.sqrt(RADIUS) * depth**1.5


def pressed(
    cells: int,
    depth: float,
    *,
    stiffer: float = 1.0,
    precision: str = "float32",
    per_axis: int = 2,
    phase: float = 0.5,
) -> float:
    """Mean force of a plate [N], from an eighth of the ball.

    Args:
        cells: Cells across its radius.
        depth: How far the plate presses [m].
        stiffer: Factor on E, for the control.
        precision: float32 or float64.
        per_axis: Particles per cell and axis.
        phase: Where the plate comes to rest between two nodes, from 0 to 1.
    """
    dx = RADIUS / cells
    x, volume = ball_of_shells(RADIUS, dx / per_axis)
    eighth = (x > 0).all(axis=1)
    x, volume = x[eighth], volume[eighth]
    x = x[order := np.argsort(x[:, 0])]
    volume = volume[order] * (math.pi / 6 * RADIUS**3 / volume.sum())
    plate = HalfSpace(
        point=(0, 0, RADIUS), normal=(0, 0, -1.0), friction=0,
        motion=Path(times=(0.0, MOVE), points=((0, 0, 0), (0, 0, -depth))),
    )  # fmt: skip
    wrenches = Wrenches()
    walls = wrenches.wrap_walls([plate, *mirrors(0, 1, 2)])
    rubber = NeoHookean(E=stiffer * E, nu=NU, damping=30.0)
    low = (-0.75 * dx, -0.75 * dx, (RADIUS - depth) % dx - (1 + phase) * dx)
    solver = Solver(
        Model.of(x, volume, [rubber], dx=dx, origin=low, precision=precision),
        boundaries=walls, accumulators=[wrenches], threads=1,
    )  # fmt: skip
    solver.advance(MOVE + HOLD / 2)
    wrenches.before_attempt()
    solver.advance(MOVE + HOLD)
    forces = wrenches.contacts(solver, 2 / HOLD)
    return 4 * abs(float(forces["half_space"].force[2]))


def published() -> tuple[Quantity, ...]:
    """Forces of finite elements, and the time in which a ball with their law turns."""
    forces = [
        Quantity.within(f"force at depth {part:g} R", law(NU, whole=False).force(part) / half, 0.05)
        for part, half in ((depth / RADIUS, Law(NU).force(depth / RADIUS)) for depth in DEPTHS)
    ]
    return (*forces, Quantity.within("time of contact", turning(law(0.0, whole=True)), 0.01))


def turning(of: Law) -> float:
    """Time from half the speed down to half the speed up by a law, over that by Hertz's."""
    one, other = (impact.theory(0.0, impact.SHALLOW, each) for each in (of, Law(0.0)))
    return one.turning / other.turning


def measured(cells: int, *, stiffer: float = 1.0) -> Values:
    """Forces, and the time from half the speed down to half the speed up, over Hertz's."""
    time = (
        impact.bounced(cells, 0.0, impact.SHALLOW, stiffer=stiffer).turning
        / impact.theory(0.0, impact.SHALLOW, Law(0.0)).turning
    )
    forces = [
        sum(pressed(cells, depth, stiffer=stiffer, phase=place) for place in PLACES) / len(PLACES)
        for depth in DEPTHS
    ]
    return (*(force / hertz(depth) for force, depth in zip(forces, DEPTHS, strict=True)), time)


def run(cells: int) -> Values:
    """Of the right material."""
    return measured(cells)


def control(cells: int) -> Values:
    """The same of a material 1.3 times as stiff."""
    return measured(cells, stiffer=1.3)


EXPERIMENT = Experiment(
    name="hertz",
    title="Hertz: force on a pressed ball, and time of contact of one that bounces",
    source="finite elements of the whole neo-Hookean ball, which have Hertz's law (1882) as their "
    "limit for small depths (`phy124/studies/validation/experiments/elastic_ball.py`)",
    measured="Force on the plate, from the impulses that the wall gives, at two depths, each the "
    "mean of two places of the plate between the nodes; time in which a bouncing ball turns from "
    "half its speed down to half its speed up. All over Hertz's, who takes both bodies for "
    "half-spaces of small strain.",
    band="forces: ±5 %; time: ±1 %",
    published=published,
    run=run,
    control=control,
    mistake="E is 30 % too large",
    grids=(12, 16, 22),
    across="the radius",
    unit="over Hertz's",
    seconds=45,
)
