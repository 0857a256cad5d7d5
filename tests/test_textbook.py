"""The solver moves as a straightforward program does that was written from the papers."""

import numpy as np
import pytest

from phy124.boundaries import Held
from phy124.forces import Gravity
from phy124.materials import FixedCorotated
from phy124.studies.validation.bodies import make_solver
from reference.textbook import Textbook


class AtNodes(Held):
    """Holds every node inside by itself, as the program of the papers does."""

    def at_surface(self, dx):
        return False

    def response(self):
        return "sticky"


CELLS, DT, STEPS, COUNT = 24, 1e-3, 300, 2000
VOLUME = 0.7**3 / COUNT


@pytest.fixture(scope="module")
def start():
    """Particles of a cube above the floor [P,3], m."""
    return np.random.default_rng(0).random((COUNT, 3)) * 0.7 + [0.65, 0.65, 0.57]


@pytest.fixture(scope="module")
def twin(start):
    """The straightforward program after all its steps."""
    made = Textbook(start, VOLUME, cells=CELLS, size=2, E=2e4, nu=0.3, density=200, floor=0.52)
    for _ in range(STEPS):
        made.step(DT)
    return made


@pytest.mark.parametrize("simd", [False, True])
def test_solver_against_a_straightforward_program(start, twin, simd):
    solver = make_solver(
        start,
        np.full(COUNT, VOLUME),
        [FixedCorotated(E=2e4, nu=0.3, density=200)],
        dx=2 / CELLS,
        forces=[Gravity()],
        boundaries=[AtNodes(lower=(-9, -9, -9), upper=(9, 9, 0.52))],
        precision="float32" if simd else "float64",
        simd=simd,
        ceiling=DT,
    )
    solver.advance(STEPS * DT)
    assert solver.clock.substeps == STEPS and solver.clock.limiters == {"user": STEPS}
    moved = np.linalg.norm(solver.state.x.numpy() - start, axis=1)
    apart = np.linalg.norm(solver.state.x.numpy() - twin.x.numpy(), axis=1)
    assert moved.max() > 0.03, "it has fallen on the floor"
    assert apart.max() < 2e-4
    np.testing.assert_allclose(solver.state.F.numpy(), twin.F.numpy(), atol=5e-3)
