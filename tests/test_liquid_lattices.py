"""Elastic bodies on lattices in a projected liquid: floating, landing, and conserved momentum."""

import numpy as np
import pytest

from phy124.boundaries import Container, Held
from phy124.errors import InputError
from phy124.forces import Gravity, Impulse, TotalForce, WrenchForce
from phy124.liquid.immersed import ImmersedSolver
from phy124.live import Live
from phy124.live.places import Motion
from phy124.materials import Fluid, NeoHookean
from phy124.mpm import Model, State
from phy124.particles.lattice import lattice_of
from phy124.particles.solid import Solid
from phy124.pipeline.resume import load, save
from phy124.runtime.context import RunContext
from phy124.scene.lattices import reason_for_mpm
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from support.liquids import CELLS, DENSITY, DX, LEVEL, TANK, G, block, pool
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SMOOTH = Container(inside=TANK.inside, contact="separate", friction=0.0)


def immersed(
    low, cells, *, density=DENSITY / 2, E=1e5, v=(0, 0, 0), gravity=G, clamps=(), held=(), below=0.0
):
    """Return a block on its lattice in a tank of water; the block's lowest corner is in cells.

    A grid line is `below` cells below the floor.
    """
    lower, upper = np.array(low) * DX, (np.array(low) + cells) * DX
    x = block((0, 0, 0), (1, 1, LEVEL), CELLS)
    x = x[((x < lower) | (x > upper)).any(axis=1)]
    halves = np.round(2 * np.array([low, cells])).astype(int)
    solid = Solid(halves[0], DX / 2, np.ones(halves[1], np.float32))
    points = lattice_of(solid, density=density, dx=DX)
    assert points.surface is not None
    number = np.repeat([0, 1], [len(x), len(points)])
    materials = [Fluid(density=DENSITY), NeoHookean(density=density, E=E, nu=0.3)]
    volume = np.concatenate([np.full(len(x), DX**3 / 8), points.volume])
    named = {"names": ["water", "body"], "wet": [0], "held": held, "origin": (0, 0, -below * DX)}
    every = np.concatenate([x, points.x.astype(float)])
    model = Model.of(every, volume, materials, dx=DX, material=number, body=number, **named)
    walls = [SMOOTH] if gravity else []
    return ImmersedSolver(
        model,
        points.surface + [0, 0, 0, 0, 0, 0, 1, 0],
        State.of(model, np.outer(number, v)),
        forces=[Gravity(g=(0, 0, -gravity))] if gravity else [],
        boundaries=[*walls, *clamps],
        walls=[("tank", wall) for wall in walls],
        copies=points.copies,
        still=held,
        threads=1,
    )


def run(solver, frames, fps=24):
    start = solver.clock.time
    for frame in range(frames):
        solver.advance(start + (frame + 1) / fps)
    return solver


def motion(solver):
    """Return momentum and angular momentum of the nodes."""
    nodes = solver.lattice.nodes_state
    moves = nodes.inverse.numpy() > 0
    p = nodes.v.numpy()[moves] / nodes.inverse.numpy()[moves, None].astype(float)
    x = (solver.lattice.lattice.x + nodes.u.numpy())[moves]
    return np.array([p.sum(axis=0), np.cross(x, p).sum(axis=0)])


def rise(solver):
    """Return the mean height of the block above its height at the start [cells]."""
    mine = solver.model.particles(1)
    return float((solver.state.x.numpy()[mine, 2] - solver.model.rest[mine, 2]).mean()) / DX


def energy(solver):
    """Return the kinetic and potential energy [J]."""
    mass, x, v = (
        a.numpy().astype(float) for a in (solver.model.mass, solver.state.x, solver.state.v)
    )
    return float(mass @ (G * x[:, 2] + (v**2).sum(axis=1) / 2))


@pytest.mark.parametrize(
    "ratio", [0.5, *(pytest.param(ratio, marks=pytest.mark.slow) for ratio in (0.3, 0.7))]
)
def test_cube_without_damping_floats_at_its_depth(ratio):
    """In its exact depth, the cube bobs by a few percent, and its vibrations do not grow."""
    low = CELLS * LEVEL - 6 * ratio
    solver = immersed((5, 5, low), (6, 6, 6), density=ratio * DENSITY)
    exact = low - round(2 * low) / 2
    places = [rise(run(solver, 1)) for _ in range(24)]
    assert np.mean(places[8:]) == pytest.approx(exact, abs=0.03 * 6)
    v = solver.lattice.state.v.numpy()
    assert np.linalg.norm(v - v.mean(axis=0), axis=1).max() < 0.3


@pytest.mark.parametrize(
    ("density", "E", "speed"),
    [pytest.param(30.0, 1e3, 0.0, marks=pytest.mark.slow), (300.0, 1e3, 3.0)],
)
def test_very_light_or_soft_body_gains_no_energy(density, E, speed):
    solver = immersed((5, 5, 8), (5, 5, 5), density=density, E=E, v=(0, 0, -speed))
    start = energy(solver)
    assert all(energy(run(solver, 1)) < start for _ in range(20))
    assert solver.lattice.state.x.numpy()[:, 2].min() > 0.05


