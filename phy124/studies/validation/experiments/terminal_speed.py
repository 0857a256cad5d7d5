"""Experiment: the terminal speed of a body that falls through an upward stream of air."""

import math
from functools import partial

import numpy as np

from phy124.forces import Gravity, Wind
from phy124.materials import NeoHookean
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import UP, lattice, make_solver, mean_along, record
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values

RATE, STREAM = 5.0, 1.0
"""Rate of the drag [1/s], and upward speed u of the air stream [m/s]."""
TIMES = (0.5, 1.0, 2.0, 6.0)
"""Times of the measurements, in units of 1 / rate."""
LIMIT = STREAM - GRAVITY / RATE
"""Terminal velocity u - g / rate [m/s]; negative, because the body falls."""


def way(time: float) -> float:
    """Return the upward displacement [m]: `(u - g / rate) (t - (1 - exp(-rate t)) / rate)`.

    The argument `time` is rate * t.
    """
    return LIMIT / RATE * (time - 1 + math.exp(-time))


def publish() -> tuple[Quantity, ...]:
    """Return the exact displacements and the final velocity."""
    ways = [
        Quantity.within(f"displacement at t = {time:g} / rate [m]", way(time), 0.002, time)
        for time in TIMES
    ]
    speed = LIMIT * (1 - math.exp(-TIMES[-1]))
    return (*ways, Quantity.within("speed at the end [m/s]", speed, 0.002, TIMES[-1]))


def blow(cells: int, rate: float) -> Values:
    """Simulate the falling block, with `cells` cells across it and a rate of drag [1/s].

    Return the displacement at each time [m], and the final velocity [m/s], both upwards.
    """
    dx = 0.4 / cells
    x = lattice((2 * cells,) * 3, dx / 2)
    forces, jelly = [Gravity(), Wind(v=(0, 0, STREAM), rate=rate)], [NeoHookean(E=1e4)]
    solver = make_solver(x, (dx / 2) ** 3, jelly, dx=dx, forces=forces, threads=1)
    start = mean_along(solver, "x", UP)
    heights = record(solver, np.array(TIMES) / RATE, partial(mean_along, solver, "x", UP))
    return (*(heights - start).tolist(), mean_along(solver, "v", UP))


EXPERIMENT = Experiment(
    name="terminal-speed",
    title="Terminal speed in `wind`",
    source="dv/dt = rate (u − v) − g, for the velocity v of the block and the velocity u of the "
    "stream",
    measured="A soft block falls through a stream that flows upwards. The experiment measures the "
    "upward displacement of the block at several times, and its final upward velocity.",
    band="±0.2 %",
    published=publish,
    run=lambda cells: blow(cells, RATE),
    control=lambda cells: blow(cells, 1.1 * RATE),
    mistake="the rate is 10 % too large",
    grids=(4, 6, 8),
    across="the block",
    axis="rate × time",
    unit="m, m/s",
    quick=True,
    seconds=2,
)
