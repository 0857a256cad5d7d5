"""Experiment: a copper bar that hits a rigid wall (the Taylor bar of Wilkins and Guinan)."""

import numpy as np

from phy124.boundaries import Ground
from phy124.materials import Metal
from phy124.studies.validation.accuracy.problems import FLOOR_NODE
from phy124.studies.validation.bodies import host, lattice, make_solver, mirrors
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values

LENGTH, RADIUS = 32.4e-3, 3.2e-3
"""Size of the bar [m]."""
SPEED, DURATION = 227.0, 80e-6
"""Initial speed [m/s], and duration [s]."""
COPPER = Metal(E=117e9, nu=0.35, density=8930, yield_stress=400e6, hardening=100e6)


def publish() -> tuple[Quantity, ...]:
    """Return the published length of the bar and radius of its impact face [mm]."""
    return (Quantity("length", 21.43, 21.42, 21.48), Quantity("radius", 7.22, 7.11, 7.24))


def strike(cells: int, copper: Metal) -> Values:
    """Simulate a quarter of the bar, with `cells` cells across its radius.

    Return the final length and the final radius of the impact face [mm].
    """
    dx = RADIUS / cells
    count = round(2 * LENGTH / dx)
    x = lattice((2 * cells, 2 * cells, count), dx / 2) * [1, 1, LENGTH / (count * dx / 2)]
    x = x[np.hypot(x[:, 0], x[:, 1]) < RADIUS]
    volume = np.pi / 4 * RADIUS**2 * LENGTH / len(x)
    world = {
        "origin": (-FLOOR_NODE * dx,) * 3,
        "boundaries": [Ground(friction=0.0), *mirrors(0, 1)],
    }
    v = np.tile([0, 0, -SPEED], (len(x), 1))
    solver = make_solver(x, volume, [copper], v=v, dx=dx, threads=1, **world)
    solver.advance(DURATION)
    end, F = host(solver.state.x), host(solver.state.deformation)
    # The volume of a particle is a deformed cube around its centre.
    half = dx / 4
    last = x[:, 2] > LENGTH - 0.4 * dx
    length = end[last, 2].mean() + half
    face = (end[:, 2] < dx) & (np.hypot(end[:, 0], end[:, 1]) > RADIUS)
    out = np.hypot(end[:, 0], end[:, 1])
    direction = end[:, :2] / np.maximum(out, 1e-12)[:, None]
    stretch = np.linalg.norm(np.einsum("pi,pij->pj", direction, F[:, :2]), axis=1)
    rim = np.sort((out + half * stretch)[face])
    return 1e3 * float(length), 1e3 * float(rim[-max(1, len(rim) // 50) :].mean())


EXPERIMENT = Experiment(
    name="taylor-bar",
    title="Taylor bar: copper at 227 m/s against a rigid wall",
    source="radii of Foulk et al. 2021 (7.22 mm), Simo 1992 (7.12 mm) and Zienkiewicz et al. "
    "1998 (7.11 mm); lengths from the codes Sierra/SM and Carina (21.42 to 21.48 mm), as "
    "published with Carina's benchmark",
    measured="The experiment measures the length of the bar and the radius of its impact face, 80 "
    "µs after the impact. A quarter of the bar is simulated between two symmetry planes, without "
    "friction.",
    band="between the lowest and the highest published value",
    published=publish,
    run=lambda cells: strike(cells, COPPER),
    control=lambda cells: strike(cells, COPPER.model_copy(update={"yield_stress": 300e6})),
    mistake="a yield stress of 300 MPa instead of 400",
    grids=(4, 6, 8),
    across="the radius",
    unit="mm",
    quick=True,
    seconds=28,
)
