"""Repair: who is reset to its rest shape, who is not, and how they are counted."""

import numpy as np
import pytest

from phy124.materials import NeoHookean, Sand
from phy124.mpm.repair import MAX_TOTAL, SOUND_F
from phy124.studies.validation.bodies import block, make_solver

IMPOSSIBLE = {
    "not finite": np.full((3, 3), np.nan),
    "without volume": np.diag([1, 1, 1e-7]),
    "torn apart": np.diag([2 * SOUND_F, 1, 1]),
    "inside out beyond repair": np.diag([-1e-9, 1, 1]),
}


def broken(law, **deformations):
    """A solver before its first frame; particle -> its deformation gradient."""
    x = block(middle=(0, 0, 0.24))
    made = make_solver(x, np.full(len(x), 1e-4), [law], dx=0.125, precision="float64")
    F = made.state.F.numpy()
    for index, gradient in deformations.items():
        F[int(index[1:])] = gradient
    made.state.F.assign(F)
    return made


@pytest.mark.parametrize("gradient", IMPOSSIBLE.values(), ids=IMPOSSIBLE.keys())
def test_unusable_deformation_is_reset_and_counted(gradient):
    solver = broken(NeoHookean(E=1e4), p30=gradient, p12=gradient)
    solver.repair.begin(solver.clock)
    assert (solver.repair.count, solver.repair.first) == (2, 12)
    np.testing.assert_array_equal(solver.state.F.numpy()[[12, 30]], [np.eye(3)] * 2)
    assert not solver.state.C.numpy()[[12, 30]].any()


def test_a_large_but_sound_deformation_is_left_alone():
    stretched = np.diag([3.0, 0.5, 0.8])
    solver = broken(NeoHookean(E=1e4), p5=stretched)
    solver.repair.begin(solver.clock)
    assert solver.repair.count == 0
    np.testing.assert_array_equal(solver.state.F.numpy()[5], stretched)


def test_the_visible_deformation_of_what_flows_is_bounded():
    solver = broken(Sand(E=1e4))
    total = solver.state.total.numpy()
    total[3] *= 10 * MAX_TOTAL
    solver.state.total.assign(total)
    solver.repair.begin(solver.clock)
    solver.repair.end()
    norms = np.linalg.norm(solver.state.total.numpy(), axis=(1, 2))
    assert norms.max() <= MAX_TOTAL * (1 + 1e-12)


def test_a_snapshot_brings_the_count_back():
    solver = broken(NeoHookean(E=1e4), p7=IMPOSSIBLE["not finite"])
    solver.repair.begin(solver.clock)
    other = broken(NeoHookean(E=1e4))
    other.repair.restore(solver.repair.snapshot())
    assert (other.repair.count, other.repair.first) == (1, 7)
