"""Experiment: a body that spins about its axis of intermediate inertia flips repeatedly."""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from phy124.lattice.solver import LatticeSolver
from phy124.materials import Rigid
from phy124.mpm import Solver
from phy124.studies.validation.accuracy.problems import angular_momentum
from phy124.studies.validation.bodies import (
    fill_box,
    find_zeros,
    host,
    lattice,
    make_lattice_solver,
    make_solver,
    record,
    turning,
)
from phy124.studies.validation.experiments.experiment import (
    Experiment,
    Quantity,
    Values,
    repeat_with_mpm,
)

EDGES = (0.6, 0.4, 0.2)
"""Edges of the body [m]; the second is along the axis of intermediate inertia."""
SPIN = (1.0, 6.0, 0.0)
"""Initial angular velocity [rad/s]."""
LONGER = (EDGES[0], 1.25 * EDGES[1], EDGES[2])
"""Edges of the control's body [m]."""
BODY = Rigid(nu=0.3, speed=2.0, strain=0.02)
DURATION = 4.0
SAMPLES = 300


def moments(edges: Sequence[float]) -> NDArray[np.float64]:
    """Return the moments of inertia [3] about the centre of a box with the mass 12."""
    squares = np.array(edges) ** 2
    return squares.sum() - squares


def find_turns(times: NDArray, spins: NDArray) -> Values:
    """Return the times of the first two flips [s]; infinity for a flip that does not occur.

    At a flip, the spin about the axis of intermediate inertia is zero. The spins [T] are sampled at
    `times` [T], s.
    """
    turns = find_zeros(times, spins)[:2]
    return (*turns.tolist(), *[math.inf] * (2 - len(turns)))


def exact() -> Values:
    """Return the times of the first two flips by Euler's equations [s]."""
    from scipy.integrate import solve_ivp

    a, b, c = moments(EDGES)

    def rates(time: float, w: list[float]) -> list[float]:
        return [(b - c) / a * w[1] * w[2], (c - a) / b * w[2] * w[0], (a - b) / c * w[0] * w[1]]

    times = np.linspace(0, DURATION, 20 * SAMPLES)
    w = solve_ivp(rates, (0, DURATION), SPIN, t_eval=times, rtol=1e-10, atol=1e-12).y
    return find_turns(times, w[1])


def publish() -> tuple[Quantity, ...]:
    """Return the times of the flips, and the remaining fractions of energy and angular momentum."""
    first, second = exact()
    return (
        Quantity.within("first turn [s]", first, 0.01),
        Quantity.within("second turn [s]", second, 0.01),
        Quantity("kinetic energy kept", 1.0, 0.99, 1.0),
        Quantity("angular momentum kept", 1.0, 0.9999, 1.0001),
    )


def tumble(cells: int, edges: Sequence[float]) -> Values:
    """Simulate a body with the edges `edges` [m]; a cell is `EDGES[2] / cells` wide."""
    dx = EDGES[2] / cells
    box = fill_box(edges, dx, centred=True)
    return _observe(make_lattice_solver(box, dx, BODY, spin=SPIN, threads=1))


def tumble_particles(cells: int, edges: Sequence[float]) -> Values:
    """Simulate the body of `tumble` with MPM."""
    dx = EDGES[2] / cells
    counts = [round(2 * edge / dx) for edge in edges]
    x = lattice(counts, dx / 2, [-n * dx / 4 for n in counts])
    motion = turning(x, SPIN)
    return _observe(make_solver(x, (dx / 2) ** 3, [BODY], dx=dx, threads=1, **motion))


def _observe(solver: Solver | LatticeSolver) -> Values:
    """Return the flips [s], and the remaining fractions of energy and angular momentum."""
    first = angular_momentum(solver)
    times = np.linspace(0, DURATION, SAMPLES + 1)[1:]
    spins, energies = record(solver, times, lambda: _spin(solver)).T
    kept = np.linalg.norm(angular_momentum(solver)) / np.linalg.norm(first)
    return (*find_turns(times, spins), float(energies[-1] / energies[0]), float(kept))


def _spin(solver: Solver | LatticeSolver) -> tuple[float, float]:
    """Return the spin about the middle axis [rad/s], and twice the kinetic energy for particles of
    mass 1.
    """
    x, v = host(solver.state.x), host(solver.state.v)
    x, v, rest = x - x.mean(axis=0), v - v.mean(axis=0), solver.model.rest
    u, _, vt = np.linalg.svd(x.T @ rest)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    inertia = (x**2).sum() * np.eye(3) - x.T @ x
    momentum = np.cross(x, v).sum(axis=0)
    omega = np.linalg.solve(inertia, momentum)
    return float(turn[:, 1] @ omega), float(omega @ momentum)


EXPERIMENT = Experiment(
    name="middle-axis",
    title="Free spin about the middle axis",
    source="Euler's equations for a rigid body, integrated numerically",
    measured="A free `rigid` box of 0.6 × 0.4 × 0.2 m spins about its axis of intermediate inertia "
    "and flips repeatedly. The experiment measures the first two times at which the spin about "
    "this middle axis is zero, and the fractions of kinetic energy and angular momentum that "
    "remain after 4 s. With MPM, the angular momentum includes the part that APIC stores in C.",
    band="±1 % for the times; within 1 % of the initial energy, and within 0.01 % of the initial "
    "angular momentum",
    published=publish,
    run=partial(tumble, edges=EDGES),
    control=partial(tumble, edges=LONGER),
    mistake="the middle edge is a quarter longer",
    grids=(3, 4, 5),
    across="the shortest edge",
    quick=True,
    seconds=25,
)
MPM = repeat_with_mpm(
    EXPERIMENT,
    partial(tumble_particles, edges=EDGES),
    partial(tumble_particles, edges=LONGER),
    seconds=25,
)
