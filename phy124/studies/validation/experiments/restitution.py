"""Experiment: the speed of a viscoelastic ball after a slow bounce on a floor."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Ground, HalfSpace
from phy124.lattice.solver import LatticeSolver
from phy124.materials import NeoHookean
from phy124.mpm import Solver
from phy124.studies.validation.accuracy.problems import FLOOR_NODE
from phy124.studies.validation.bodies import (
    UP,
    fill_part_of_ball,
    find_zeros,
    make_lattice_solver,
    make_solver,
    mean_along,
    mirrors,
    part_of_ball,
    record,
)
from phy124.studies.validation.experiments.elastic_ball import Law, fit_law
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, repeat_with_mpm

RADIUS, DENSITY, E = 0.5, 1000.0, 1e6
"""Radius [m], density [kg/m^3] and Young's modulus [Pa] of the ball.

With nu = 0, the viscous stress is damping / mu times the rate of the elastic stress, so the force
law F + loss dF/dt is exact for a quasi-static contact.
"""
SHALLOW, DEEP = 0.06, 0.12
"""Maximum depths by Hertz's law, relative to the radius.

The contact time is measured in a shallow contact, because Hertz's law requires a shallow contact.
The energy loss is measured in a deep contact, because the area of a deep contact covers more cells.
"""
SAMPLES = 300
FLIGHT = 2.2
"""Duration of a run, in units of Hertz's contact time."""


