"""Diagnostics: sums and extremes of a state, against the same sums in numpy."""

import numpy as np
import pytest

from phy124.materials import Hencky, NeoHookean
from phy124.monitor.diagnostics import compute_energies, compute_speeds, diagnose
from phy124.studies.validation.bodies import block, make_solver

DX = 0.125


@pytest.fixture
def solver(rng):
    """A block of two laws, stretched and moving at random."""
    x = block(middle=(0.1, 0.2, 0.3))
    made = make_solver(
        x,
        rng.uniform(1e-5, 1e-4, len(x)),
        [NeoHookean(E=1e4), Hencky(E=2e4)],
        dx=DX,
        v=rng.normal(size=x.shape),
        C=rng.normal(size=(len(x), 3, 3)),
        precision="float64",
        material=np.arange(len(x)) // (len(x) // 2),
    )
    made.state.F.assign(np.eye(3) + 0.1 * rng.normal(size=(len(x), 3, 3)))
    return made


def test_momentum_kinetic_energy_and_extremes_are_those_of_numpy(solver):
    result = diagnose(solver)
    m, x, v = solver.model.mass.numpy(), solver.state.x.numpy(), solver.state.v.numpy()
    C, J = solver.state.C.numpy(), np.linalg.det(solver.state.F.numpy())
    np.testing.assert_allclose(result.momentum, m @ v)
    np.testing.assert_allclose(result.middle, m @ x)
    # APIC (Jiang et al. 2015): C holds energy and angular momentum, too, with D = dx^2/4.
    axial = np.stack([C[:, 2, 1] - C[:, 1, 2], C[:, 0, 2] - C[:, 2, 0], C[:, 1, 0] - C[:, 0, 1]], 1)
    np.testing.assert_allclose(result.angular, m @ (np.cross(x, v) + DX**2 / 4 * axial))
    kinetic = m / 2 * ((v**2).sum(axis=1) + DX**2 / 4 * (C**2).sum(axis=(1, 2)))
    assert result.kinetic == pytest.approx(kinetic.sum())
    assert (result.min_J, result.max_J) == pytest.approx((J.min(), J.max()))
    assert result.broken == result.inverted == 0


def test_energies_of_particles_add_up_and_speeds_are_norms(solver):
    result, each = diagnose(solver), compute_energies(solver.model, solver.state)
    assert each.sum() == pytest.approx(result.kinetic + result.elastic)
    np.testing.assert_allclose(
        compute_speeds(solver.state), np.linalg.norm(solver.state.v.numpy(), axis=1)
    )


def test_unsound_particles_are_counted_and_the_first_is_named(solver):
    F = solver.state.F.numpy()
    F[[7, 5]] = np.diag([-1.0, 1, 1])
    F[[11, 13, 20], 0, 0] = np.nan
    solver.state.F.assign(F)
    result = diagnose(solver)
    assert (result.broken, result.inverted) == (3, 2)
    # Particles are sorted by law; the numbers are those of the solver.
    assert (result.first_broken, result.first_inverted) == (11, 5)
    assert np.isinf(compute_energies(solver.model, solver.state)).sum() == 3
