"""The solver moves as a straightforward program does that was written from the papers."""

import numpy as np
import pytest

from phy124.boundaries import Held
from phy124.forces import Gravity
from phy124.materials import FixedCorotated
from reference.textbook import Textbook
from support.solvers import make_solver


class AtNodes(Held):
    """Holds every node inside by itself, as the program of the papers does."""

    def met(self, solver):
        return False

    def response(self):
        return "sticky"


@pytest.mark.parametrize("simd", [False, True])
def test_solver_against_a_straightforward_program(simd):
    cells, dt, steps = 24, 1e-3, 300
    x = np.random.default_rng(0).random((2000, 3)) * 0.7 + [0.65, 0.65, 0.57]
    volume = 0.7**3 / len(x)
    twin = Textbook(x, volume, cells=cells, size=2, E=2e4, nu=0.3, density=200, floor=0.52)
    solver = make_solver(
        x, np.full(len(x), volume), [FixedCorotated(E=2e4, nu=0.3, density=200)], dx=2 / cells,
        forces=[Gravity()], boundaries=[AtNodes(lower=(-9, -9, -9), upper=(9, 9, 0.52))], simd=simd,
        ceiling=dt,
    )  # fmt: skip
    for _ in range(steps):
        twin.step(dt)
    solver.advance(steps * dt)
    assert solver.clock.substeps == steps and solver.clock.limiters == {"user": steps}
    moved = np.linalg.norm(solver.state.x.numpy() - x, axis=1)
    apart = np.linalg.norm(solver.state.x.numpy() - twin.x.numpy(), axis=1)
    assert moved.max() > 0.03, "it has fallen on the floor"
    assert apart.max() < 2e-4
    np.testing.assert_allclose(solver.state.F.numpy(), twin.F.numpy(), atol=5e-3)
