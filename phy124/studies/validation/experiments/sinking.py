"""Experiment with a viscous column that sinks under its weight on a smooth floor."""

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.studies.validation.accuracy.problems import GRAVITY
from phy124.studies.validation.bodies import host
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values
from phy124.studies.validation.experiments.liquids import fill, solver_of

WIDTH, HEIGHT, VISCOSITY = 0.25, 0.5, 3000.0
"""Width and height of the column [m], and its dynamic viscosity [Pa s]; the density is 1000 kg/m^3.

Inertia then delays the motion by about 0.01 s.
"""
DURATION = 1.0
"""Duration [s]; in this time, the lowest material becomes 0.65 times as high."""


def sink(cells: int, viscosity: float) -> Values:
    """Let a column sink, with `cells` cells across its width.

    Return the loss of height of the centre of mass, relative to its initial height; and the force
    on the floor in the second half of the time, relative to the weight. The viscosity is dynamic
    [Pa s].
    """
    fine = round(cells / WIDTH)
    x = fill((WIDTH, WIDTH, HEIGHT), fine)
    floor = HalfSpace(point=(0, 0, 0), normal=(0, 0, 1), contact="slip")
    solver = solver_of(x, np.zeros_like(x), fine, [floor], GRAVITY, viscosity)
    solver.advance(DURATION / 2)
    impulse = float(solver.impulses.wrench("wall_0").numpy()[2])
    solver.advance(DURATION)
    impulse = float(solver.impulses.wrench("wall_0").numpy()[2]) - impulse
    weight = solver.model.total_mass * GRAVITY
    height = float(host(solver.state.x)[:, 2].mean())
    return 1 - 2 * height / HEIGHT, impulse / (weight * DURATION / 2)


def exact_loss() -> float:
    """Return the loss of height of a slender column without inertia.

    A slice at the distance s from the top carries the weight above it. Its stress is 3 eta times
    its rate of strain, and its cross-section grows. Its stretch is therefore 1 / (1 + c s t), with
    c = rho g / (3 eta).
    """
    s = (np.arange(1000) + 0.5) / 1000
    stretch = 1 / (1 + 1000 * GRAVITY * HEIGHT / (3 * VISCOSITY) * DURATION * s)
    heights = stretch.sum() - stretch.cumsum() + stretch / 2
    return float(1 - 2 * heights.mean() / 1000)


EXPERIMENT = Experiment(
    name="sinking",
    title="A viscous column sinks on a smooth floor",
    source="Trouton 1906: a column resists stretching with 3 η; each slice bears the weight above "
    "it",
    measured="A column with a viscosity of 3000 Pa s is twice as high as it is wide, and sinks for "
    "1 s. The experiment measures the descent of the centre of mass, relative to its initial "
    "height, and the force on the floor in the second half of the time, relative to the weight.",
    band="±5 %; the theory neglects inertia and the shear stress between slices",
    published=lambda: (
        Quantity.within("loss of height", exact_loss(), 0.05),
        Quantity.within("force / weight", 1.0, 0.05),
    ),
    run=lambda cells: sink(cells, VISCOSITY),
    control=lambda cells: sink(cells, VISCOSITY / 1.5),
    mistake="a column that resists with 2 η",
    grids=(6, 8, 12),
    across="the column's width",
    quick=True,
    seconds=20,
)
