"""Experiment: a block between smooth plates, to measure Poisson's ratio and three moduli."""

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.lattice.solver import LatticeSolver
from phy124.materials import NeoHookean
from phy124.monitor.wrenches import Wrenches
from phy124.mpm import Model, Solver
from phy124.studies.validation.bodies import (
    fill_box,
    host,
    lattice,
    make_lattice_solver,
    measure_wall_force,
    mirrors,
)
from phy124.studies.validation.experiments.experiment import (
    Experiment,
    Quantity,
    Values,
    find_root,
    repeat_with_mpm,
)

E, NU, SIZE = 1e5, 0.3, 1.0
"""Young's modulus [Pa], Poisson's ratio and edge of the block [m]; an eighth is simulated."""
STRAIN = 0.01
PRESS, HOLD = 0.5, 1.0
"""Durations for which the plates move and then rest [s]."""


def stress(axial: float, lateral: float, nu: float = NU) -> tuple[float, float]:
    """Return the axial and the lateral Cauchy stress of a neo-Hookean block, divided by E.

    `axial` and `lateral` are stretches.
    """
    mu, lam = 1 / (2 * (1 + nu)), nu / ((1 + nu) * (1 - 2 * nu))
    J = axial * lateral**2
    bulk = lam * math.log(J)
    return (mu * (axial**2 - 1) + bulk) / J, (mu * (lateral**2 - 1) + bulk) / J


def publish() -> tuple[Quantity, ...]:
    """Return Poisson's ratio, and stress / (E * strain) in three cases."""
    axial = 1 - STRAIN
    free = find_root(lambda lateral: stress(axial, lateral)[1], 1.0, 1.02)
    return tuple(
        Quantity.within(name, value, 0.005)
        for name, value in (
            ("Poisson's ratio", (free - 1) / STRAIN),
            ("free sides: stress / E strain", -stress(axial, free)[0] / STRAIN),
            ("held sides: stress / E strain", -stress(axial, 1.0)[0] / STRAIN),
            ("hydrostatic: stress / E strain", -stress(axial, axial)[0] / STRAIN),
        )
    )


def press(cells: int, moving: int, fixed: int, nu: float) -> tuple[float, float]:
    """Simulate the block, and measure its stiffness and lateral strain.

    Args:
        cells: Cells across half the block.
        moving: Number of axes with moving plates, in the order z, y, x.
        fixed: Number of axes with fixed plates, which are the next axes in this order.
        nu: Poisson's ratio.

    Returns:
        The axial stress divided by the axial strain [Pa], and the negative ratio of the lateral
        strain to the axial strain.
    """
    dx = SIZE / 2 / cells
    solver = make_lattice_solver(
        fill_box((SIZE / 2,) * 3, dx),
        dx,
        NeoHookean(E=E, nu=nu, damping=200.0),
        boundaries=[*_plates(moving, fixed), *mirrors(0, 1, 2)],
        threads=1,
    )
    force = measure_wall_force(solver, PRESS + HOLD / 2, PRESS + HOLD)
    return _stiffness(solver, abs(float(force[2])))


def press_particles(cells: int, moving: int, fixed: int, nu: float) -> tuple[float, float]:
    """Measure the values of `press` with MPM.

    Args:
        cells: Cells across half the block.
        moving: Number of axes with moving plates, in the order z, y, x.
        fixed: Number of axes with fixed plates, which are the next axes in this order.
        nu: Poisson's ratio.
    """
    dx = SIZE / 2 / cells
    x = lattice((2 * cells,) * 3, dx / 2)
    volume, rubber = np.full(len(x), (dx / 2) ** 3), NeoHookean(E=E, nu=nu, damping=200.0)
    model = Model.of(x, volume, [rubber], dx=dx, origin=(-0.75 * dx,) * 3)
    return _stiffness(*hold_plates(model, _plates(moving, fixed), PRESS, HOLD))


def _stiffness(solver: Solver | LatticeSolver, force: float) -> tuple[float, float]:
    rest, end = solver.model.rest, host(solver.state.x)
    slopes = [1 - np.polyfit(rest[:, axis], end[:, axis], 1)[0] for axis in range(3)]
    area = (SIZE / 2) ** 2 * (1 - slopes[0]) * (1 - slopes[1])
    return float(force / area / slopes[2]), float(-slopes[0] / slopes[2])


def measure(
    cells: int, *, nu: float = NU, simulate: Callable[..., tuple[float, float]] = press
) -> Values:
    """Measure the values of `publish`."""
    free, ratio = simulate(cells, 1, 0, nu)
    confined, bulk = simulate(cells, 1, 2, nu)[0], simulate(cells, 3, 0, nu)[0]
    return ratio, free / E, confined / E, bulk / E


def hold_plates(
    model: Model, plates: Sequence[HalfSpace], moving: float, resting: float
) -> tuple[Solver, float]:
    """Simulate a body with MPM between plates and three symmetry planes through the origin.

    Args:
        model: The body.
        plates: The plates.
        moving: Time in which the plates move [s].
        resting: Time in which the plates then rest [s].

    Returns:
        The solver, and the first plate's mean force along z [N] in the second half of `resting`.
    """
    wrenches = Wrenches()
    walls = [*plates, *mirrors(0, 1, 2)]
    measured = wrenches.wrap_walls(walls, walls)
    solver = Solver(model, boundaries=measured, accumulators=[wrenches], threads=1)
    solver.advance(moving + resting / 2)
    wrenches.before_attempt()
    solver.advance(moving + resting)
    return solver, abs(float(wrenches.contacts(solver, 2 / resting)["half_space"].force[2]))


def _plates(moving: int, fixed: int) -> list[HalfSpace]:
    return [_plate(axis, moves=n < moving) for n, axis in enumerate((2, 1, 0)[: moving + fixed])]


def _plate(axis: int, *, moves: bool) -> HalfSpace:
    normal = -np.eye(3)[axis]
    low = tuple((STRAIN * SIZE / 2 * normal).tolist())
    path = Path(times=(0.0, PRESS), points=((0.0, 0.0, 0.0), low)) if moves else None
    point = tuple((-SIZE / 2 * normal).tolist())
    return HalfSpace(point=point, normal=tuple(normal.tolist()), friction=0.0, motion=path)


EXPERIMENT = Experiment(
    name="pressed-block",
    title="Pressed block: Poisson's ratio and bulk response",
    source="the neo-Hookean law in closed form; for small strain, it gives Poisson's ratio ν and "
    "the three moduli E, E(1−ν)/(1+ν)(1−2ν) and E/(1−2ν)",
    measured="A block between smooth plates is compressed by 1 % in three ways: with free sides, "
    "with laterally confined sides, and hydrostatically. Strains are measured from the particles, "
    "and forces from the impulses of a plate.",
    band="±0.5 %",
    published=publish,
    run=measure,
    control=partial(measure, nu=NU + 0.03),
    mistake=f"Poisson's ratio is {NU + 0.03:g} instead of {NU:g}",
    grids=(4, 6, 8),
    across="half the block",
    quick=True,
    seconds=10,
)
MPM = repeat_with_mpm(
    EXPERIMENT,
    partial(measure, simulate=press_particles),
    partial(measure, nu=NU + 0.03, simulate=press_particles),
    seconds=10,
)
