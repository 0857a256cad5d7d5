"""Viscosity of elastic laws: the stress, a bar of known decay, stability at the limit."""

import math

import numpy as np
import pytest

from phy124.materials import FixedCorotated, Hencky, NeoHookean, Rigid
from phy124.monitor.diagnostics import diagnose
from phy124.scene import Scene
from phy124.studies.validation.bodies import block, make_solver
from reference.material_point import deformations, evaluate, name, rotations, transposed

ETA = 7.0
LAWS = [law(damping=ETA) for law in (NeoHookean, FixedCorotated, Hencky)]


@pytest.mark.parametrize("material", LAWS, ids=name)
def test_friction_is_newtonian_beside_the_elastic_stress(material, rng):
    F, C = deformations(rng, 0.3), 50 * rng.standard_normal((300, 3, 3))
    plain = material.model_copy(update={"damping": 0.0})
    more = evaluate(material, F, C=C).stress - evaluate(plain, F).stress
    J = np.minimum(np.linalg.det(F), 1)[:, None, None]
    assert np.allclose(more, J * ETA * (C + transposed(C)), rtol=1e-9, atol=1e-7)
    assert ((more * C).sum(axis=(1, 2)) >= 0).all(), "it takes energy whatever the motion"


@pytest.mark.parametrize("material", LAWS, ids=name)
def test_turning_rubs_nothing_and_friction_turns_with_the_body(material, rng):
    F, C, Q = deformations(rng, 0.2), rng.standard_normal((300, 3, 3)), rotations(rng, 300)
    still = evaluate(material, F).stress
    spin = evaluate(material, F, C=C - transposed(C)).stress
    assert np.allclose(spin, still, rtol=1e-9, atol=1e-7)
    turned = evaluate(material, Q @ F, C=Q @ C @ transposed(Q)).stress
    here = Q @ evaluate(material, F, C=C).stress @ transposed(Q)
    assert np.allclose(turned, here, rtol=1e-8, atol=1e-6)


def test_an_element_inside_out_has_none(rng):
    F = np.tile(np.diag([1.0, 1.0, -0.5]), (5, 1, 1))
    C = rng.standard_normal((5, 3, 3))
    assert np.array_equal(evaluate(LAWS[0], F, C=C).stress, evaluate(LAWS[0], F).stress)


def test_without_friction_the_plain_law_runs():
    assert NeoHookean().device_law is NeoHookean.lossless
    assert NeoHookean().device_law.width == len(NeoHookean().theta()) == 2
    assert LAWS[0].device_law.width == len(LAWS[0].theta()) == 3
    assert "damping" not in Rigid.model_fields


def damped_bar(damping: float, *, cells: int = 24, particles_per_axis: int = 2) -> float:
    """Rate [1/s] at which the first mode of a free bar dies away, over its first period."""
    E, density = 1e4, 1000.0
    dx, wave, speed = 1 / cells, math.pi, math.sqrt(E / density)
    z = (np.arange(cells * particles_per_axis) + 0.5) * dx / particles_per_axis
    x, v, C = (np.zeros((len(z), *shape)) for shape in ((3,), (3,), (3, 3)))
    x[:, 2], v[:, 2] = z, 1e-6 * np.cos(wave * z)
    C[:, 2, 2] = -1e-6 * wave * np.sin(wave * z)
    material = NeoHookean(E=E, nu=0.0, density=density, damping=damping)
    volume = np.full(len(x), dx**3 / particles_per_axis)
    solver = make_solver(x, volume, [material], dx=dx, v=v, C=C, precision="float64")
    period = 2 / speed
    solver.advance(period)
    left = (np.cos(wave * z) * solver.state.v.numpy()[:, 2]).sum() / (np.cos(wave * z) ** 2).sum()
    return -math.log(left / 1e-6) / period


def test_a_bar_swings_as_a_damped_oscillator():
    """rho u'' = E u_zz + 2 eta u'_zz: the mode cos(k z) decays at k^2 eta / rho."""
    damping = 20.0
    grid = damped_bar(0.0)
    assert damped_bar(damping) - grid == pytest.approx(math.pi**2 * damping / 1000, rel=0.02)


@pytest.mark.parametrize("cfl", [0.6, 0.9])
@pytest.mark.parametrize("damping", [30.0, 3000.0])
def test_a_shaken_block_only_calms_down(damping, cfl, rng):
    """Substeps are as long as friction and stiffness together allow, and no energy appears."""
    x = block(10, 0.5)
    material = NeoHookean(E=2e4, damping=damping)
    v = rng.normal(scale=0.3, size=x.shape)
    solver = make_solver(x, np.full(len(x), 0.05**3), [material], dx=0.1, v=v, cfl=cfl)
    energies = [diagnose(solver).energy]
    for frame in range(1, 6):
        solver.advance(0.04 * frame)
        energies.append(diagnose(solver).energy)
    assert (np.diff(energies) <= 1e-3 * energies[0]).all()
    limiter = "elastic" if damping < 100 else "viscous"
    assert max(solver.clock.limiters, key=solver.clock.limiters.__getitem__) == limiter


def test_a_lone_particle_is_stable_beside_both_limits(rng):
    """The worst case: one particle, the boldest cfl, friction that alone would allow it."""
    dx, cfl = 0.1, 0.9
    speed = NeoHookean(E=2e4).wave_speed()
    fraction = 2 - 2 * cfl**2
    damping = 1.5 * fraction * 1000 * dx * speed / (8 * cfl)
    C = rng.normal(scale=0.01, size=(1, 3, 3))
    material = NeoHookean(E=2e4, damping=damping)
    solver = make_solver(
        np.zeros((1, 3)), np.full(1, dx**3), [material], dx=dx, C=C, cfl=cfl, precision="float64"
    )
    for look in range(1, 21):
        solver.advance(10 * look * cfl * dx / speed)
        F = solver.state.F.numpy()[0]
        assert np.abs(F.T @ F - np.eye(3)).max() < 1e-3


def test_a_scene_can_name_it():
    scene = Scene.model_validate({"material": {"law": "hencky", "damping": 12.0}})
    assert scene.material.device_law.name == "hencky_damped"
