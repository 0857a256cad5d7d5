"""Experiment: the collapse of a water column (Martin and Moyce 1952)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Container
from phy124.schema.region import Region
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import connected_end
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.liquids import fill, solver_of

INVISCID = ((1.2, 1.75), (1.6, 2.18), (2.0, 2.68), (2.5, 3.37), (3.0, 4.12))
"""(Time t sqrt(2 g / a), position of the front / a) of an inviscid liquid without a gate.

The values come from a separate two-dimensional solver (APIC and pressure projection with a
ghost-fluid surface, 128 cells across a). Its results with 64 cells are at most 0.01 smaller.
"""
HEIGHTS = (1.28, 2.0, 2.7)
"""Dimensionless times t sqrt(g / a) at which the height of the water at the wall is measured."""
PASSAGE = (1.5, 3.5)
"""Positions / a between which the front's mean speed is measured.

Unlike the front's position at a given time, this speed does not depend on a delay of the start.
"""
PERIOD = (1.2, 3.0)
"""Dimensionless times t sqrt(2 g / a) between which the front's mean speed is measured."""
FRONT_2_25 = (
    (0.832, 1.217),
    (1.219, 1.474),
    (1.997, 2.292),
    (2.547, 2.995),
    (3.345, 4.134),
    (4.034, 4.944),
)
"""(Time, position of the front / a), for a column of width a = 2.25 inch and height 2 a.

The values were digitised by PySPH.
"""
FRONT_1_125 = (
    (0.849, 1.245),
    (1.212, 1.443),
    (1.602, 1.884),
    (2.283, 2.689),
    (2.950, 3.728),
    (3.598, 4.528),
)
"""(Time, position of the front / a), for a column of width a = 1.125 inch (digitised by PySPH)."""
FRONT_TABLE = (
    (0.84, 1.22),
    (1.19, 1.44),
    (1.43, 1.67),
    (1.63, 1.89),
    (1.83, 2.11),
    (1.98, 2.33),
    (2.20, 2.56),
    (2.32, 2.78),
    (2.51, 3.00),
    (2.65, 3.22),
    (2.83, 3.44),
    (2.98, 3.67),
    (3.11, 3.89),
    (3.33, 4.11),
)
"""(Time, position of the front / a), from table 2 (as published with Ocellaris)."""
HEIGHT_TABLE = (
    (0.56, 0.94),
    (0.77, 0.89),
    (0.93, 0.83),
    (1.08, 0.78),
    (1.28, 0.72),
    (1.46, 0.67),
    (1.66, 0.61),
    (1.84, 0.56),
    (2.00, 0.50),
    (2.21, 0.44),
    (2.45, 0.39),
    (2.70, 0.33),
    (3.06, 0.28),
    (3.44, 0.22),
)
"""(Time t sqrt(g / a), height at the wall / initial height), from table 6.

The values are as published with Ocellaris.
"""
READ = 0.02
"""Maximum error of a tabulated height / initial height, and of a front position / a.

Tabulated heights differ by steps of 0.05 to 0.06. The distance between two positions has at most
twice this error.
"""
SAMPLE = 0.1
"""Sampling interval of the front and the height, in dimensionless time t sqrt(2 g / a)."""
PASTE = 630.0
"""Viscosity of the control [Pa s]; its Reynolds number a sqrt(2 g a) / nu is 7."""


def mean_speeds(time: NDArray[np.float64], front: NDArray[np.float64]) -> tuple[float, float]:
    """Return two mean speeds dZ/dT of the front: between the positions in `PASSAGE`, and during
    `PERIOD`.

    Args:
        time: Times T = t sqrt(2 g / a).
        front: Increasing positions Z of the front / a at these times.
    """
    start, end = np.interp(PASSAGE, front, time)
    low, high = np.interp(PERIOD, time, front)
    return (
        float((PASSAGE[1] - PASSAGE[0]) / (end - start)),
        float((high - low) / (PERIOD[1] - PERIOD[0])),
    )


