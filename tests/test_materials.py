"""Constitutive laws: stress against energy, symmetry, limits, closed forms, the NumPy twins."""

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from phy124.kernels import measure, transfer
from phy124.kernels.diagnostics import make_probe
from phy124.materials import AnyMaterial, Fluid, Hencky, Plasticine, Rigid, Sand
from phy124.studies.validation.bodies import make_solver
from reference.material_point import (
    EYE,
    LAWS,
    PLASTIC,
    SOLIDS,
    deformations,
    evaluate,
    name,
    relative,
    rotations,
    transposed,
)
from reference.oracle import TWINS


@pytest.fixture(scope="module", autouse=True)
def every_variant_first() -> None:
    """Build all probes and all transfers before any runs: a mixed-up variant then shows."""
    for material in LAWS:
        for real in (wp.float32, wp.float64):
            make_probe(material.device_law, real)
        for real, form in ((wp.float32, "simd"), (wp.float32, "plain"), (wp.float64, "plain")):
            transfer.make_p2g(material.device_law, real, form)
            transfer.make_g2p(material.device_law, real, form)
        measure.make_measure(material.device_law, wp.float32)


@pytest.mark.parametrize("material", LAWS, ids=name)
@pytest.mark.parametrize("amount", [0.05, 0.3])
def test_stress_is_the_derivative_of_the_energy(material, amount, rng):
    F, h = deformations(rng, amount), np.tile([0.02, 0.0], (300, 1))
    step, P = 1e-4, np.zeros((300, 3, 3))
    for i in range(3):
        for j in range(3):
            for k, weight in ((-2, 1), (-1, -8), (1, 8), (2, -1)):
                G = F.copy()
                G[:, i, j] += k * step
                P[:, i, j] += weight * evaluate(material, G, h=h).energy / (12 * step)
    tau = evaluate(material, F, h=h).stress
    assert relative(tau, P @ transposed(F), 0.0) < 1e-5


@pytest.mark.parametrize("material", LAWS, ids=name)
def test_turning_the_body_turns_the_stress(material, rng):
    F, C = deformations(rng, 0.3), rng.standard_normal((300, 3, 3))
    Q = rotations(rng, 300)
    here = evaluate(material, F, C=C)
    turned = evaluate(material, Q @ F, C=Q @ C @ transposed(Q))
    expected = Q @ here.stress @ transposed(Q)
    assert relative(turned.stress, expected, 0.0) < 1e-6
    np.testing.assert_allclose(turned.energy, here.energy, rtol=1e-5)
    np.testing.assert_allclose(turned.modulus, here.modulus, rtol=1e-6)


@pytest.mark.parametrize("material", LAWS, ids=name)
def test_the_material_has_no_preferred_direction(material, rng):
    F, Q = deformations(rng, 0.3), rotations(rng, 300)
    here, other = evaluate(material, F), evaluate(material, F @ Q)
    assert relative(other.stress, here.stress, 0.0) < 2e-6
    np.testing.assert_allclose(other.energy, here.energy, rtol=1e-5)


@pytest.mark.parametrize("material", PLASTIC, ids=name)
def test_return_mapping_turns_with_body_and_material(material, rng):
    F, Q = deformations(rng, 0.3), rotations(rng, 300)
    here = evaluate(material, F)
    np.testing.assert_allclose(evaluate(material, Q @ F).F, Q @ here.F, atol=1e-6)
    np.testing.assert_allclose(evaluate(material, F @ Q).F, here.F @ Q, atol=1e-6)


@pytest.mark.parametrize("material", LAWS, ids=name)
@pytest.mark.parametrize(("precision", "close"), [("float64", 1e-8), ("float32", 2e-4)])
def test_laws_agree_with_their_numpy_twins(material, precision, close, rng):
    theta, twin = np.array(material.theta_on(0.05, 0.6)), TWINS[name(material)]
    for amount in (0.02, 0.3, 1.0):
        F = EYE + amount * rng.standard_normal((300, 3, 3))
        if isinstance(material, Fluid):
            F = EYE * (1 + 0.2 * amount * rng.standard_normal((300, 1, 1)))
        C, h = rng.standard_normal((300, 3, 3)), 0.05 * rng.random((300, 2))
        got = evaluate(material, F, C=C, h=h, precision=precision, theta=theta)
        floor = 0.01 * theta[0]
        assert relative(got.stress, twin.stress(F, C, h, theta), floor) < close
        energy = twin.energy(F, h, theta)
        assert relative(got.energy, energy, 0.05 * theta[0]) < close
        if twin.project is not None:
            elastic, after = twin.project(F, h, theta, 1e-3)
            assert relative(got.F, elastic, 1.0) < close
            assert relative(got.history, after, 1.0) < close


