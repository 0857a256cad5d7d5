"""A body that falls through a stream: it comes to the speed at which drag carries its weight."""

from __future__ import annotations

import math

import numpy as np

from phy124.accuracy.problems import GRAVITY
from phy124.experiments.bodies import brick, mean_along
from phy124.experiments.experiment import Experiment, Quantity, Values
from phy124.forces import Gravity, Wind
from phy124.materials import NeoHookean
from phy124.mpm import Model, Solver

RATE, STREAM = 5.0, 1.0
"""Of the drag [1/s], and speed of the stream upwards [m/s]."""
TIMES = (0.5, 1.0, 2.0, 6.0)
"""In units of 1 / rate."""


def exact(time: float) -> float:
    """Speed upwards [m/s]: (u - g / rate) (1 - exp(-rate t)).

    Args:
        time: In units of 1 / rate.
    """
    return (STREAM - GRAVITY / RATE) * (1 - math.exp(-time))


def published() -> tuple[Quantity, ...]:
    """Speeds on the way, and at the end."""
    return tuple(
        Quantity.within(f"t = {time:g} / rate", exact(time), 0.002, time) for time in TIMES
    )


def blown(cells: int, rate: float) -> Values:
    """Speeds upwards of a falling block [m/s].

    Args:
        cells: Cells across it.
        rate: Of the drag [1/s].
    """
    dx = 0.4 / cells
    x = brick((2 * cells,) * 3, dx / 2)
    model = Model.of(x, np.full(len(x), (dx / 2) ** 3), [NeoHookean(E=1e4)], dx=dx)
    forces = [Gravity(), Wind(v=(0, 0, STREAM), rate=rate)]
    solver, found = Solver(model, forces=forces, threads=1), []
    for time in TIMES:
        solver.advance(time / RATE)
        found.append(mean_along(solver, "v", (0, 0, 1)))
    return tuple(found)


def run(cells: int) -> Values:
    """In the right stream."""
    return blown(cells, RATE)


def control(cells: int) -> Values:
    """With a drag of another rate."""
    return blown(cells, 1.1 * RATE)


EXPERIMENT = Experiment(
    name="terminal-speed",
    title="Terminal speed in `wind`",
    source="v = (u − g/rate) (1 − e^(−rate t))",
    measured="Speed of a soft block that falls through a stream against it, upwards.",
    band="±0.2 %",
    published=published,
    run=run,
    control=control,
    mistake="the rate is 10 % too large",
    grids=(4, 6, 8),
    across="the block",
    axis="rate × time",
    unit="m/s",
    reason="Drag and weight act one after the other in each substep, so what falls through a "
    "stream is too fast by rate × dt / 2. Half the substep halves the error on every "
    "grid: at the end 6.1 and 3.1 % on 4 cells, 3.1 and 1.5 % on 8.",
    quick=True,
    seconds=2,
)