def publish() -> tuple[Quantity, ...]:
    """Return the inviscid front, and the measured speeds of the front and heights at the wall."""
    sets = (np.array(each).T for each in (FRONT_2_25, FRONT_1_125, FRONT_TABLE))
    names = (
        f"speed from Z = {PASSAGE[0]:g} to {PASSAGE[1]:g}",
        f"speed from T = {PERIOD[0]:g} to {PERIOD[1]:g}",
    )
    speeds = np.array([mean_speeds(*each) for each in sets]).T
    off = 2 * READ / (PASSAGE[1] - PASSAGE[0])
    table = np.array(HEIGHT_TABLE)
    heights = [float(np.interp(time, table[:, 0], table[:, 1])) for time in HEIGHTS]
    return (
        *(Quantity.within(f"inviscid front at T = {time:g}", z, 0.03) for time, z in INVISCID),
        *(
            Quantity(name, float(v.mean()), (1 - off) * float(v.min()), (1 + off) * float(v.max()))
            for name, v in zip(names, speeds, strict=True)
        ),
        *(
            Quantity(f"height at T/√2 = {time:g}", height, height - READ, height + READ)
            for time, height in zip(HEIGHTS, heights, strict=True)
        ),
    )


def release(cells: int, viscosity: float) -> Values:
    """Simulate the collapse of a column in a smooth channel, and measure the column's front and
    height.

    The column is 1 m wide (a = 1 m) and 2 m high.

    Args:
        cells: Cells across the column's width.
        viscosity: Dynamic viscosity [Pa s].
    """
    width, unit = 2 / cells, math.sqrt(1 / (2 * GRAVITY))
    x = fill((1, width, 2), cells)
    channel = Container(inside=Region(lower=(0, 0, 0), upper=(9, width, 9)), contact="slip")
    solver = solver_of(x, np.zeros_like(x), cells, [channel], GRAVITY, viscosity)
    times: NDArray[np.float64] = SAMPLE * np.arange(
        1.0, 1 + math.ceil(math.sqrt(2) * HEIGHTS[-1] / SAMPLE)
    )
    fronts, heights = [], []
    for time in times:
        solver.advance(time * unit)
        x = solver.state.x.numpy().astype(float)
        fronts.append(connected_end(x[:, 0], 1 / cells) + 0.25 / cells)
        at_wall = x[x[:, 0] < 2 / cells, 2]
        heights.append((connected_end(at_wall, 1 / cells) + 0.25 / cells) / 2)
    later = [math.sqrt(2) * time for time in HEIGHTS]
    return (
        *np.interp([time for time, _ in INVISCID], times, fronts).tolist(),
        *mean_speeds(times, np.array(fronts)),
        *np.interp(later, times, heights).tolist(),
    )


EXPERIMENT = Experiment(
    name="dam-break",
    title="Dam break: a column of water twice as high as wide",
    source="Martin and Moyce 1952: columns that are 1.125 and 2.25 inch wide (as digitised by "
    "PySPH), and tables 2 and 6 (as published with Ocellaris); the inviscid front is from a "
    "separate two-dimensional computation with 128 cells across the column",
    measured="A projected liquid in a smooth channel. The experiment measures the position Z of "
    "the front divided by the column's width a at dimensionless times T = t √(2g/a), the front's "
    "mean speed dZ/dT between two positions and between two times, and the height of the water "
    "at the wall divided by the initial height at times T/√2. The front is at the first gap "
    "wider than a cell.",
    band="inviscid front: ±3 %; speeds: from the lowest to the highest of the three data sets, "
    "widened by 2 %, since positions were read to within 0.02; heights: ±0.02, since the table's "
    "heights have steps of 0.05 to 0.06. The front's positions are not compared with the "
    "experiment. There, the gate and the friction of the floor delay the water: at each time, its "
    "front has travelled 9 to 20 % less. A delay of T = 0.25 explains this to within 2 %. The "
    "speeds of the front are therefore compared; they agree best between two positions",
    published=publish,
    run=lambda cells: release(cells, 0.0),
    control=lambda cells: release(cells, PASTE),
    mistake="a paste of 630 Pa s in a column of 1 m instead of water",
    grids=(16, 24, 36),
    across="the column's width",
    quick=True,
    seconds=20,
)
