"""Each law by itself: closed forms, yield surfaces, flow rules, what it remembers."""

from functools import cache

import numpy as np
import pytest
import warp as wp

from phy124 import Scene, Simulation, prepare
from phy124.kernels.build import kernel
from phy124.kernels.elastic import log_volume
from phy124.materials import (
    Elastic,
    FixedCorotated,
    Fluid,
    Foam,
    Hencky,
    Metal,
    NeoHookean,
    Plasticine,
    Rigid,
    Sand,
    Snow,
)
from phy124.studies.validation.bodies import make_solver
from reference.material_point import (
    EYE,
    PLASTIC,
    SOLIDS,
    deformations,
    deviator,
    evaluate,
    name,
    relative,
    transposed,
)
from reference.oracle import TWINS
from support.shapes import ball


@pytest.mark.parametrize("material", [m for m in SOLIDS if isinstance(m, Elastic)], ids=name)
def test_small_strains_obey_hooke(material, rng):
    """tau = 2 mu eps + lam tr(eps) I: E and nu mean what they say."""
    eps = 1e-5 * rng.standard_normal((50, 3, 3))
    eps = (eps + transposed(eps)) / 2
    mu, lam = material.lame
    trace = np.trace(eps, axis1=1, axis2=2)[:, None, None]
    expected = 2 * mu * eps + lam * trace * EYE
    assert relative(evaluate(material, EYE + eps).stress, expected, 0.0) < 1e-4


def test_uniaxial_stretch_closed_forms():
    s = np.array([0.3, 0.8, 1.2, 1.9])
    F = np.array([np.diag([v, 1, 1]) for v in s])
    mu, lam = NeoHookean().lame
    axial = evaluate(NeoHookean(), F).stress[:, 0, 0]
    np.testing.assert_allclose(axial, mu * (s**2 - 1) + lam * np.log(s), rtol=1e-12)
    axial = evaluate(FixedCorotated(), F).stress[:, 0, 0]
    np.testing.assert_allclose(axial, (2 * mu * (s - 1) + lam * (s - 1)) * s, rtol=1e-5)
    axial = evaluate(Hencky(), F).stress[:, 0, 0]
    np.testing.assert_allclose(axial, (2 * mu + lam) * np.log(s), rtol=1e-6)


def test_simple_shear_closed_forms():
    g = np.array([0.1, 0.4, 1.0])
    F = np.array([EYE + v * np.outer(EYE[0], EYE[1]) for v in g])
    mu, _ = NeoHookean().lame
    tau = evaluate(NeoHookean(), F).stress
    np.testing.assert_allclose(tau[:, 0, 1], mu * g, rtol=1e-12)
    np.testing.assert_allclose(tau[:, 0, 0] - tau[:, 1, 1], mu * g**2, rtol=1e-9)
    tau = evaluate(Hencky(), F).stress
    log = 2 * np.arcsinh(g / 2)
    np.testing.assert_allclose(tau[:, 0, 1], mu * log / np.cosh(log / 2), rtol=1e-6)


def test_hydrostatic_closed_forms():
    s = np.array([0.5, 0.9, 1.1, 2.0])
    F, J = s[:, None, None] * EYE, s**3
    mu, lam = Hencky().lame
    pressure = evaluate(NeoHookean(), F).stress[:, 0, 0]
    np.testing.assert_allclose(pressure, mu * (s**2 - 1) + lam * np.log(J), rtol=1e-12)
    pressure = evaluate(FixedCorotated(), F).stress[:, 0, 0]
    np.testing.assert_allclose(pressure, 2 * mu * (s - 1) * s + lam * J * (J - 1), rtol=1e-5)
    pressure = evaluate(Hencky(), F).stress[:, 0, 0]
    np.testing.assert_allclose(pressure, (2 * mu + 3 * lam) * np.log(s), rtol=1e-6)
    water = Fluid()
    pressure = -evaluate(water, F).stress[:, 0, 0] / J
    tait = water.bulk_modulus / water.gamma * (J**-water.gamma - 1)
    np.testing.assert_allclose(pressure[2:], tait[2:], rtol=1e-9)
    limit = evaluate(water, np.cbrt([[[0.8]]]) * EYE)
    wanted = -limit.stress[0, 0, 0] - limit.modulus[0] / 3 * np.log(J[:2] / 0.8)
    np.testing.assert_allclose(pressure[:2] * J[:2], wanted, rtol=1e-9)


