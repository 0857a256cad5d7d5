"""Energy losses of a projected liquid by cause, compared with known results."""

from functools import cache

import numpy as np
import pytest
import warp as wp

from phy124.boundaries import Container, HalfSpace, Path
from phy124.forces import Gravity, ZoneForce
from phy124.kernels.liquid.energies import make_push_work
from phy124.kernels.work import EXCHANGE, WORK
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import MeanWork
from phy124.monitor.liquid_work import LiquidWork
from phy124.monitor.watchdog import Watchdog
from phy124.mpm.tracks import Keyframes
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from support.liquids import DENSITY, TANK, G, block, liquid, pool, run
from support.runs import resumed
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


def works(solver, steps):
    """Works by cause [J], with the change of the energy and the work of gravity."""
    first = diagnose(solver)
    run(solver, steps)
    now = diagnose(solver)
    fallen = float(solver.clock.pull @ (now.middle - first.middle))
    return {
        **solver.energies.read()._asdict(),
        "change": now.energy - first.energy,
        "gravity": fallen,
    }


def measured(x, cells, walls, **options):
    solver = liquid(x, cells, walls, **options)
    solver.keep_works()
    return solver


def test_nothing_works_on_a_still_tank():
    x = block((0, 0, 0), (1, 1, 0.5), 8)
    solver = run(measured(x, 8, [TANK]), 24)
    solver.energies.clear()
    weight = len(x) / 8**4 * DENSITY * G
    for name, work in works(solver, 12).items():
        assert abs(work) < 1e-3 * weight * 0.25, name


EVERYWHERE = Region(lower=(-9, -9, -9), upper=(9, 9, 9))
ZONE = ZoneForce(place=EVERYWHERE, a=(0, 0, -G / 2))


def push(x, forces, steps, **options):
    """Exchange of forces on particles with a liquid, works by cause, and energies."""
    external = MeanWork()
    pushes = external.wrap_forces(forces)
    solver = measured(x, 8, [TANK], pushes=pushes, accumulators=[external], **options)
    external.bind(solver)
    external.open(solver.clock)
    energy = works(solver, steps)
    return external.total(solver.clock, np.zeros(3)), energy, solver


def test_zone_does_no_work_on_a_still_tank():
    x = block((0, 0, 0), (1, 1, 0.5), 8)
    outside, energy, solver = push(x, [ZONE], 6, gravity=(0, 0, -G / 2))
    weight = solver.model.total_mass * G
    assert outside.moved > 0.5 * weight * 6 / 48
    assert abs(outside.work) < 1e-5 * weight
    assert abs(energy["projection"]) < 1e-4 * weight


@pytest.mark.parametrize("threads", [1, 2])
def test_zone_does_the_work_that_a_free_drop_gains(threads):
    x = block((0.25, 0.25, 5.5), (0.75, 0.75, 6.0), 8)
    outside, energy, _ = push(x, [ZONE], 6, gravity=(0, 0, 0), threads=threads)
    assert outside.work > 1.0
    assert outside.work == pytest.approx(energy["change"], rel=0.01)


def test_unresisted_force_works_on_velocities_and_gradients():
    mass, dx = wp.array(np.arange(1.0, 8.0), dtype=wp.float64), 0.1
    before, after = np.random.default_rng(0).normal(size=(2, 7, 4, 3)) * np.array(
        [[1], [10], [10], [10]]
    )
    v, C = wp.array(after[:, 0], dtype=wp.vec3d), wp.array(after[:, 1:], dtype=wp.mat33d)
    v_kept = wp.array(before[:, 0], dtype=wp.vec3d)
    C_kept = wp.array(before[:, 1:], dtype=wp.mat33d)
    sums = wp.zeros(EXCHANGE, dtype=wp.float64)
    inputs = [1, 7, 1, mass, dx, v, C, v_kept, v, C_kept, C]
    wp.launch(make_push_work(wp.float64), 1, inputs, [sums])
    squares = [
        (q[:, 0] ** 2).sum(1) + dx**2 / 4 * (q[:, 1:] ** 2).sum((1, 2)) for q in (before, after)
    ]
    work = mass.numpy() @ (squares[1] - squares[0]) / 2
    assert sums.numpy()[WORK] == pytest.approx(work, rel=1e-12)


