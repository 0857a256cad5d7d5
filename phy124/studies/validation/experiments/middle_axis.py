"""Experiment: the intermediate axis theorem.

A free rigid body that spins about its axis of intermediate inertia flips repeatedly.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from phy124.materials import Rigid
from phy124.mpm import Model, Solver, State
from phy124.studies.validation.accuracy.problems import angular_momentum
from phy124.studies.validation.bodies import lattice
from phy124.studies.validation.experiments.experiment import Experiment, Quantity, Values

EDGES = (0.6, 0.4, 0.2)
"""Edge lengths of the body [m]; the second edge is along the axis of intermediate inertia."""
SPIN = (1.0, 6.0, 0.0)
"""Initial angular velocity [rad/s]."""
DURATION = 4.0
"""Duration of a run [s]."""
SAMPLES = 300


def moments(edges: Sequence[float]) -> NDArray[np.float64]:
    """Return the moments of inertia [3] of a box of mass 12 about its centre."""
    squares = np.array(edges) ** 2
    return squares.sum() - squares


def find_turns(times: NDArray, spins: NDArray) -> Values:
    """Return the times of the first two flips [s].

    At a flip, the spin about the axis of intermediate inertia is zero.

    Args:
        times: Times of the samples [T], s.
        spins: Angular velocities about the body's axis of intermediate inertia [T], rad/s.

    Returns:
        Two times; NaN for a flip that does not occur.
    """
    after = np.flatnonzero(np.diff(np.sign(spins)) != 0)[:2]
    parts = spins[after] / (spins[after] - spins[after + 1])
    turns = times[after] + parts * (times[after + 1] - times[after])
    return (*turns.tolist(), *[float("nan")] * (2 - len(turns)))


def exact() -> Values:
    """Return the times of the first two flips according to Euler's equations [s]."""
    from scipy.integrate import solve_ivp

    a, b, c = moments(EDGES)

    def rates(time: float, w: list[float]) -> list[float]:
        del time
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
    """Simulate the body, and measure its flips and the conservation of energy and momentum.

    Args:
        cells: Cells across the shortest edge.
        edges: Edges of the body [m].

    Returns:
        The times of two flips [s], and the remaining fractions of kinetic energy and angular
        momentum.
    """
    dx = EDGES[2] / cells
    counts = [round(2 * edge / dx) for edge in edges]
    x = lattice(counts, dx / 2, [-n * dx / 4 for n in counts])
    wx, wy, wz = SPIN
    C = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    body = Rigid(nu=0.3, speed=2.0, strain=0.02)
    model = Model.of(x, np.full(len(x), (dx / 2) ** 3), [body], dx=dx)
    state = State.of(model, x @ C.T, np.broadcast_to(C, (len(x), 3, 3)))
    solver = Solver(model, state, threads=1)
    first = angular_momentum(solver)
    times, spins, energies = np.linspace(0, DURATION, SAMPLES + 1)[1:], [], []
    for time in times:
        solver.advance(float(time))
        spin, energy = _spin(solver)
        spins.append(spin[1])
        energies.append(energy)
    kept = np.linalg.norm(angular_momentum(solver)) / np.linalg.norm(first)
    return (*find_turns(times, np.array(spins)), energies[-1] / energies[0], float(kept))


def _spin(solver: Solver) -> tuple[NDArray[np.float64], float]:
    """Return the angular velocity in the body's axes [3], rad/s, and twice the rotational energy.

    The energy is computed for unit masses, since only ratios of energies are used.
    """
    x, v = (a.numpy().astype(float) for a in (solver.state.x, solver.state.v))
    x, v, rest = x - x.mean(axis=0), v - v.mean(axis=0), solver.model.rest
    u, _, vt = np.linalg.svd(x.T @ rest)
    turn = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    inertia = (x**2).sum() * np.eye(3) - x.T @ x
    momentum = np.cross(x, v).sum(axis=0)
    omega = np.linalg.solve(inertia, momentum)
    return turn.T @ omega, float(omega @ momentum)


def run(cells: int) -> Values:
    """Measure the correct body."""
    return tumble(cells, EDGES)


def control(cells: int) -> Values:
    """Control: measure a body whose second edge is a quarter longer."""
    return tumble(cells, (EDGES[0], 1.25 * EDGES[1], EDGES[2]))


EXPERIMENT = Experiment(
    name="middle-axis",
    title="Free spin about the middle axis",
    source="Euler's equations for a rigid body, integrated numerically",
    measured="A free `rigid` box of 0.6 × 0.4 × 0.2 m spins about its axis of intermediate inertia "
    "and flips repeatedly. The experiment measures the first two times at which the spin about "
    "that axis is zero, and the fractions of kinetic energy and angular momentum that remain "
    "after 4 s. The angular momentum includes the part that APIC stores in C.",
    band="±1 % in time; energy to 1 %, angular momentum to 0.01 %",
    published=publish,
    run=run,
    control=control,
    mistake="the middle edge is a quarter longer",
    grids=(3, 4, 5),
    across="the shortest edge",
    quick=True,
    seconds=25,
)