@pytest.mark.parametrize("material", [m for m in PLASTIC if not isinstance(m, Foam)], ids=name)
def test_return_mapping_changes_nothing_the_second_time(material, rng):
    if isinstance(material, Metal):
        material = material.model_copy(update={"hardening": 0.0})
    if isinstance(material, Plasticine):
        material = material.model_copy(update={"softening": 0.0})
    first = evaluate(material, deformations(rng, 0.3))
    again = evaluate(material, first.F, h=first.history)
    np.testing.assert_allclose(again.F, first.F, atol=3e-7)
    np.testing.assert_allclose(again.history, first.history, atol=1e-6)


def test_metal_returns_to_its_yield_surface_and_keeps_its_volume(rng):
    material = Metal(hardening=5e4)
    F = deformations(rng, 0.3)
    after = evaluate(material, F)
    stress = evaluate(material, after.F, h=after.history).stress
    mises = np.sqrt(1.5) * np.linalg.norm(deviator(stress), axis=(1, 2))
    strain = np.sqrt(2 / 3) * after.history[:, 0]
    limit = material.yield_stress + material.hardening * strain
    np.testing.assert_allclose(mises, limit, rtol=1e-5)
    np.testing.assert_allclose(np.linalg.det(after.F), np.linalg.det(F), rtol=1e-6)
    elastic = EYE + 0.001 * (F - EYE)
    assert np.array_equal(evaluate(material, elastic).F, elastic)


@pytest.mark.parametrize("hardening", [0.0, 2e5])
def test_metal_sheared_slowly_follows_its_stress_strain_curve(hardening):
    """Simple shear: tau = mu g, then sigma_Y / sqrt(3) rising by the tangent modulus."""
    material = Metal(E=1e7, yield_stress=3e4, hardening=hardening)
    mu, _ = material.lame
    F, h, steps, g = EYE[None], np.zeros((1, 2)), 200, 0.02
    turn = EYE + g / steps * np.outer(EYE[0], EYE[1])
    for _ in range(steps):
        F, h = evaluate(material, turn @ F, h=h)[3:]
    shear = evaluate(material, F, h=h).stress[0, 0, 1]
    start = material.yield_stress / np.sqrt(3)
    tangent = mu * hardening / (3 * mu + hardening)
    assert shear == pytest.approx(start + tangent * (g - start / mu), rel=1e-3)


def test_plasticine_weakens_to_its_residual(rng):
    material = Plasticine(softening=2e3, residual=0.5)
    mu, F, h = material.lame[0], EYE[None], np.zeros((1, 2))
    turn = EYE + 0.05 * np.outer(EYE[0], EYE[1])
    strengths = []
    for _ in range(60):
        F, h = evaluate(material, turn @ F, h=h)[3:]
        strain = TWINS["hencky"].stress(F, F, h, np.array([mu, 0.0]))
        strengths.append(np.sqrt(1.5) * np.linalg.norm(deviator(strain)))
    worked = np.sqrt(2 / 3) * h[0, 0]
    assert strengths[-1] == pytest.approx(0.5 * material.yield_stress, rel=1e-5)
    assert worked > 0.5 * material.yield_stress / material.softening
    assert np.all(np.diff(strengths[2:]) < 1e-6 * material.yield_stress)


@pytest.mark.parametrize("E", [3e3, 6e3])
def test_faster_softening_than_unloading_drops_to_the_residual(E):
    """A stiffness profile lowers E, but neither yield stress nor softening."""
    material = Plasticine(yield_stress=500.0, softening=1e4).model_copy(update={"E": E})
    assert material.softening > 3 * material.lame[0]
    turn = EYE + np.outer(EYE[0], EYE[1])
    F, h = evaluate(material, turn[None])[3:]
    strain = TWINS["hencky"].stress(F, F, h, np.array([material.lame[0], 0.0]))
    strength = np.sqrt(1.5) * np.linalg.norm(deviator(strain))
    assert strength == pytest.approx(material.residual * material.yield_stress, rel=1e-5)
    assert h[0, 0] > 0.3