@pytest.mark.parametrize(
    ("precision", "simd"),
    [
        ("float32", True),
        pytest.param("float64", False, marks=pytest.mark.slow),
        pytest.param("float32", False, marks=pytest.mark.slow),
    ],
)
def test_every_compiled_variant_runs_its_own_law(rng, precision, simd):
    """A lone particle's C changes by -4 kick / (rho dx^2) tau in a substep, whatever the kernel.

    The form without SIMD is that of GPUs (tests/test_kernels_cuda.py).
    """
    dx, kick, count = 0.1, 1e-4, 4
    x = np.arange(count)[:, None] * [5 * dx, 0, 0] + [0.03, 0.02, 0.01]
    F, seen = deformations(rng, 0.02, count).astype(np.float32), []
    C = rng.standard_normal((count, 3, 3)).astype(np.float32)
    for material in LAWS:
        solver = make_solver(
            x, np.full(count, 1e-3), [material], dx=dx, simd=simd, precision=precision
        )
        solver.state.F.assign(F.astype(precision))
        solver.state.C.assign(C.astype(precision))
        solver.step(kick, 1e-9)
        gained = (solver.state.C.numpy() - C) * -material.density * dx**2 / (4 * kick)
        h = np.tile(material.history(), (count, 1))
        theta = np.array(material.theta_on(dx, solver.clock.cfl))
        tau = TWINS[name(material)].stress(F.astype(np.float64), C, h, theta)
        assert relative(gained, tau, 0.0) < 2e-4, name(material)
        seen.append(tau[0, 0, 0])
    assert len(set(seen)) == len(LAWS), "the laws must differ for this to mean anything"


@pytest.mark.parametrize("material", SOLIDS, ids=name)
@pytest.mark.parametrize("nu", [-0.5, 0.0, 0.3, 0.45])
def test_modulus_bounds_the_stiffest_motion(material, nu, rng):
    """Eigenvalues of d tau / d C (dF = C F, C symmetric) stay below A; A is not lax at rest."""
    material = material.model_copy(update={"nu": nu})
    stretches = np.exp(0.5 * rng.standard_normal((100, 3)))
    stretches[0] = 1
    F = np.einsum("ni,ij->nij", stretches, EYE)
    basis = symmetric_basis()
    step, tangent = 1e-4, np.zeros((100, 6, 6))
    for j, C in enumerate(basis):
        ahead = evaluate(material, (EYE + step * C) @ F).stress
        behind = evaluate(material, (EYE - step * C) @ F).stress
        tangent[:, :, j] = np.einsum("nab,iab->ni", (ahead - behind) / (2 * step), basis)
    stiffest = np.linalg.eigvals(tangent).real.max(1)
    bound = evaluate(material, F).modulus
    assert np.all(stiffest <= bound * (1 + 1e-3))
    assert stiffest[0] >= 0.99 * bound[0]


