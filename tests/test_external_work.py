"""External work: what forces and walls give, against closed forms."""

import json

import numpy as np
import pytest

from phy124.boundaries import Box
from phy124.forces import (
    Acceleration,
    Attraction,
    Grab,
    Gravity,
    ParticleForce,
    SetVelocity,
    Wind,
    WrenchForce,
    ZoneForce,
)
from phy124.kernels.work import EXCHANGE
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import WALL, ExternalWork
from phy124.mpm.tracks import Sine, Tracks
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import block, make_solver
from support.lattices import lattice_scene
from support.shapes import ball, thrown_block

FRAMES, FPS = 4, 100


def run(forces=(), boundaries=(), v=(0, 0, 0)):
    """A free block after some frames: solver, external work, and what that has summed."""
    solver, external = thrown_block(boundaries, forces=forces, v=v)
    start = diagnose(solver)
    external.open(solver.clock)
    for frame in range(FRAMES):
        external.begin(diagnose(solver).momentum)
        solver.advance((frame + 1) / FPS)
    end = diagnose(solver)
    return (
        solver,
        external,
        external.total(solver.clock, end.middle - start.middle),
        (start, end),
    )


def test_gravity_gives_weight_times_time_and_weight_times_height():
    solver, _, exchanged, (start, end) = run([Gravity()])
    mass, time = solver.model.total_mass, solver.clock.time - solver.clock.last_dt / 2
    np.testing.assert_allclose(exchanged.impulse, [0, 0, -9.81 * mass * time])
    assert exchanged.work == pytest.approx(-9.81 * (end.middle - start.middle)[2])
    assert exchanged.moved == pytest.approx(9.81 * mass * time)


@pytest.mark.parametrize(
    "force",
    [ParticleForce(f=(1e-3, 0, 2e-3)), Acceleration(a=(30, 0, 0), profile=Sine(frequency=10))],
    ids=["on particles", "that swings"],
)
def test_impulse_and_work_are_the_change_of_momentum_and_energy(force):
    _, _, exchanged, (start, end) = run([force], v=(0.5, 0, 0))
    np.testing.assert_allclose(exchanged.impulse, end.momentum - start.momentum, rtol=0, atol=1e-9)
    assert exchanged.work == pytest.approx(end.kinetic - start.kinetic, rel=1e-6)


def test_work_of_a_force_on_C_includes_affine_energy():
    spun = SetVelocity(spin=(0, 0, 2), end=1e-5)
    _, _, exchanged, (start, end) = run([ParticleForce(f=(1e-3, 0, 0)), spun])
    assert exchanged.work == pytest.approx(end.energy - start.energy, rel=1e-3)


@pytest.mark.parametrize(
    "force",
    [
        Acceleration(a=(3, 0, 0), region={"upper": [1, 1, 0.5]}),
        ParticleForce(f=(1e-3, 0, 0)),
        Wind(v=(3, 0, 0)),
        Attraction(centre=(1, 0, 0), g=3),
        Grab(point=(0, 0, 0.5), radius=1, targets=((0, 0, 0.5), (1, 0, 0.5))),
        WrenchForce(torque=(0, 0, 1)),
        ZoneForce(a=(3, 0, 0)),
        SetVelocity(spin=(0, 0, 20)),
    ],
    ids=lambda force: force.kind,
)
def test_forces_that_promise_to_keep_C_do(force):
    x = block(middle=(0, 0, 0.5))
    solver = make_solver(x, np.full(len(x), 1e-4), [NeoHookean(E=1e4)], dx=0.125)
    solver.step(1e-3, 0.0)
    tracks = Tracks(real=solver.model.real, device="cpu")
    stages = force.attach(solver.model, solver.state, tracks)
    tracks.upload(solver.clock.values)
    tracks.record().launch()
    still = np.random.default_rng(0).normal(size=(len(x), 3, 3)).astype(np.float32)
    solver.state.C.assign(still)
    for stage in stages:
        launch = stage.record(solver.grid)
        assert launch is not None
        launch.launch()
    kept = np.array_equal(solver.state.C.numpy(), still)
    assert kept == all(stage.keeps_C for stage in stages)


def test_a_wall_at_rest_takes_momentum_and_does_no_work():
    held = Box(lower=(-1, -1, -1), upper=(1, 1, 1), contact="sticky")
    _, _, exchanged, (start, end) = run(boundaries=[held], v=(1, 0, 0))
    np.testing.assert_allclose(exchanged.impulse, end.momentum - start.momentum, rtol=0, atol=1e-9)
    assert exchanged.impulse[0] == pytest.approx(-start.momentum[0], rel=1e-3)
    assert exchanged.work == exchanged.turned == 0


def test_nothing_outside_gives_nothing_and_measures_nothing():
    external = ExternalWork()
    assert external.wrap_forces([]) == [] and external.wrap_walls([], []) == []
    _, _, exchanged, _ = run(v=(1, 2, 3))
    assert (
        not exchanged.impulse.any() and exchanged.work == exchanged.moved == exchanged.turned == 0
    )


def test_a_snapshot_without_rows_is_restored():
    _, external, *_ = run([Gravity()])
    kept = external.snapshot()
    external.restore({**kept, "open": {**kept["open"], WALL: []}})
    np.testing.assert_array_equal(external.snapshot()["closed"][WALL], np.zeros(EXCHANGE))


def test_a_snapshot_is_plain_data_and_restores_the_sums():
    solver, external, exchanged, (start, end) = run([ParticleForce(f=(1e-3, 0, 0))])
    kept, way = json.loads(json.dumps(external.snapshot())), end.middle - start.middle
    solver.advance(FRAMES / FPS + 0.01)
    assert external.total(solver.clock, way).impulse[0] > 1.1 * exchanged.impulse[0]
    external.restore(kept)
    np.testing.assert_array_equal(external.total(solver.clock, way).impulse, exchanged.impulse)
    fresh = ExternalWork()
    fresh.restore(kept)
    closed = np.sum(list(fresh.snapshot()["closed"].values()), axis=0)
    assert closed[0] == pytest.approx(exchanged.impulse[0]), "sums of no launch yet are kept, too"


@pytest.mark.usefixtures("coarse_solids")
def test_gravity_does_no_work_on_held_objects():
    scene = lattice_scene(frames=2).replaced({"object.held": True})
    held = Simulation(prepare(ball(300), scene))
    held.run()
    assert held.stopped is None and held.count == 2
