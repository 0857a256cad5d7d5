"""Energy losses by cause: viscosity, plastic flow, friction at walls, and numerics."""

import math

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.generators.shapes import make_shape
from phy124.materials import Metal, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.dissipation import Dissipation
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import block, make_solver
from support.runs import resumed


def bar_after_a_period(damping):
    """Energy at first [J], and where it went while a free bar swung once."""
    E, density, dx = 1e4, 1000.0, 1 / 24
    wave, speed = math.pi, math.sqrt(E / density)
    z = (np.arange(48) + 0.5) * dx / 2
    x, v, C = (np.zeros((len(z), *shape)) for shape in ((3,), (3,), (3, 3)))
    x[:, 2], v[:, 2] = z, 1e-4 * np.cos(wave * z)
    C[:, 2, 2] = -1e-4 * wave * np.sin(wave * z)
    material = NeoHookean(E=E, nu=0.0, density=density, damping=damping)
    work = Dissipation()
    solver = make_solver(
        x,
        np.full(len(x), dx**3 / 2),
        [material],
        dx=dx,
        v=v,
        C=C,
        precision="float64",
        gathered=[work],
    )
    first = diagnose(solver)
    solver.advance(2 / speed)
    now = diagnose(solver)
    return first.energy, work.loss(now.energy - first.energy, 0.0, now.elastic - first.elastic)


def test_loss_of_an_undamped_bar_is_numerical():
    first, loss = bar_after_a_period(0.0)
    assert loss.material == 0
    assert 0 < loss.numerical == loss.total < 0.01 * first


def test_a_damped_bar_loses_what_friction_takes():
    """rho u'' = E u_zz + 2 eta u'_zz: energies die away at 2 k^2 eta / rho."""
    damping, period = 20.0, 2 / math.sqrt(10)
    first, loss = bar_after_a_period(damping)
    expected = first * (1 - math.exp(-2 * math.pi**2 * damping / 1000 * period))
    assert loss.material == pytest.approx(expected, rel=0.02)
    assert sum(loss) == loss.total
    assert abs(loss.numerical) < 0.02 * loss.material


@pytest.mark.slow
def test_metal_loses_its_plastic_work(rng):
    """A block stretched at a steady rate: yield stress times plastic strain."""
    x = block(10, 0.5)
    rate, duration, strength = 1.0, 0.02, 2e3
    metal = Metal(E=1e6, nu=0.3, yield_stress=strength, hardening=0.0)
    C = np.tile(rate * np.diag([1.0, -0.5, -0.5]), (len(x), 1, 1))
    work = Dissipation()
    solver = make_solver(
        x,
        np.full(len(x), 0.05**3),
        [metal],
        dx=0.1,
        v=x @ C[0].T,
        C=C,
        precision="float64",
        gathered=[work],
    )
    first = diagnose(solver)
    solver.advance(duration)
    now = diagnose(solver)
    loss = work.loss(now.energy - first.energy, 0.0, now.elastic - first.elastic)
    plastic = solver.state.history.numpy()[:, 0] * math.sqrt(2 / 3) * strength
    assert loss.material == pytest.approx(plastic.sum() * 0.05**3, rel=0.03)
    assert loss.numerical < 0.1 * loss.material


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (
            {"checks": {"energy": True, "balance": False}},
            "checks.energy = true: it needs checks.balance",
        ),
        (
            {
                "checks": {"energy": True},
                "accuracy": {"solver": "mpm"},
                "objects": [{"name": "cup", "place": [2.0, 0.0]}],
            },
            "checks.energy = true: it does not support objects",
        ),
    ],
)
def test_a_split_that_cannot_be_made_is_refused(data, message):
    with pytest.raises(InputError, match=message):
        Scene.from_data(data)


def sliding():
    """A block of rubber that slides over rough ground until it rests."""
    return Scene.from_data(
        {
            "object": {"velocity": [1.5, 0, 0]},
            "material": {"law": "neo_hookean", "E": 2e5, "damping": 600.0},
            "boundaries": [{"kind": "ground", "friction": 0.3}],
            "accuracy": {"cells": 12, "transfer": "xpic2"},
            "checks": {"energy": True},
            "time": {"frames": 20, "sleep": False},
        }
    )


@pytest.mark.slow
def test_a_sliding_block_loses_friction_times_weight_times_way():
    run = Simulation(
        prepare(make_shape("box", (1, 1, 0.5), (0.5, 0.5, 0.5)), sliding(), RunContext(threads=1))
    )
    energy = run.run().report["energy"]
    way = float((run.solver.state.x.numpy() - run.setup.particles.x).mean(axis=0)[0])
    assert energy["contact"] == pytest.approx(
        0.3 * run.setup.particles.mass.sum() * 9.81 * way, rel=0.03
    )
    parts = energy["material"] + energy["contact"] + energy["numerical"]
    assert parts == pytest.approx(energy["lost"], rel=1e-12)
    assert abs(energy["numerical"]) < 0.02 * energy["lost"]


@pytest.mark.slow
def test_a_paused_run_goes_on_with_the_same_sums(tmp_path):
    scene = sliding().replaced({"accuracy.cells": 8, "time.frames": 5})
    body = make_shape("box", (1, 1, 0.5), (0.5, 0.5, 0.5))
    whole = Simulation(prepare(body, scene, RunContext(threads=1))).run()
    run = Simulation(prepare(body, scene, RunContext(threads=1)))
    clip = resumed(run, 2, tmp_path / "pause.safetensors").run()
    assert np.array_equal(clip.means, whole.means)
    assert clip.report["energy"] == whole.report["energy"]
    two = Simulation(prepare(body, scene, RunContext(threads=2))).run()
    assert two.report["energy"]["contact"] == pytest.approx(
        whole.report["energy"]["contact"], rel=1e-2
    )