@pytest.mark.parametrize("index", [0.5, 1.0])
def test_foam_in_steady_shear_has_the_stated_stress(index):
    rate, dt, F, h = 2.0, 1e-3, EYE[None], np.zeros((1, 2))
    material = Foam(E=1e6, yield_stress=200.0, viscosity=50.0, flow_index=index)
    turn = EYE + dt * rate * np.outer(EYE[0], EYE[1])
    for _ in range(100):
        F, h = evaluate(material, turn @ F, h=h, dt=dt)[3:]
    excess = evaluate(material, F, h=h).stress[0, 0, 1] - material.yield_stress / np.sqrt(3)
    assert excess == pytest.approx(2 ** (-(1 + index) / 2) * 50.0 * rate**index, rel=1e-3)


def test_foam_relaxes_at_its_rate():
    """Bingham (n = 1): the excess decays as exp(-2 mu t / eta)."""
    material = Foam(flow_index=1.0, viscosity=1e3, yield_stress=100.0)
    mu = material.lame[0]
    F, h, dt, steps = (EYE + 0.02 * np.outer(EYE[0], EYE[1]))[None], np.zeros((1, 2)), 1e-5, 300
    limit = np.sqrt(2 / 3) * material.yield_stress
    size = [np.linalg.norm(deviator(evaluate(material, F).stress)) - limit]
    for _ in range(steps):
        F, h = evaluate(material, F, h=h, dt=dt)[3:]
    size.append(np.linalg.norm(deviator(evaluate(material, F).stress)) - limit)
    exact = np.exp(-2 * mu * dt * steps / material.viscosity)
    assert size[1] / size[0] == pytest.approx(exact, rel=0.001 + mu * dt / material.viscosity * 40)


def test_foam_flows_with_the_shear_rate_its_index_says():
    """Steady shear at rate g: excess = eta (g / sqrt 2)^n (norms of the deviators)."""
    for n in (0.4, 1.0):
        material = Foam(flow_index=n, viscosity=30.0, yield_stress=100.0)
        F, h, rate, dt = EYE[None], np.zeros((1, 2)), 5.0, 1e-4
        turn = EYE + rate * dt * np.outer(EYE[0], EYE[1])
        for _ in range(1000):
            F, h = evaluate(material, turn @ F, h=h, dt=dt)[3:]
        excess = np.linalg.norm(deviator(evaluate(material, F).stress))
        excess -= np.sqrt(2 / 3) * material.yield_stress
        assert excess == pytest.approx(material.viscosity * (rate / np.sqrt(2)) ** n, rel=0.01)


def test_foam_given_time_returns_to_its_yield_surface(rng):
    material = Foam(flow_index=1.0)
    after = evaluate(material, deformations(rng, 0.3), dt=1e9)
    mises = np.sqrt(1.5) * np.linalg.norm(deviator(evaluate(material, after.F).stress), axis=(1, 2))
    np.testing.assert_allclose(mises, material.yield_stress, rtol=1e-3)


def test_sand_carries_no_tension_and_only_its_fraction_of_shear(rng):
    material = Sand()
    mu, _, alpha = material.theta()
    after = evaluate(material, deformations(rng, 0.2))
    stress = evaluate(material, after.F, h=after.history).stress
    pressure = -np.trace(stress, axis1=1, axis2=2) / 3
    shear = np.linalg.norm(deviator(stress), axis=(1, 2))
    assert np.all(pressure > -1e-6 * mu)
    assert np.all(shear <= 3 * alpha * pressure + 1e-6 * mu)
    pulled = evaluate(material, (EYE + 0.1 * np.diag([1, 0, 0]))[None])
    assert np.abs(evaluate(material, pulled.F).stress).max() < 1e-6 * mu
    assert pulled.history[0, 0] == pytest.approx(np.log(1.1), rel=1e-6)