def test_block_receives_exactly_the_impulse_of_the_liquid():
    solver = immersed((2, 2, 8), (4, 4, 4), density=DENSITY, v=(0.5, 0, -2), gravity=0)
    before = motion(solver)
    solver.pairs.begin()
    run(solver, 12, fps=48)
    (force, torque), *_ = solver.pairs.wrenches(1.0).values()
    change = motion(solver) - before
    assert abs(change[0, 2]) > 0.2 * abs(before[0, 2])
    np.testing.assert_allclose(change[0], force, atol=1e-3 * abs(change[0, 2]))
    np.testing.assert_allclose(change[1], torque, atol=3e-3 * abs(change[1]).max())


def test_energy_contains_the_momentum_of_the_liquid_alone():
    """The block falls towards the water; its momentum is not the liquid's."""
    solver = run(immersed((5, 5, 9), (4, 4, 4), v=(0, 0, -1)), 1)
    water, clock = solver.liquid, solver.liquid.clock
    momentum = water.model.mass.numpy().astype(float) @ water.state.v.numpy()
    block = motion(solver)[0]
    assert abs(block[2]) > 10 * abs(momentum[2])
    lag = clock.last_dt / 2 * clock.pull @ momentum
    assert solver.clock.lag(0.0, momentum + block) == pytest.approx(lag, rel=1e-3)


@pytest.mark.slow
def test_held_block_is_lifted_by_the_water_it_displaces():
    solver = run(immersed((5, 5, 3), (6, 6, 6), density=DENSITY, held=[1]), 6)
    np.testing.assert_array_equal(rise(solver), 0)
    solver.pairs.begin()
    run(solver, 6)
    level = solver.model.volume.numpy()[solver.model.particles(0)].sum()
    level = (level - 36 * DX**2 * 3 * DX) / (1 - 36 * DX**2)
    lift = solver.pairs.wrenches(6 / 24)[0, 1].force[2]
    assert lift == pytest.approx(DENSITY * G * 36 * DX**2 * (level - 3 * DX), rel=0.05)


@pytest.mark.parametrize(
    ("low", "below"),
    [
        pytest.param(5.5, 0.0, marks=pytest.mark.slow),
        (5.5, 0.75),
        pytest.param(5.0, 0.4, marks=pytest.mark.slow),
    ],
)
def test_film_below_a_body_has_the_pressure_at_the_floor(low, below):
    """Neither the body's sides nor the floor have to be on grid lines."""
    held = {"density": DENSITY, "held": [1], "below": below}
    solver = run(immersed((low, low, 0), (5, 5, 3), **held), 6)
    solver.pairs.begin()
    lift = run(solver, 2).pairs.wrenches(2 / 24)[0, 1].force[2]
    assert lift == pytest.approx(DENSITY * G * 75 * DX**3, rel=0.04)


@pytest.mark.slow
def test_clamped_reed_sways_with_the_water():
    clamp = Held(lower=(-9, -9, -9), upper=(9, 9, DX))
    solver = immersed((7, 7, 0), (2, 2, 8), density=600.0, clamps=[clamp])
    run(solver, 2)
    solver.bind(
        forces=[Gravity(g=(2, 0, -9.6))], boundaries=[SMOOTH, clamp], walls=[("tank", SMOOTH)]
    )
    run(solver, 9)
    x, rest = solver.lattice.state.x.numpy(), solver.lattice.model.rest
    tip, foot = rest[:, 2] > 7 * DX, rest[:, 2] < DX / 2
    assert (x - rest)[tip, 0].mean() > 0.5 * DX
    assert abs((x - rest)[foot]).max() < 0.1 * DX


@pytest.mark.slow
def test_stone_presses_on_the_floor_by_weight_minus_buoyancy():
    solver = run(immersed((6, 6, 2), (4, 4, 4), density=2.5 * DENSITY, E=1e6), 40)
    solver.pairs.begin()
    run(solver, 24)
    lift = solver.pairs.wrenches(1.0)[0, 1].force[2]
    assert lift == pytest.approx(DENSITY * G * 64 * DX**3, rel=0.03)


ZONE = {"kind": "zone", "a": (3, 0, -4), "place": {"lower": (-2, -2, -2), "upper": (2, 2, 2)}}
SAND = {"name": "sand", "shape": "sphere", "size": 0.4, "lift": 2.0, "material": {"law": "sand"}}
STONE = {"name": "stone", "shape": "sphere", "size": 0.4, "lift": 2.0, "motion": {"kind": "free"}}


def on_lattice(**changes):
    return pool(**changes).replaced({"accuracy.solver": "lattice"})


def test_scene_runs_on_lattices_by_default_and_reports():
    clip = Simulation(prepare(ball(), pool(wrenches=True), RunContext(threads=1))).run()
    assert clip.report["complete"], clip.report["stopped"]
    assert clip.report["balance"]["momentum_gain"] < 0.02
    assert clip.report["balance"]["energy_gain"] < 0.02
    assert clip.report["pairs"]["object_on_pool"]["largest_force"] > 100
    assert clip.report["walls"]["container_z_low"]["largest_force"] > 1000
    ran = clip.report["effects"]["ran"]
    assert any("for object, in the liquid" in effect for effect in ran)
    assert "pressure projection" in ran