@dataclass(frozen=True)
class Bounce:
    """The vertical velocity of the ball's centre over time."""

    times: NDArray[np.float64]
    speeds: NDArray[np.float64]
    """Upward velocities, in units of the initial speed."""

    @property
    def restitution(self) -> float:
        """Speed after the bounce / speed before."""
        return float(self.speeds[-SAMPLES // 4 :].mean())

    @property
    def turning(self) -> float:
        """Time in which the velocity changes from minus half to plus half the initial speed [s]."""
        down, up = (find_zeros(self.times, self.speeds - level)[0] for level in (-0.5, 0.5))
        return float(up - down)


def speed(depth: float) -> float:
    """Return the initial speed [m/s] by Hertz's law; `depth` is relative to the radius."""
    return math.sqrt(0.8 * depth**2.5 * E / (DENSITY * math.pi))


def duration(depth: float) -> float:
    """Return Hertz's contact time [s]: `2.94 depth / speed`; `depth` is relative to the radius."""
    return 2.9432 * depth * RADIUS / speed(depth)


def solve_theory(loss: float, depth: float, law: Law) -> Bounce:
    """Integrate the motion of a ball under the contact force `max(0, F + loss dF/dt)`.

    `loss` is damping / mu, in units of Hertz's contact time. `depth` is the maximum depth without
    loss, in radii. `law` is the force F.
    """
    from scipy.integrate import solve_ivp

    mass = 4 / 3 * math.pi * RADIUS**3 * DENSITY
    v, late = speed(depth), loss * duration(depth)

    def rates(time: float, y: list[float]) -> list[float]:
        way = max(y[0] / RADIUS, 0.0)
        force = law.force(way) + late * law.slope(way) * y[1] / RADIUS
        return [y[1], -max(force, 0.0) * E * RADIUS**2 / mass]

    times = np.linspace(0, FLIGHT * duration(depth), 4 * SAMPLES)
    y = solve_ivp(rates, (0, times[-1]), [0.0, v], t_eval=times, rtol=1e-9, atol=1e-12).y
    return Bounce(times, -y[1] / v)


def bounce(cells: int, loss: float, depth: float, *, stiffer: float = 1.0) -> Bounce:
    """Simulate a quarter of a ball that bounces on a smooth floor.

    Args:
        cells: Cells across the radius.
        loss: damping / mu, in units of Hertz's contact time.
        depth: Maximum depth without loss, in radii.
        stiffer: Factor on E, for a control.
    """
    dx = RADIUS / cells
    floor = HalfSpace(point=(0, 0, -RADIUS - 0.5 * dx), normal=UP, friction=0.0)
    solver = make_lattice_solver(
        fill_part_of_ball(RADIUS, dx, 2),
        dx,
        _rubber(loss, depth, stiffer),
        v=(0, 0, -speed(depth)),
        boundaries=[floor, *mirrors(0, 1)],
        threads=1,
    )
    return _observe(solver, depth)


def bounce_particles(cells: int, loss: float, depth: float, *, stiffer: float = 1.0) -> Bounce:
    """Simulate the bounce of `bounce` with MPM.

    Args:
        cells: Cells across the radius.
        loss: damping / mu, in units of Hertz's contact time.
        depth: Maximum depth without loss, in radii.
        stiffer: Factor on E, for a control.
    """
    dx = RADIUS / cells
    x, volume = part_of_ball(RADIUS, dx / 2, 2)
    x += [0, 0, RADIUS + 0.5 * dx]
    rubber = _rubber(loss, depth, stiffer)
    world = {
        "origin": (-FLOOR_NODE * dx,) * 3,
        "boundaries": [Ground(friction=0.0), *mirrors(0, 1)],
    }
    falling = np.tile([0, 0, -speed(depth)], (len(x), 1))
    solver = make_solver(x, volume, [rubber], v=falling, dx=dx, threads=1, **world)
    return _observe(solver, depth)


def _rubber(loss: float, depth: float, stiffer: float) -> NeoHookean:
    damping = loss * duration(depth) * E / 2
    return NeoHookean(E=stiffer * E, nu=0.0, density=DENSITY, damping=damping)


def _observe(solver: Solver | LatticeSolver, depth: float) -> Bounce:
    times = np.linspace(0, FLIGHT * duration(depth), SAMPLES + 1)[1:]
    speeds = record(solver, times, partial(mean_along, solver, "v", UP))
    return Bounce(times, speeds / speed(depth))


LOSSES = (0.0, 0.02, 0.05)
"""Ratios of damping to mu, in units of Hertz's contact time."""


def publish() -> tuple[Quantity, ...]:
    """Return the theoretical coefficients of restitution."""
    ball = fit_law(0.0, whole=True)
    return tuple(
        Quantity.within(f"η/μ = {loss:g} t", solve_theory(loss, DEEP, ball).restitution, 0.02, loss)
        for loss in LOSSES
    )


def measure(
    cells: int, *, factor: float = 1.0, simulate: Callable[..., Bounce] = bounce
) -> tuple[float, ...]:
    """Measure the coefficients of restitution; `factor` scales the damping."""
    return tuple(simulate(cells, factor * loss, DEEP).restitution for loss in LOSSES)


EXPERIMENT = Experiment(
    name="restitution",
    title="Restitution of a damped ball",
    source="numerical integration of the motion under the force F + (η/μ) dF/dt (Kuwabara and "
    "Kono 1987; exact for a quasi-static ball with ν = 0); F comes from finite elements "
    "of the whole ball, as in `hertz`",
    measured="The experiment measures the coefficient of restitution in a slow bounce, without "
    "and with viscosity η. The coefficient of restitution is the speed of the ball's centre after "
    "the bounce divided by the speed before the bounce. The floor indents the ball by 12 % of its "
    "radius. t is Hertz's contact time.",
    band="±2 %, since the theory neglects waves in the ball",
    published=publish,
    run=measure,
    control=partial(measure, factor=2.0),
    mistake="twice the damping",
    grids=(8, 11, 14),
    across="the radius",
    axis="η / μ, in times of contact",
    unit="speed after / before",
    seconds=60,
)
MPM = repeat_with_mpm(
    EXPERIMENT,
    partial(measure, simulate=bounce_particles),
    partial(measure, factor=2.0, simulate=bounce_particles),
    seconds=60,
)
