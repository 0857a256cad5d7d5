"""Experiment: the collapse of a water column (Martin and Moyce 1952)."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.boundaries import Container
from phy124.schema.region import Region
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import connected_end, host, record
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.liquids import fill, solver_of

Line = Sequence[float] | NDArray[np.float64]
INVISCID = ((1.2, 1.75), (1.6, 2.18), (2.0, 2.68), (2.5, 3.37), (3.0, 4.12))
"""Times `t sqrt(2 g / a)`, and positions of the front of an inviscid liquid divided by the column
width `a`; there is no gate.

The values are from a separate two-dimensional solver (APIC, pressure projection with a ghost-fluid
surface, 128 cells across a). With 64 cells, the positions are at most 0.01 smaller.
"""
HEIGHTS = (1.28, 2.0, 2.7)
"""Dimensionless times t sqrt(g / a) of the heights at the wall."""
PASSAGE = (1.5, 3.5)
"""Positions of the front, in units of `a`, between which its mean speed is measured.

If the start is delayed, this speed does not change.
"""
PERIOD = (1.2, 3.0)
"""Dimensionless times t sqrt(2 g / a) between which the front's mean speed is measured."""
FRONTS = (
    ((0.832, 1.219, 1.997, 2.547, 3.345, 4.034), (1.217, 1.474, 2.292, 2.995, 4.134, 4.944)),
    ((0.849, 1.212, 1.602, 2.283, 2.950, 3.598), (1.245, 1.443, 1.884, 2.689, 3.728, 4.528)),
    (
        (0.84, 1.19, 1.43, 1.63, 1.83, 1.98, 2.20, 2.32, 2.51, 2.65, 2.83, 2.98, 3.11, 3.33),
        (1.22, 1.44, 1.67, 1.89, 2.11, 2.33, 2.56, 2.78, 3.00, 3.22, 3.44, 3.67, 3.89, 4.11),
    ),
)
"""Times, and positions of the front in units of `a`, for columns of the height 2 a.

The first two entries are for columns of 2.25 and 1.125 inch, digitised by PySPH. The third entry is
table 2, as published with Ocellaris.
"""
HEIGHT_TABLE = (
    (0.56, 0.77, 0.93, 1.08, 1.28, 1.46, 1.66, 1.84, 2.00, 2.21, 2.45, 2.70, 3.06, 3.44),
    (0.94, 0.89, 0.83, 0.78, 0.72, 0.67, 0.61, 0.56, 0.50, 0.44, 0.39, 0.33, 0.28, 0.22),
)
"""Times t sqrt(g / a) and heights at the wall / initial height, from table 6 (see Ocellaris)."""
READ = 0.02
"""Maximum reading error of a height / initial height, and of a front's position / `a`."""
SAMPLE = 0.1
"""Sampling interval in dimensionless time t sqrt(2 g / a)."""
PASTE = 630.0
"""Viscosity in the control run [Pa s]; the Reynolds number a sqrt(2 g a) / nu is 7."""


def mean_speeds(time: Line, front: Line) -> tuple[float, float]:
    """Return the mean speeds dZ/dT between the positions `PASSAGE` and between the times `PERIOD`.

    The front is at the increasing positions Z = front / a at the times T = t sqrt(2 g / a).
    """
    start, end = np.interp(PASSAGE, front, time)
    low, high = np.interp(PERIOD, time, front)
    return (
        float((PASSAGE[1] - PASSAGE[0]) / (end - start)),
        float((high - low) / (PERIOD[1] - PERIOD[0])),
    )


def publish() -> tuple[Quantity, ...]:
    """Return the inviscid front, and the measured speeds and heights."""
    names = (
        f"speed from Z = {PASSAGE[0]:g} to {PASSAGE[1]:g}",
        f"speed from T = {PERIOD[0]:g} to {PERIOD[1]:g}",
    )
    speeds = np.array([mean_speeds(*each) for each in FRONTS]).T
    off = 2 * READ / (PASSAGE[1] - PASSAGE[0])
    heights = np.interp(HEIGHTS, *HEIGHT_TABLE).tolist()
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
    """Simulate the collapse of a column, 1 m wide and 2 m high, in a smooth channel.

    There are `cells` cells across the width. The viscosity is dynamic [Pa s].
    """
    width, unit = 2 / cells, math.sqrt(1 / (2 * GRAVITY))
    x = fill((1, width, 2), cells)
    channel = Container(inside=Region(lower=(0, 0, 0), upper=(9, width, 9)), contact="slip")
    solver = solver_of(x, np.zeros_like(x), cells, [channel], GRAVITY, viscosity)

    def measure() -> tuple[float, float]:
        x = host(solver.state.x)
        ends = x[:, 0], x[x[:, 0] < 2 / cells, 2]
        front, height = (connected_end(end, 1 / cells) + 0.25 / cells for end in ends)
        return front, height / 2

    times = SAMPLE * np.arange(1.0, 1 + math.ceil(math.sqrt(2) * HEIGHTS[-1] / SAMPLE))
    fronts, heights = record(solver, times * unit, measure).T
    return (
        *np.interp([time for time, _ in INVISCID], times, fronts).tolist(),
        *mean_speeds(times, fronts),
        *np.interp(math.sqrt(2) * np.array(HEIGHTS), times, heights).tolist(),
    )


EXPERIMENT = Experiment(
    name="dam-break",
    title="Dam break: a column of water twice as high as wide",
    source="Martin and Moyce 1952: columns of water 1.125 and 2.25 inches wide (their plots as "
    "digitised by PySPH, and their tables 2 and 6 as published with Ocellaris); the inviscid front "
    "is from a separate two-dimensional computation with 128 cells across the column",
    measured="A projected liquid flows in a smooth channel. The experiment measures the "
    "position Z of the front, divided by the column's width a, at dimensionless times T = t "
    "√(2g/a). The front is at the first gap in the liquid that is wider than a cell. The "
    "front's mean speed dZ/dT is measured twice, between two positions and between two times. The "
    "height of the water at the wall is divided by the initial height, and measured at T/√2.",
    band="inviscid front: ±3 %; speeds: from the lowest to the highest of the three data sets, "
    "widened by 2 %, since positions were read to within 0.02; heights: ±0.02, since the table's "
    "heights have steps of 0.05 to 0.06. The front's positions are not compared with the "
    "experiment. In the experiment, the gate and the friction of the floor delay the water. At "
    "each time, the front of the experiment has travelled 9 to 20 % less than the simulated "
    "front. A delay of T = 0.25 explains this difference to within 2 %. Instead of the positions, "
    "the speeds of the front are therefore compared. The agreement is best for speeds between two "
    "positions",
    published=publish,
    run=lambda cells: release(cells, 0.0),
    control=lambda cells: release(cells, PASTE),
    mistake="a paste of 630 Pa s in a column of 1 m instead of water",
    grids=(16, 24, 36),
    across="the column's width",
    quick=True,
    seconds=20,
)