def test_gravity_does_the_work_when_a_liquid_falls_on_a_held_body():
    drop = {"name": "drop", "shape": "sphere", "size": 0.5, "lift": 1.1}
    drop["material"] = {"law": "fluid"}
    scene = pool(object={"held": True}, objects=[drop], time={"frames": 2, "fps": 24})
    clip = Simulation(prepare(ball(), scene, RunContext(threads=1))).run()
    assert clip.report["complete"], clip.report["stopped"]
    assert clip.report["balance"]["energy_gain"] < 0.02


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"accuracy.solver": "mpm"}, "solver is mpm"),
        ({"material.density": 20.0}, "so light"),
        ({"accuracy.precision": "auto"}, "slower in float64"),
        ({"objects": [*pool().data()["objects"], SAND]}, "objects that yield"),
        ({"objects": [*pool().data()["objects"], STONE]}, "free solids"),
    ],
)
def test_default_is_mpm_for_a_reason(changes, reason):
    assert pool().solver == "lattice"
    assert pool(stiffness_profile={"kind": "sine", "frequency": 1.0, "offset": 2.0}).immerses
    assert pool().replaced({"material.density": 20.0, "material.damping": 5.0}).immerses
    scene = pool().replaced(changes)
    assert scene.projects and scene.solver == "mpm"
    assert reason in reason_for_mpm(scene)


def test_sand_keeps_its_solver_beside_lattices_by_choice():
    scene = on_lattice(objects=[*pool().data()["objects"], SAND])
    with pytest.raises(InputError, match="yield"):
        prepare(ball(), scene, RunContext(threads=1))
    free = scene.replaced({"accuracy.liquid": None})
    assert not free.projects
    assert free.couples


def simulate(**changes):
    """Return the mean positions of body and liquid at the end, and the lost energy."""
    run = Simulation(prepare(ball(), pool(**changes), RunContext(threads=1)))
    gain = run.run().report["balance"]["energy_gain"]
    model, x = run.solver.model, run.solver.state.x.numpy()
    return np.array([x[model.particles(body)].mean(axis=0) for body in (0, 1)]), gain


def test_force_on_all_particles_acts_like_a_uniform_acceleration():
    gravity, time = {"kind": "gravity"}, {"frames": 6, "fps": 24}
    steady = {"kind": "acceleration", "a": ZONE["a"]}
    uniform, lost = simulate(forces=[gravity, steady], time=time)
    pushed, same = simulate(forces=[gravity, ZONE], time=time)
    assert uniform[0, 0] > 0.03
    np.testing.assert_allclose(pushed, uniform, atol=2e-3)
    assert same == pytest.approx(lost, abs=0.03)


@pytest.mark.parametrize(
    "force",
    [
        TotalForce(f=(3, 0, 0)),
        Impulse(p=(3, 0, 0), region=Region(lower=(-1, -1, -1), upper=(2, 2, 0.45))),
        WrenchForce(point=(0.5, 0.5, 0.4), force=(3, 0, 0), radius=0.3),
        WrenchForce(point=(0.5, 0.5, 0.4), force=(3, 0, 0), object="body"),
    ],
)
def test_force_is_divided_between_body_and_liquid(force):
    """Together, the parts of the force transfer the momentum of the whole force."""
    solver = immersed((5, 5, 5), (5, 5, 5))
    parts = [solver.lattice.model, solver.liquid.model]
    acting = [part for part in (force.in_part(each, solver.model) for each in parts) if part]
    assert len(acting) == (1 if force.object else 2)
    sums = [np.sum([getattr(part, name)[0] for part in acting]) for name in force.totals]
    assert sums[0] == pytest.approx(3)
    solver.bind(forces=[force], boundaries=[SMOOTH], walls=[("tank", SMOOTH)])


def test_body_can_be_moved_at_once_in_a_live_run():
    live = Live(ball(), pool(), RunContext(threads=1))
    live.step()
    to = Motion(np.array([0.1, 0, 1.5]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    live.set_motion("object", to)
    live.step()
    np.testing.assert_allclose(live.centres["object"], to.place, atol=0.05)


@pytest.mark.parametrize(
    ("threads", "viscosity"),
    [
        pytest.param(1, 0.0, marks=pytest.mark.slow),
        (1, 1000.0),
        pytest.param(2, 0.0, marks=pytest.mark.slow),
    ],
)
def test_run_on_lattices_resumes_bit_for_bit(threads, viscosity, tmp_path):
    scene = on_lattice().replaced({"objects.0.material.viscosity": viscosity})
    setup = prepare(ball(), scene, RunContext(threads=threads))
    first = Simulation(setup)
    for _ in range(5):
        first.step()
    save(first, tmp_path / "run.phy124")
    ahead = [first.step().gaussians.means for _ in range(2)]
    second = load(tmp_path / "run.phy124")
    assert isinstance(second.solver, ImmersedSolver)
    assert all(np.array_equal(second.step().gaussians.means, means) for means in ahead)
