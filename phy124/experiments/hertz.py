"""A ball between two plates, and a ball that bounces: Hertz's force and time of contact."""

from __future__ import annotations

import math

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.experiments import impact
from phy124.experiments.bodies import mirrors, shells
from phy124.experiments.experiment import Experiment, Quantity, Values
from phy124.experiments.roots import root
from phy124.materials import NeoHookean
from phy124.monitor.wrenches import Wrenches
from phy124.mpm import Model, Solver

RADIUS, E, NU = 0.5, 1e5, 0.3
"""Of the pressed ball: m, Pa."""
DEPTHS = (0.03, 0.05)
"""How far each plate presses it [m]."""
MOVE, HOLD, FPS = 0.4, 0.4, 50
"""Seconds to go from depth to depth and to stay there, and forces per second."""


def hertz(depth: float) -> float:
    """4/3 E / (1 - nu^2) sqrt(R) d^(3/2) [N]; both bodies count as half-spaces."""
    return 4 / 3 * E / (1 - NU**2) * math.sqrt(RADIUS) * depth**1.5


def tatara(depth: float) -> float:
    """Hertz for a ball between two plates [N], each of which moves what the other one touches.

    Tatara (1989) adds F f(a) / (pi E) to the approach, with the contact's radius a.
    """

    def force(a: float) -> float:
        return 4 * E / (1 - NU**2) * a**3 / (3 * RADIUS)

    def missing(a: float) -> float:
        reach = a * a + 4 * RADIUS**2
        f = 2 * (1 + NU) * RADIUS**2 / reach**1.5 + (1 - NU**2) / math.sqrt(reach)
        return a * a / RADIUS - force(a) * f / (math.pi * E) - depth

    return force(root(missing, 1e-9, RADIUS))


def pressed(cells: int, *, stiffer: float = 1.0) -> Values:
    """Mean force of the plate at each depth [N], from an eighth of the ball.

    Args:
        cells: Cells across its radius.
        stiffer: Factor on E, for the control.
    """
    dx = RADIUS / cells
    x, volume = shells(RADIUS, dx / 2)
    eighth = (x > 0).all(axis=1)
    x, volume = x[eighth], volume[eighth]
    x = x[order := np.argsort(x[:, 0])]
    volume = volume[order] * (math.pi / 6 * RADIUS**3 / volume.sum())
    times = np.cumsum([0.0] + [MOVE, HOLD] * len(DEPTHS))
    depths = np.repeat([0.0, *DEPTHS], 2)[1:]
    plate = HalfSpace(
        point=(0, 0, RADIUS), normal=(0, 0, -1.0), friction=0,
        motion=Path(times=tuple(times.tolist()), points=tuple((0, 0, -d) for d in depths.tolist())),
    )  # fmt: skip
    wrenches = Wrenches()
    walls = wrenches.boundaries([plate, *mirrors(0, 1, 2)])
    rubber = NeoHookean(E=stiffer * E, nu=NU, damping=30.0)
    model = Model.of(x, volume, [rubber], dx=dx, origin=(-0.75 * dx,) * 3)
    solver = Solver(model, boundaries=walls, accumulators=[wrenches], threads=1)
    found: dict[int, list[float]] = {}
    for frame in range(1, round(times[-1] * FPS) + 1):
        wrenches.begin()
        solver.advance(frame / FPS)
        leg, way = divmod(frame / FPS, MOVE + HOLD)
        forces = wrenches.contacts(solver, FPS) or {}
        if way > MOVE + HOLD / 2:
            found.setdefault(int(leg), []).append(4 * abs(forces["half_space"].force[2]))
    return tuple(float(np.mean(found[leg])) for leg in range(len(DEPTHS)))


def published() -> tuple[Quantity, ...]:
    """Forces between Hertz's and Tatara's, and the time in which a bouncing ball turns."""
    forces = [
        Quantity(f"force at depth {depth / RADIUS:g} R", 1.0, 1.0, tatara(depth) / hertz(depth))
        for depth in DEPTHS
    ]
    return (*forces, Quantity.within("time of contact", 1.0, 0.01))


def measured(cells: int, *, stiffer: float = 1.0) -> Values:
    """Forces, and the time from half the speed down to half the speed up, over Hertz's."""
    forces = pressed(cells, stiffer=stiffer)
    time = (
        impact.bounced(cells, 0.0, impact.SHALLOW, stiffer=stiffer).turning
        / impact.theory(0.0, impact.SHALLOW).turning
    )
    return (*(f / hertz(d) for f, d in zip(forces, DEPTHS, strict=True)), time)


def run(cells: int) -> Values:
    """Of the right material."""
    return measured(cells)


def control(cells: int) -> Values:
    """The same of a material 1.3 times as stiff."""
    return measured(cells, stiffer=1.3)


EXPERIMENT = Experiment(
    name="hertz",
    title="Hertz: force on a pressed ball, and time of contact of one that bounces",
    source="Hertz 1882; Tatara 1989 for a ball between two plates",
    measured="Force on the plate, from the impulses that the wall gives, at two depths; time in "
    "which a bouncing ball turns from half its speed down to half its speed up. All over Hertz's.",
    band="forces: from Hertz to Tatara, who counts what the other plate does; time: ±1 %",
    published=published,
    run=run,
    control=control,
    mistake="E is 30 % too large",
    grids=(10, 14, 20),
    across="the radius",
    unit="over Hertz's",
    seconds=30,
    reason="The balls are stiffer than theory by some per cent, which finer grids do not take "
    "away. The reason is not found. The contact's radius is only 2.4 to 6 cells; a wall that acts "
    "a tenth of a cell early makes the contact stiffer, particles that do not lie on a lattice "
    "make the ball softer, and three grids do not tell these apart.",
)
