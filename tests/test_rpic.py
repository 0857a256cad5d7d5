"""RPIC damping: strain dies away at a rate, spin stays."""

import math

import numpy as np
import pytest

from phy124.accuracy.promises import promise
from phy124.budget.cost import longest_substeps
from phy124.errors import InputError
from phy124.generators.shapes import make_shape
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Scheme
from phy124.mpm.timestep import beside_rpic
from phy124.particles.thickness import Proportions
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.solver import kernels
from phy124.studies.validation.accuracy.problems import angular_momentum
from phy124.studies.validation.bodies import block, make_solver
from reference.physgaussian import Original, Recording
from support.golden_runs import run, solver_of

RATE = 30.0
PARTICLES = Scene.from_data({"accuracy": {"solver": "mpm"}})


def lone(C, precision="float64"):
    """A particle alone, whose C a round trip over the grid gives back, and next to no stress."""
    x, v = np.zeros((1, 3)), np.zeros((1, 3))
    soft = NeoHookean(E=1.0, density=1e5)
    return make_solver(
        x,
        np.full(1, 1e-3),
        [soft],
        dx=0.2,
        v=v,
        C=C[None],
        precision=precision,
        cfl=0.5,
        scheme=Scheme(rpic=RATE),
    )


def test_strain_dies_away_as_the_exponential_and_spin_stays(rng):
    C = rng.normal(size=(3, 3))
    solver, steps, dt = lone(C), 40, 1e-3
    for _ in range(steps):
        solver.step(dt, dt)
    result = solver.state.C.numpy()[0]
    still = math.exp(-RATE * steps * dt)
    assert np.allclose(result + result.T, still * (C + C.T), rtol=0, atol=1e-5)
    assert np.allclose(result - result.T, C - C.T, rtol=0, atol=1e-5)


def growth(fraction):
    """Return the growth of a single particle's vibration in 100 substeps of a fraction of the
    limit."""
    E, density, dx, first = 1e4, 1000.0, 0.2, 1e-6
    solver = make_solver(
        np.zeros((1, 3)),
        np.full(1, 1e-3),
        [NeoHookean(E=E, nu=0.0, density=density)],
        dx=dx,
        v=np.zeros((1, 3)),
        C=first * np.eye(3)[None],
        precision="float64",
        cfl=0.5,
        scheme=Scheme(rpic=100.0),
    )
    dt = fraction * beside_rpic(dx * math.sqrt(density / E))
    for _ in range(100):
        solver.step(dt, dt)
    return np.abs(solver.state.C.numpy()).max() / first


def test_its_substeps_are_stable_up_to_the_limit_and_no_further():
    assert growth(0.98) < 1 < 10 < growth(1.03)
    with pytest.raises(ValueError, match=r"cfl up to 0\.707, but this model has 0\.75"):
        make_solver(
            np.zeros((1, 3)), np.ones(1), [NeoHookean()], dx=0.2, cfl=0.75, scheme=Scheme(rpic=1)
        )
    asked = Scene.from_data({"accuracy": {"rpic_damping": 1}})
    assert longest_substeps(asked)[0] == pytest.approx(longest_substeps(PARTICLES)[0] * 0.5**0.5)


def spinning(rate, precision="float32"):
    """A block that turns as a whole and is free."""
    x, turn = block(8, 0.4), np.array([[0.0, -2.0, 1.0], [2.0, 0.0, -3.0], [-1.0, 3.0, 0.0]])
    C = np.tile(turn, (len(x), 1, 1))
    return make_solver(
        x,
        np.full(len(x), 0.05**3),
        [NeoHookean(E=2e4)],
        dx=0.1,
        v=x @ turn.T,
        C=C,
        precision=precision,
        cfl=0.5,
        scheme=Scheme(rpic=rate),
    )


def test_turning_body_keeps_its_angular_momentum():
    solver = spinning(1000.0, "float64")
    first = angular_momentum(solver)
    solver.advance(0.02)
    assert np.allclose(angular_momentum(solver), first, rtol=0, atol=1e-12)
    turning, plain = spinning(1e6), spinning(0.0)
    for item in (turning, plain):
        item.step(1e-6, 1e-6)
    assert np.array_equal(turning.state.C.numpy(), plain.state.C.numpy())


def test_without_it_nothing_is_launched():
    for rate in (0.0, 1.0):
        solver = spinning(rate)
        solver.step(1e-6, 1e-6)
        launched = {name for phase in solver.workers[0].phases for name, _ in phase}
        assert ("rpic" in launched) == (rate > 0)
    plain, asked = PARTICLES, Scene.from_data({"accuracy": {"rpic_damping": 3}})
    more = {kernel.key for kernel in kernels(asked)} - {kernel.key for kernel in kernels(plain)}
    assert more == {"make_rpic__locals__rpic"}
    assert "rpic_damping" not in plain.resolution.model_dump()