def test_sand_fails_at_its_friction_angle():
    """Triaxial compression: sigma_1 / sigma_3 = (1 + sin phi) / (1 - sin phi)."""
    material = Sand(friction_angle=30.0)
    F = np.diag(np.exp([-0.05, -0.002, -0.002]))[None]
    after = evaluate(material, F)
    principal = np.linalg.eigvalsh(evaluate(material, after.F).stress[0])
    assert principal[0] / principal[2] == pytest.approx(3.0, rel=1e-5)


def test_sand_that_was_loosened_must_close_before_it_presses():
    material = Sand()
    loose = evaluate(material, 1.02 * EYE[None])
    squeezed = evaluate(material, 0.99 * loose.F, h=loose.history)
    assert np.abs(evaluate(material, squeezed.F).stress).max() < 1e-3
    closed = evaluate(material, 0.97 * loose.F, h=loose.history)
    assert closed.history[0, 0] == 0
    assert np.log(np.linalg.det(closed.F[0])) == pytest.approx(3 * np.log(1.02 * 0.97), rel=1e-5)


def test_snow_clamps_stretches_and_remembers_the_volume():
    material = Snow()
    after = evaluate(material, np.diag([0.9, 1.0, 1.05])[None])
    np.testing.assert_allclose(np.diag(after.F[0]), [0.975, 1.0, 1.0075], rtol=1e-9)
    volume = 0.9 * 1.05 / (0.975 * 1.0075)
    assert after.history[0, 0] == pytest.approx(volume - 1, rel=1e-9)
    fresh = evaluate(material, after.F).stress
    packed = evaluate(material, after.F, h=after.history).stress
    np.testing.assert_allclose(packed, np.exp(10 * (1 - volume)) * fresh, rtol=1e-9)
    tight = evaluate(material, after.F, h=np.array([[-0.9, 0.0]])).stress
    np.testing.assert_allclose(tight, np.exp(4.0) * fresh, rtol=1e-9)


def test_snow_of_a_weak_lump_breaks_at_a_smaller_stretch():
    material, half = Snow(), np.array([[0.0, -0.5]])
    after = evaluate(material, np.diag([0.9, 1.0, 1.05])[None], h=half)
    np.testing.assert_allclose(np.diag(after.F[0]), [0.975, 1.0, 1.00375], rtol=1e-9)
    assert after.history[0, 1] == -0.5


@pytest.mark.parametrize("size", [0.005, 0.05, 0.3])
def test_snow_in_float32_breaks_and_packs_as_its_singular_values_do(size, rng):
    material = Snow(E=1e5, compression=0.03, extension=0.003)
    U, V = (np.linalg.qr(rng.standard_normal((3000, 3, 3)))[0] for _ in range(2))
    sigma = 1 + rng.uniform(-size, size, (3000, 3))
    sigma[:1000, 1] = sigma[:1000, 0]
    F = (U * sigma[:, None] @ V).astype(np.float32).astype(np.float64)
    h = rng.uniform(-0.5, 0.5, (3000, 2)).astype(np.float32).astype(np.float64)
    elastic, after = TWINS["snow"].project(F, h, np.array(material.theta()), 0.0)
    assert (np.abs(elastic - F).max(axis=(1, 2)) > 1e-4).mean() > 0.3
    point = evaluate(material, F, h=h, precision="float32")
    np.testing.assert_allclose(point.F, elastic, atol=5e-7)
    np.testing.assert_allclose(point.history, after, atol=1e-6)


DISSIPATIVE = [Metal(), Foam(), Sand(), Snow(), Snow(nu=0.49, extension=0.4, compression=0.06)]


@pytest.mark.parametrize("material", DISSIPATIVE)
def test_no_return_mapping_gains_energy(material, rng):
    """Flow only dissipates energy; snow near nu = 1/2 would gain energy if it broke under
    pressure."""
    F = np.einsum("ni,ij->nij", np.exp(rng.uniform(-0.6, 0.6, (2000, 3))), EYE)
    trial = evaluate(material, F)
    kept = evaluate(material, trial.F, h=trial.history).energy
    assert (kept <= trial.energy * (1 + 1e-9) + 1e-9 * material.E).all()
    assert (kept < 0.9 * trial.energy).mean() > 0.2


