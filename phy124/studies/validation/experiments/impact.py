"""An elastic ball, with a viscosity of its own, that hits a floor slowly: by a law and by MPM."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Ground
from phy124.materials import NeoHookean
from phy124.mpm import Model, Solver, State
from phy124.studies.validation.accuracy.problems import FLOOR_NODE
from phy124.studies.validation.bodies import ball_of_shells
from phy124.studies.validation.experiments.elastic_ball import Law
from phy124.studies.validation.experiments.symmetry import mean_along, mirrors

RADIUS, DENSITY, E = 0.5, 1000.0, 1e6
"""Of the ball: m, kg/m^3, Pa; with nu = 0 its viscous stress is its elastic one's rate times
damping / mu, and a law of force with such a loss has no further assumption."""
SHALLOW, DEEP = 0.06, 0.12
"""How deep it is pressed at most, in radii, which sets its speed: for Hertz's force, and for what
is lost, which asks for a contact of more cells and less for Hertz's force."""
SAMPLES = 300
"""Instants per run."""
FLIGHT = 2.2
"""Length of a run in Hertz's times of contact."""


@dataclass(frozen=True)
class Bounce:
    """The speed of the ball's centre over time."""

    times: NDArray[np.float64]
    speeds: NDArray[np.float64]
    """Upwards, in units of its speed before."""

    @property
    def restitution(self) -> float:
        """Speed after over speed before."""
        return float(self.speeds[-SAMPLES // 4 :].mean())

    @property
    def turning(self) -> float:
        """Time from half the speed down to half the speed up [s]."""
        return _crossing(self.times, self.speeds, 0.5) - _crossing(self.times, self.speeds, -0.5)


def _crossing(times: NDArray, speeds: NDArray, level: float) -> float:
    """When the speed first exceeds a level, between two instants."""
    after = int(np.argmax(speeds > level))
    return float(np.interp(level, speeds[after - 1 : after + 1], times[after - 1 : after + 1]))


def speed(depth: float) -> float:
    """The speed at which Hertz's law presses the ball by `depth` radii [m/s]."""
    return math.sqrt(0.8 * depth**2.5 * E / (DENSITY * math.pi))


def duration(depth: float) -> float:
    """Hertz's time of contact at this speed [s]: 2.94 depth / speed."""
    return 2.9432 * depth * RADIUS / speed(depth)


def theory(loss: float, depth: float, law: Law) -> Bounce:
    """A law with a force F + loss dF/dt that never pulls, integrated numerically.

    Args:
        loss: damping / mu, in times of contact.
        depth: How deep Hertz's law would press it without loss, in radii.
        law: The force F.
    """
    from scipy.integrate import solve_ivp

    mass = 4 / 3 * math.pi * RADIUS**3 * DENSITY
    v, late = speed(depth), loss * duration(depth)

    def rates(time: float, y: list[float]) -> list[float]:
        del time
        way = max(y[0] / RADIUS, 0.0)
        force = law.force(way) + late * law.slope(way) * y[1] / RADIUS
        return [y[1], -max(force, 0.0) * E * RADIUS**2 / mass]

    times = np.linspace(0, FLIGHT * duration(depth), 4 * SAMPLES)
    y = solve_ivp(rates, (0, times[-1]), [0.0, v], t_eval=times, rtol=1e-9, atol=1e-12).y
    return Bounce(times, -y[1] / v)


def bounced(cells: int, loss: float, depth: float, *, stiffer: float = 1.0) -> Bounce:
    """A quarter of a ball dropped on a smooth floor.

    Args:
        cells: Cells across its radius.
        loss: damping / mu, in times of contact.
        depth: How deep Hertz's law would press it without loss, in radii.
        stiffer: Factor on E, for a control.
    """
    dx, v = RADIUS / cells, speed(depth)
    x, volume = ball_of_shells(RADIUS, dx / 2)
    quarter = (x[:, 0] > 0) & (x[:, 1] > 0)
    x, volume = x[quarter] + [0, 0, RADIUS + 0.5 * dx], volume[quarter]
    x = x[order := np.argsort(x[:, 0])]
    volume = volume[order] * (math.pi / 3 * RADIUS**3 / volume.sum())
    damping = loss * duration(depth) * E / 2
    rubber = NeoHookean(E=stiffer * E, nu=0.0, density=DENSITY, damping=damping)
    model = Model.of(x, volume, [rubber], dx=dx, origin=(-FLOOR_NODE * dx,) * 3)
    state = State.of(model, np.tile([0, 0, -v], (len(x), 1)))
    walls = [Ground(friction=0.0), *mirrors(0, 1)]
    solver = Solver(model, state, boundaries=walls, threads=1)
    times = np.linspace(0, FLIGHT * duration(depth), SAMPLES + 1)[1:]
    speeds = []
    for time in times:
        solver.advance(float(time))
        speeds.append(mean_along(solver, "v", (0, 0, 1)) / v)
    return Bounce(times, np.array(speeds))