def bar_after_a_period(rate, cells=24):
    """Fraction of its energy that a free bar loses while it swings once."""
    E, density, dx = 1e4, 1000.0, 1 / cells
    wave, speed = math.pi, math.sqrt(E / density)
    z = (np.arange(2 * cells) + 0.5) * dx / 2
    x, v, C = (np.zeros((len(z), *shape)) for shape in ((3,), (3,), (3, 3)))
    x[:, 2], v[:, 2] = z, 1e-4 * np.cos(wave * z)
    C[:, 2, 2] = -1e-4 * wave * np.sin(wave * z)
    solver = make_solver(
        x,
        np.full(len(x), dx**3 / 2),
        [NeoHookean(E=E, nu=0.0, density=density)],
        dx=dx,
        v=v,
        C=C,
        precision="float64",
        cfl=0.5,
        scheme=Scheme(rpic=rate),
    )
    first = diagnose(solver).energy
    solver.advance(2 / speed)
    return 1 - diagnose(solver).energy / first


@pytest.mark.parametrize("cells", [24, 48])
def test_a_bar_loses_what_the_viscosity_of_the_same_rate_takes(cells):
    """eta = rate rho dx^2 / 8; energies die away at 2 k^2 eta / rho, beside APIC's own loss."""
    rate, period = 2.0, 2 / math.sqrt(10)
    expected = 2 * math.pi**2 * rate / cells**2 / 8 * period
    undamped, damped = (-math.log(1 - bar_after_a_period(first, cells)) for first in (0.0, rate))
    assert damped - undamped == pytest.approx(expected, rel=0.9 / cells)


def test_the_number_of_physgaussian_is_a_rate(golden):
    """PhysGaussian's r in every substep dt equals the rate -ln(1 - r) / dt: both runs agree to
    rounding."""
    recording, share, steps = Recording.load(golden, "b_jelly_free_spin"), 0.5, 40
    recording.meta["params"]["rpic_damping"] = share
    original, dt = Original(recording, mls=True), recording.meta["dt"]
    original.run(steps)
    rate = -math.log(1 - share) / dt
    solver = solver_of(recording, precision="float64", cfl=0.5, scheme=Scheme(rpic=rate))
    run(solver, dt, steps)
    scale = np.abs(original.C).max()
    assert np.abs(solver.state.C.numpy() - original.C).max() < 1e-5 * scale
    assert np.abs(solver.state.v.numpy() - original.v).max() < 1e-5


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"transfer": "xpic2", "rpic_damping": 1}, "rpic_damping = 1.0: it needs transfer = apic"),
        ({"rpic_damping": -1}, "rpic_damping = -1: it must be a number from 0 to 1e6"),
        ({"rpic_damping": 1e7}, "rpic_damping = 10000000.0: it must be"),
    ],
)
def test_impossible_rpic_settings_are_refused(data, words):
    with pytest.raises(InputError, match=words):
        Scene.from_data({"accuracy": data})


def test_no_error_is_promised_and_viscous_work_is_not_split():
    calm = {"rpic_damping": 3}
    data = {"accuracy": calm, "material": {"law": "neo_hookean", "damping": 0}}
    assert "rpic_damping" in str(
        promise(Scene.named("press").replaced({"accuracy": calm}), Proportions(0.5, 0.3))
    )
    data["checks"] = {"energy": True}
    Scene.from_data(data)
    data["material"]["damping"] = 5
    with pytest.raises(InputError, match=r"rpic_damping and a viscous material"):
        Scene.from_data(data)


@pytest.mark.slow
def test_rpic_loss_is_numerical_and_threads_agree():
    """A ball that bounces: nothing rubs, so that all that is lost more is the damping."""
    ball, lost = make_shape("sphere", (1, 1, 1), (0.5, 0.5, 0.5)), []
    for rate, threads in ((0, 1), (30, 1), (30, 2)):
        scene = Scene.from_data(
            {
                "object": {"lift": 0.3},
                "material": {"law": "neo_hookean", "E": 1e5, "damping": 0},
                "accuracy": {"cells": 12, "rpic_damping": rate},
                "checks": {"energy": True},
                "time": {"frames": 16, "sleep": False},
            }
        )
        energy = (
            Simulation(prepare(ball, scene, RunContext(threads=threads))).run().report["energy"]
        )
        assert energy["material"] == 0
        lost.append(energy["numerical"])
    assert lost[1] > 1.2 * lost[0] > 0
    assert lost[2] == pytest.approx(lost[1], rel=1e-2)