@pytest.mark.parametrize("material", [Snow(), Scene.named("snow").material], ids=["law", "preset"])
def test_pressed_snow_packs_instead_of_splitting_sideways(material):
    """While a column packs, snow that its sides lose is held back, not pushed away."""
    point = evaluate(material, np.diag([1.05, 1.05, 0.8])[None])
    again = evaluate(material, point.F, h=point.history)
    assert (np.diag(again.stress[0])[:2] > 0.1 * material.E * material.extension).all()


def test_snow_that_flies_apart_stops_counting():
    """1e6 times its volume is as loose as 1e30 times, and stays a number in float32."""
    point = evaluate(Snow(), 1.1 * EYE[None], h=np.array([[9e5, 0.0]]), precision="float32")
    assert point.history[0, 0] == pytest.approx(1e6, rel=1e-6)


def test_snow_that_would_gain_by_packing_is_refused():
    with pytest.raises(ValueError, match=r"hardening x compression = 1 must be at most 0\.667"):
        Snow(hardening=10, compression=0.1)


def test_fluid_forgets_its_shape_and_resists_shear_only_by_rate():
    material = Fluid(viscosity=2.0)
    C = 3.0 * np.outer(EYE[0], EYE[1])[None]
    tau = evaluate(material, EYE[None], C=C).stress[0]
    np.testing.assert_allclose(tau, [[0, 6, 0], [6, 0, 0], [0, 0, 0]], rtol=0, atol=1e-12)
    dt = 1e-3
    after = evaluate(material, (EYE + dt * C) * 0.98).F[0]
    np.testing.assert_allclose(after, 0.98 * EYE, rtol=1e-12)
    spin = np.array([[[0, -50.0, 0], [50.0, 0, 0], [0, 0, 0]]])
    np.testing.assert_allclose(evaluate(material, EYE + dt * spin).F[0], EYE, rtol=1e-12)


def test_a_few_squeezed_particles_do_not_rule_the_substep():
    """However far they are squeezed, substeps get no shorter than 0.54 of those at rest."""
    at = evaluate(Fluid(), np.cbrt([1.0, 0.8, 0.47, 0.1, 0.01])[:, None, None] * EYE)
    assert at.modulus.max() / at.modulus[0] < 3.4
    assert np.all(np.diff(-at.stress[:, 0, 0]) > 0)


@pytest.mark.parametrize("cfl", [0.3, 0.6, 0.9])
def test_bulk_viscosity_is_stable_beside_the_pressure(cfl):
    """(omega dt)^2 <= 4 - 2 gamma dt at the substep of rest, with room to spare."""
    dx, water = 0.1, Fluid()
    zeta, dt = water.theta_on(dx, cfl)[3], cfl * dx / water.wave_speed()
    assert 0 < 12 * zeta / (water.density * dx**2) * dt < 0.75 * (2 - 2 * cfl**2)


@pytest.mark.parametrize("stretch", [1.0, 7.0])
def test_viscosity_limits_the_substep(stretch):
    """An isolated particle's shear rate decays below the limit and grows beyond twice of it.

    One that flew apart to 343 times its volume is no stiffer in this.
    """
    material, dx = Fluid(viscosity=5.0, density=1000.0, bulk_modulus=1.0), 0.1
    limit = material.viscous_limit(dx)
    assert Fluid().viscous_limit(dx) == np.inf
    for fraction, grows in ((1.0, False), (1.9, False), (2.1, True)):
        solver = make_solver(
            np.array([[0.03, 0.02, 0.01]]),
            np.array([1e-3]),
            [material],
            dx=dx,
            C=np.diag([0.1, -0.1, 0.0])[None],
            precision="float64",
        )
        solver.state.F.fill_(wp.mat33d(*(stretch * EYE).ravel()))
        for _ in range(40):
            solver.step(fraction * limit, 1e-12)
        C = solver.state.C.numpy()[0]
        assert (abs(C[0, 0] - C[1, 1]) > 0.2) == grows