def test_only_gravity_works_on_a_drop_before_it_lands():
    x = block((-0.25,) * 3, (0.25,) * 3, 16)
    x = x[(x**2).sum(axis=1) < 0.25**2] + (0, 0, 1)
    solver = measured(x, 16, [TANK])
    energy = works(solver, 12)
    mass, speed = solver.model.total_mass, G * (0.25 - 0.5 / 48)
    assert energy["gravity"] == pytest.approx(mass * G**2 * 0.25**2 / 2, rel=0.01)
    assert energy["change"] == pytest.approx(energy["gravity"], rel=0.005)
    assert diagnose(solver).kinetic == pytest.approx(mass * speed**2 / 2, rel=0.01)
    for name in ("walls", "viscous", "friction", "projection", "density"):
        assert abs(energy[name]) < 0.003 * energy["gravity"], name


def test_viscosity_takes_what_a_vortex_loses():
    """The energy of a Taylor-Green vortex decays with exp(-4 pi^2 nu t)."""
    nu, walls = 0.05, Container(inside=Region(lower=(0, 0, 0), upper=(1, 0.25, 1)), contact="slip")
    x = block((0, 0, 0), (1, 0.25, 1), 16)
    a, b = np.pi * x[:, 0], np.pi * x[:, 2]
    v = 0.2 * np.stack([np.sin(a) * np.cos(b), 0 * a, -np.cos(a) * np.sin(b)], axis=1)
    C = np.zeros((len(x), 3, 3))
    C[:, 0, 0], C[:, 0, 2] = np.cos(a) * np.cos(b), -np.sin(a) * np.sin(b)
    C[:, 2, 0], C[:, 2, 2] = -C[:, 0, 2], -C[:, 0, 0]
    solver = measured(x, 16, [walls], gravity=(0, 0, 0), viscosity=nu * DENSITY)
    solver.state.v.assign(v.astype(np.float32))
    solver.state.C.assign((0.2 * np.pi * C).astype(np.float32))
    first = diagnose(solver).energy
    energy = works(solver, 24)
    expected = first * (1 - np.exp(-4 * np.pi**2 * nu * 0.5))
    assert -energy["viscous"] == pytest.approx(expected, rel=0.05)
    assert -energy["change"] == pytest.approx(expected, rel=0.05)
    assert abs(energy["projection"]) < 0.01 * expected


def test_floor_that_rises_lifts_the_weight():
    motion = Path(times=(0.0, 0.5), points=((0.0, 0.0, 0.0), (0.0, 0.0, 0.1)))
    floor = HalfSpace(point=(0, 0, 0), normal=(0, 0, 1), contact="slip", motion=motion)
    sides = Container(inside=Region(lower=(0, 0, -1), upper=(1, 1, 1e9)), contact="slip")
    x = block((0, 0, 0), (1, 1, 0.5), 8)
    energy = works(measured(x, 8, [sides, floor]), 30)
    assert energy["walls"] == pytest.approx(0.5 * DENSITY * G * 0.1, rel=0.02)
    assert energy["gravity"] == pytest.approx(-energy["walls"], rel=0.02)
    for name in ("viscous", "friction", "projection", "density"):
        assert abs(energy[name]) < 0.02 * energy["walls"], name


def test_nothing_is_launched_without_a_request():
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 8)
    with_sums, without = run(measured(x, 8, [TANK]), 2), run(liquid(x, 8, [TANK]), 2)
    assert "dissipation" in with_sums.timings
    assert "dissipation" not in without.timings
    assert np.array_equal(with_sums.state.x.numpy(), without.state.x.numpy())


def basin(**changes):
    """A ball of a viscous liquid that falls into a basin with rough walls, at 8 cells."""
    changes = {"accuracy": {"cells": 8}, "time.frames": 10, "checks.energy": True, **changes}
    return Scene.named("water").replaced({**changes, "material.viscosity": 5.0})


def simulate(scene, threads=1):
    return Simulation(prepare(ball(), scene, RunContext(threads=threads)))


@cache
def steady():
    """Return the energies of a whole run, which several tests compare with."""
    return simulate(basin()).run().report["energy"]