@pytest.mark.parametrize("material", [*LAWS, Fluid()], ids=name)
@pytest.mark.parametrize("amount", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("growth", [1.1, 1.6])
def test_calm_strain_bounds_stiffening(material, amount, growth, rng):
    """No particle strained by it becomes stiffer than `growth` times the stiffest one."""
    F = np.einsum("ni,ij->nij", np.exp(amount * rng.standard_normal((500, 3))), EYE)
    stiffest = evaluate(material, F).modulus.max()
    strains = rng.standard_normal((500, 3))
    strains[:20] = 1
    strains[20:40] = -1
    strains *= material.calm_strain(growth, stiffest / material.density) / np.linalg.norm(
        strains, axis=1, keepdims=True
    )
    # The strain may come at once or in small steps, and all of them may be the stiffest.
    strained = np.exp(strains)[:, :, None] * np.where(np.arange(500)[:, None, None] % 2, F, EYE)
    assert evaluate(material, strained).modulus.max() <= growth * stiffest * (1 + 1e-4)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("amount", [0.01, 0.1, 0.5, 2.0])
def test_henckys_modulus_bounds_shear_however_strained(precision, amount, rng):
    """x coth x of the largest difference of strains, and at most 1.6 times that; mirrored, too."""
    material = Hencky(nu=0.0)
    strains = amount * rng.standard_normal((1000, 3)).clip(-2, 2)
    turns = rotations(rng, 1000), rotations(rng, 1000)
    F = turns[0] @ (np.exp(strains)[:, :, None] * turns[1])
    F[::2, 0] *= -1
    x = np.ptp(strains, axis=1)
    exact = 2 * material.lame[0] * x / np.tanh(x)
    bound = evaluate(material, F, precision=precision).modulus
    assert (bound >= exact * (1 - 2e-6 * np.exp(x))).all()
    assert (bound <= 1.6 * exact).all()


def symmetric_basis() -> NDArray:
    """Six symmetric matrices, orthonormal in the Frobenius product."""
    basis = [np.outer(EYE[i], EYE[i]) for i in range(3)]
    for i, j in ((0, 1), (0, 2), (1, 2)):
        basis.append((np.outer(EYE[i], EYE[j]) + np.outer(EYE[j], EYE[i])) / np.sqrt(2))
    return np.array(basis)


def test_fluid_modulus_is_its_stiffness():
    material, step = Fluid(), 1e-5
    J = np.linspace(0.6, 1.5, 50)
    taus = [
        evaluate(material, EYE * np.cbrt(J * np.exp(s))[:, None, None]).stress[:, 0, 0]
        for s in (step, -step)
    ]
    stiffness = 3 * (taus[0] - taus[1]) / (2 * step)
    bound = evaluate(material, EYE * np.cbrt(J)[:, None, None]).modulus
    np.testing.assert_allclose(stiffness, bound, rtol=1e-6)


@pytest.mark.parametrize("material", LAWS, ids=name)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_every_deformation_is_legal(material, precision):
    """Inverted, flat, a line, nothing, huge, and very anisotropic: all finite."""
    sigmas = [
        (1, 1, -0.5),
        (1, 1, 0),
        (1, 0, 0),
        (0, 0, 0),
        (1e4, 1e4, 1e4),
        (1e4, 1, 1e-4),
        (-1, -1, -1),
        (1e-8, 1e-8, 1e-8),
        (1, 1e-9, -1e-9),
        (3, 0.01, 0.01),
    ]
    F = np.array([np.diag(s).astype(float) for s in sigmas])
    R = rotations(np.random.default_rng(3), len(F))
    for G in (F, R @ F, R @ F @ transposed(R)):
        for value in evaluate(material, G, precision=precision):
            assert np.all(np.isfinite(value)), value


@pytest.mark.parametrize("material", LAWS, ids=name)
def test_at_rest_nothing_moves_bit_for_bit(material):
    for precision in ("float32", "float64"):
        point = evaluate(material, EYE[None], precision=precision)
        assert np.all(point.stress == 0)
        if material.device_law.project is not None:
            assert np.all(point.F == EYE)
            assert np.all(point.history == material.history())


def test_materials_are_named_by_their_law_and_bounded():
    adapter = TypeAdapter(AnyMaterial)
    for material in [*LAWS, Rigid()]:
        assert adapter.validate_python(material.model_dump()) == material
        assert material.wave_speed() > 0
        for field in type(material).model_fields.values():
            assert field.description or field.default in ("rigid", material.law)
    with pytest.raises(ValidationError, match="no unique result"):
        Plasticine(E=1e3, softening=2e3)
    with pytest.raises(ValidationError, match="less than or equal to 60"):
        Sand(friction_angle=80)


@pytest.mark.parametrize(("angle", "channel"), [(30, 44), (35, 55)])
def test_description_of_sand_states_its_angle_in_plane_strain(angle, channel):
    sine = 3 / np.sqrt(2) * Sand(friction_angle=angle).theta()[-1]
    assert np.degrees(np.arcsin(sine)) == pytest.approx(channel, abs=0.2)
    text = Sand.model_fields["friction_angle"].description or ""
    degrees = (f"{number} degrees" in " ".join(text.split()) for number in (angle, channel))
    assert all(degrees)


@pytest.mark.parametrize("material", LAWS, ids=name)
def test_substeps_contain_no_singular_value_decomposition(material):
    for kernel in (
        transfer.make_p2g(material.device_law, wp.float32, "simd"),
        transfer.make_g2p(material.device_law, wp.float32, "simd"),
    ):
        source = generated(kernel)
        assert "builtin_tid1d()" in source, "this is the generated code"
        assert source.count("wp::svd3") == source.count("wp::eig3") == source.count("wp::qr3") == 0


def generated(kernel: wp.Kernel) -> str:
    """The C++ that Warp wrote for a kernel's module, from its cache of compiled modules."""
    wp.load_module(kernel.module, device="cpu")
    # On the CPU a block is one thread; the name carries the hash of exactly this code.
    name = f"wp_{kernel.module.name}_{kernel.module.get_module_hash(1).hex()[:7]}"
    return (Path(wp.config.kernel_cache_dir) / name / f"{name}.cpp").read_text()