def test_rigid_is_capped_and_says_so():
    hard = Rigid(E=2e11, density=7800.0, speed=2.0, strain=0.005)
    assert hard.simulated_E == pytest.approx(7800 * 400**2)
    assert hard.theta() == NeoHookean(E=hard.simulated_E, nu=hard.nu).theta()
    assert "2e+11 Pa is simulated with 1.248e+09 Pa" in hard.notes()[0]
    soft = Rigid(E=1e6)
    assert soft.simulated_E == 1e6
    assert soft.notes() == []


@pytest.mark.parametrize(("n", "viscosity"), [(0.2, 0.01), (0.2, 1e4), (0.5, 1e-3), (1.0, 1e-6)])
def test_foam_solves_its_flow_rule_however_thin_it_is(n, viscosity, rng):
    """Excess over consistency from 1e-3 to 1e9, its power up to 1e45: no overflow, right root."""
    material = Foam(E=1e6, flow_index=n, viscosity=viscosity, yield_stress=100.0)
    F, h = deformations(rng, 0.2), np.zeros((300, 2))
    for precision, close in (("float64", 1e-6), ("float32", 2e-4)):
        ours = evaluate(material, F, dt=1e-3, precision=precision)
        elastic, after = TWINS["foam"].project(F, h, np.array(material.theta()), 1e-3)
        assert relative(ours.F, elastic, 1.0) < close
        assert relative(ours.history, after, 1.0) < close


NEAR = np.concatenate([np.linspace(0.79, 1.21, 20_001), [0.8, 1.2]])
FAR = np.concatenate([np.geomspace(1e-4, 1e4, 2001), np.linspace(-5, 1e-4, 101)])


@cache
def make_logs(real):
    @kernel(f"phy124_test_log_volume_{real.__name__}")
    def logs(J: wp.array(dtype=real), out: wp.array(dtype=real)):
        out[wp.tid()] = log_volume(J[wp.tid()])

    return logs


def logs(values: np.ndarray, real) -> tuple[np.ndarray, np.ndarray]:
    """The volume ratios as they are in that precision, and their logarithms."""
    J = wp.array(values, dtype=real, device="cpu")
    out = wp.empty_like(J)
    wp.launch(make_logs(real), len(values), [J], [out], device="cpu")
    return J.numpy().astype(float), out.numpy().astype(float)


@pytest.mark.parametrize(("real", "error"), [(wp.float32, 3e-7), (wp.float64, 1e-15)])
def test_near_one_it_is_the_logarithm_to_rounding(real, error):
    J, result = logs(NEAR, real)
    exact = np.log(J)
    assert (np.abs(result - exact) <= error * np.abs(exact)).all()


@pytest.mark.parametrize(("real", "error"), [(wp.float32, 1e-6), (wp.float64, 1e-14)])
def test_far_away_it_goes_on_as_a_line(real, error):
    J, result = logs(FAR, real)
    line = np.log(1e-4) + (J - 1e-4) / 1e-4
    exact = np.where(J > 1e-4, np.log(np.maximum(J, 1e-4)), line)
    assert (np.abs(result - exact) <= error * np.abs(exact)).all()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_at_rest_it_is_nothing(real):
    assert logs(np.ones(1), real)[1][0] == 0


def test_pressed_plasticine_has_an_even_outline():
    """With fewer particles than the default, the outline is bumpy."""

    def unevenness(**accuracy):
        scene = Scene.named("press").replaced(
            {"material.law": "plasticine", "accuracy": {"cells": 8, **accuracy}, "time.frames": 9}
        )
        x = Simulation(prepare(ball(3000), scene)).run().means[8]
        x = x[abs(x[:, 2] - np.median(x[:, 2])) < 0.05, :2]
        sector = (np.arctan2(*x.T) * 24 / np.pi + 24).astype(int) % 48
        return np.std([np.hypot(*x[sector == k].T).max() for k in range(48)])

    assert unevenness() < 0.7 * unevenness(particles_per_axis=1.5)