def test_report_divides_the_loss_of_a_liquid(tmp_path):
    whole = steady()
    assert whole["material"] > 0 and whole["contact"] > 0 and whole["projection"] > 0
    parts = whole["material"] + whole["contact"] + whole["numerical"]
    assert parts == pytest.approx(whole["lost"], rel=1e-12)
    numerical = whole["projection"] + whole["density"] + whole["transfers"]
    assert numerical == pytest.approx(whole["numerical"], rel=1e-12)
    work = whole["forces"] + whole["walls"] - whole["lost"]
    assert work == pytest.approx(whole["kinetic"], rel=1e-9)
    paused = simulate(basin())
    assert resumed(paused, 5, tmp_path / "pause.safetensors").run().report["energy"] == whole
    two = simulate(basin(), threads=2).run().report["energy"]
    assert two["material"] == pytest.approx(whole["material"], rel=0.02)


WEAKER = Gravity(profile=Keyframes(times=(0.0, 0.5), factors=(1.0, 0.0)))


def weaken(x, walls, fps, **options):
    """A liquid with gravity that vanishes within 0.5 s, after 5 / 12 s, and its balance."""
    external, watch = LiquidWork(), Watchdog()
    sums = {"pushes": [WEAKER], "accumulators": [external], "gravity": (0, 0, 0)}
    solver = liquid(x, 8, walls, **sums, **options)
    for observer in (external, watch):
        observer.bind(solver, [external, watch])
    for frame in range(5 * fps // 12):
        watch.before_attempt()
        solver.advance((frame + 1) / fps)
        assert watch.after_attempt() is None
    return solver, watch


def test_gravity_that_varies_creates_no_energy_in_a_tank():
    _, watch = weaken(block((0, 0, 0), (1, 1, 0.5), 8), [TANK], 12, viscosity=50.0)
    assert -0.1 < watch.balance.energy_gain < 0


def test_gravity_that_varies_works_on_a_falling_block():
    """The speed is g t (1 - t); gravity works m v^2 / 2."""
    solver, watch = weaken(block((0, 0, 5), (0.5, 0.5, 5.5), 8), [], 96)
    time, mass = 5 / 12, solver.model.total_mass
    work = watch.external.total(solver.clock, np.zeros(3)).work
    assert work == pytest.approx(mass * (G * time * (1 - time)) ** 2 / 2, rel=5e-3)
    assert abs(watch.balance.energy_gain) < 1e-3


def test_gravity_that_varies_gives_the_same_balance():
    profile = {"kind": "keyframes", "times": [0.0, 0.01], "factors": [0.999999, 1.0]}
    forces = [{"kind": "gravity", "profile": profile}]
    varied = simulate(basin(forces=forces)).run().report["energy"]
    assert varied["projection"] == pytest.approx(steady()["projection"], rel=0.01)
    assert varied["forces"] == pytest.approx(steady()["forces"], rel=0.01)
    assert varied["density"] == pytest.approx(steady()["density"], rel=0.01)


STEADY = {"kind": "keyframes", "times": [0.0, 0.01], "factors": [0.9999999, 1.0]}


@pytest.mark.parametrize(
    ("solver", "profile", "live"), [("mpm", None, True), ("lattice", STEADY, False)]
)
def test_pool_has_the_balance_of_a_steady_run(solver, profile, live):
    """In a live run or with gravity that varies, the floor carries the liquid in every step."""
    start = {"time": {"frames": 5, "fps": 24}}
    varied = [{"kind": "gravity", **({"profile": profile} if profile else {})}]
    gains = []
    for changes, forces in ((False, [{"kind": "gravity"}]), (live, varied)):
        scene = pool(**start, forces=forces).replaced({"accuracy.solver": solver})
        setup = prepare(ball(), scene, RunContext(threads=1), changes=changes)
        gains.append(Simulation(setup).run().report["balance"]["energy_gain"])
    assert gains[0] < -0.1, "the impact loses energy"
    assert gains[1] == pytest.approx(gains[0], abs=2e-3)


def test_gravity_that_jumps_works_on_a_falling_pool():
    start = {"time": {"frames": 5, "fps": 24}, "object": {"lift": 1.0}, "boundaries": []}
    scene = pool(**start).replaced({"accuracy.solver": "mpm"})
    falling = Simulation(prepare(ball(), scene, RunContext(threads=1), changes=True))
    for g in (9.81, 9.81, 9.81, -5.0, 9.81):
        falling.change(scene.replaced({"forces": [{"kind": "gravity", "g": (0, 0, -g)}]}))
        falling.step()
    balance = falling.report()["balance"]
    # The first half step of the liquid and half substeps of the ball cost 3 %.
    assert abs(balance["energy_gain"]) < 0.05
    assert balance["momentum_gain"] < 1e-3
