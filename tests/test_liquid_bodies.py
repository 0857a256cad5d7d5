"""Other materials in a projected liquid: floating, sinking and held bodies."""

import numpy as np
import pytest

from phy124.boundaries import Container, Press
from phy124.forces import Gravity, ZoneForce
from phy124.gaussians import rotation_matrices
from phy124.liquid.clock import LiquidClock
from phy124.liquid.mixed import MixedSolver
from phy124.materials import Fluid, NeoHookean
from phy124.monitor.observer import Violation
from phy124.mpm import FreeBody, Model, State
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball
from support.liquids import CELLS, DENSITY, DX, LEVEL, TANK, G, block, liquid, pool
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


def mixed(
    water,
    body,
    density,
    *,
    gravity=G,
    held=(),
    walls=(TANK,),
    E=1e5,
    pushes=(),
    free=(),
    threads=1,
    below=0.0,
) -> MixedSolver:
    """Particles of water and of an elastic body, with 8 in each cell.

    A grid line is `below` cells below the floor.
    """
    for solid in free:
        water = water[solid.measure_depth(water) < 0]
    x = np.concatenate([water, body])
    number = np.repeat([0, 1], [len(water), len(body)])
    materials = [Fluid(density=DENSITY), NeoHookean(density=density, E=E, nu=0.3)]
    named = {"names": ["water", "body"], "held": held, "wet": [0], "origin": (0, 0, -below * DX)}
    volume = np.full(len(x), DX**3 / 8)
    model = Model.of(x, volume, materials, dx=DX, material=number, body=number, **named)
    pull = [Gravity(g=(0, 0, -gravity))] if gravity else []
    tanks = [(f"tank_{index}", wall) for index, wall in enumerate(walls)]
    options = {"on_liquid": [*pull, *pushes], "boundaries": list(walls), "walls": tanks}
    options |= {"forces": [*pull, *pushes], "free": free, "threads": threads}
    options["planes"] = [side for wall in walls for side in wall.sides()] if free else []
    return MixedSolver(model, State.of(model), **options)


def box(middle, cells) -> tuple[np.ndarray, np.ndarray]:
    """Corners of a box whose sides are some numbers of cells [m]."""
    half = np.array(cells) * DX / 2
    return np.array(middle) - half, np.array(middle) + half


def with_block(density, bottom, cells=(5, 5, 3), **options) -> MixedSolver:
    """A tank of water with a block in it, whose bottom is at a height [m]."""
    lower, upper = box((0.5, 0.5, bottom + cells[2] * DX / 2), cells)
    water = block((0, 0, 0), (1, 1, LEVEL), CELLS)
    inside = ((water > lower) & (water < upper)).all(axis=1)
    return mixed(water[~inside], block(lower, upper, CELLS), density, **options)


def run(solver: MixedSolver, frames: int, fps: int = 24) -> MixedSolver:
    start = solver.clock.time
    for frame in range(frames):
        solver.advance(start + (frame + 1) / fps)
    return solver


def depth(solver: MixedSolver) -> float:
    """Depth of the block's bottom below the level of the water [cells]."""
    model, x = solver.model, solver.state.x.numpy()
    block = model.particles(1)
    volume = model.mass.numpy()[block].sum() / DENSITY
    level = model.volume.numpy()[model.particles(0)].sum() + volume
    rest = model.rest[block, 2]
    return (level - (x[block, 2].mean() - rest.mean() + rest.min() - DX / 4)) / DX


@pytest.mark.slow
def test_elastic_block_floats_at_its_depth():
    solver = run(with_block(0.5 * DENSITY, LEVEL - 1.5 * DX), 12)
    assert depth(solver) == pytest.approx(1.5, abs=0.2)


def floating(ratio: float, **options) -> MixedSolver:
    """A free block of some density that floats next to an elastic one."""
    half = np.array((2.4, 2.4, 1.5)) * DX
    place = (0.7, 0.7, LEVEL + (0.5 - ratio) * 2 * half[2])
    solid = FreeBody("solid", "box", tuple(half), place, density=ratio * DENSITY)
    lower, upper = box((0.2, 0.2, LEVEL), (4, 4, 3))
    water = block((0, 0, 0), (1, 1, LEVEL), CELLS)
    water = water[((water < lower) | (water > upper)).any(axis=1)]
    return mixed(water, block(lower, upper, CELLS), DENSITY / 2, free=[solid], **options)


@pytest.mark.slow
def test_free_solid_floats_next_to_an_elastic_block():
    solver = floating(0.5)
    solid = solver.free.all[0]
    heights = [run(solver, 1).free.poses()[0, 2] - solid.half[2] for _ in range(12)]
    level = (solver.model.total_mass + solid.mass) / DENSITY
    side = 2 * solid.half[2]
    assert level - np.mean(heights[6:]) == pytest.approx(side / 2, abs=0.05 * side)
    solver.free.begin()
    frames = 12
    lift = run(solver, frames).free.wrenches(frames / 24)[0].force[2]
    assert solver.free.names[0] == "water_on_solid"
    assert lift == pytest.approx(solid.mass * G, rel=0.1)


@pytest.mark.slow
def test_light_and_heavy_blocks_rise_and_sink():
    for density, sign in ((0.1 * DENSITY, 1), (2.5 * DENSITY, -1)):
        solver = with_block(density, 0.125)
        before = solver.state.x.numpy()[-600:, 2].mean()
        run(solver, 6)
        assert sign * (solver.state.x.numpy()[-600:, 2].mean() - before) > 0.02


def test_held_block_is_lifted_by_the_water_it_displaces():
    solver = run(with_block(DENSITY, 0.1875, cells=(6, 6, 6), held=[1]), 6)
    np.testing.assert_array_equal(solver.state.x.numpy()[-1728:], solver.model.rest[-1728:])
    solver.pairs.begin()
    run(solver, 6)
    level = solver.model.volume.numpy()[solver.model.particles(0)].sum()
    level = (level - 36 * DX**2 * 0.1875) / (1 - 36 * DX**2)
    lift = solver.pairs.wrenches(6 / 24)[0, 1].force[2]
    assert lift == pytest.approx(DENSITY * G * 36 * DX**2 * (level - 0.1875), rel=0.05)


@pytest.mark.parametrize("below", [0.0, 0.4, pytest.param(0.75, marks=pytest.mark.slow)])
def test_film_below_a_body_has_the_pressure_at_the_floor(below):
    """The floor does not have to be on a grid line."""
    solver = run(with_block(DENSITY, 0.0, held=[1], below=below), 6)
    solver.pairs.begin()
    lift = run(solver, 2).pairs.wrenches(2 / 24)[0, 1].force[2]
    assert lift == pytest.approx(DENSITY * G * 75 * DX**3, rel=0.06)


@pytest.mark.slow
def test_force_on_particles_presses_the_floor_beside_bodies():
    zone = ZoneForce(place=Region(lower=(-1, -1, -1), upper=(2, 2, 2)), a=(0, 0, -G / 2))
    solver = with_block(DENSITY, 0.125, cells=(4, 4, 4), held=[1], gravity=G / 2, pushes=[zone])
    run(solver, 6)
    before = solver.impulses.wrench("tank_0_z_low").numpy()[2]
    press = (run(solver, 12).impulses.wrench("tank_0_z_low").numpy()[2] - before) / 0.5
    volume = solver.model.volume.numpy().sum()
    assert press == pytest.approx(DENSITY * G * volume, rel=0.01)


def test_force_on_particles_moves_the_liquid_like_gravity():
    """The distance is exact with few steps: the first step takes half of the acceleration."""
    zone = ZoneForce(place=Region(lower=(-9, -9, -9), upper=(9, 9, 9)), a=(0, 0, -G))
    water, body = block((0, 0, 0), (1, 1, LEVEL), CELLS), block((3, 0, 0), (3.5, 0.5, 0.5), CELLS)
    solver = run(mixed(water, body, DENSITY, walls=(), gravity=0, pushes=[zone]), 10)
    part = solver.model.particles(0)
    fall = solver.model.rest[part, 2].mean() - solver.state.x.numpy()[part, 2].mean()
    assert fall == pytest.approx(G / 2 * (10 / 24) ** 2, rel=1e-3)


def test_heavy_body_sinks_to_the_floor():
    """Its contact with the floor does not depend on the density of the liquid."""
    solver = run(with_block(2.7 * DENSITY, 1.5 * DX, below=0.75, E=1e6), 18)
    lowest = solver.state.x.numpy()[solver.model.particles(1), 2].min() - DX / 4
    assert abs(lowest) < 0.2 * DX


def with_solid(solid: FreeBody, mixture: bool):
    """A free solid in a tank of water, alone or beside an elastic block."""
    water = block((0, 0, 0), (1, 1, LEVEL), CELLS)
    if mixture:
        return mixed(water, block(*box((0.2, 0.2, 0.8), (4, 4, 4)), CELLS), DENSITY, free=[solid])
    outside = water[solid.measure_depth(water) < 0]
    return liquid(outside, CELLS, [TANK], free=[solid], planes=TANK.sides())


@pytest.mark.parametrize("mixture", [pytest.param(False, marks=pytest.mark.slow), True])
def test_sphere_on_the_floor_is_lifted_like_in_free_water(mixture):
    radius, frames = 0.125, 12
    solid = FreeBody("solid", "sphere", (radius,) * 3, (0.52, 0.5, radius), density=1e6)
    solver = run(with_solid(solid, mixture), 4)
    solver.free.begin()
    lift = run(solver, frames).free.wrenches(frames / 24)[0].force
    assert lift[2] == pytest.approx(DENSITY * G * solid.volume, rel=0.12)
    np.testing.assert_allclose(lift[:2], 0.0, atol=0.02 * lift[2])


@pytest.mark.parametrize(
    ("shape", "mixture"),
    [
        ("sphere", False),
        pytest.param("sphere", True, marks=pytest.mark.slow),
        pytest.param("capsule", False, marks=pytest.mark.slow),
        ("capsule", True),
    ],
)
def test_water_does_not_turn_a_solid_about_an_axis_of_symmetry(mixture, shape):
    """The solid is so light that the smallest torque would make it spin."""
    half = (0.15,) * 3 if shape == "sphere" else (0.3, 0.15, 0.15)
    spin = np.array((2, 0, 0)) if shape == "capsule" else np.zeros(3)
    solid = FreeBody("solid", shape, half, (0.52, 0.47, 0.45), density=10, spin=tuple(spin))
    solver = run(with_solid(solid, mixture), 6)
    turned = rotation_matrices(solver.free.poses()[:, 3:])[0]
    axes = turned if shape == "sphere" else turned[:, :1]
    np.testing.assert_allclose(solver.free.motions()[0, 3:] @ axes, spin @ axes, atol=1e-3)


def test_momentum_of_solid_liquid_and_body_is_conserved():
    """A solid falls on a blob of water that floats in space, next to an elastic block."""
    solid = FreeBody("solid", "sphere", (0.1,) * 3, (0.25, 0.25, 0.62), velocity=(0.5, 0, -2))
    lower, upper = box((0.75, 0.25, 0.25), (4, 4, 4))
    water = block((0, 0, 0), (0.5, 0.5, 0.5), CELLS)
    body = block(lower, upper, CELLS)
    solver = mixed(water, body, 1000.0, gravity=0, walls=(), free=[solid])
    run(solver, 12, fps=48)
    momentum = solver.model.mass.numpy().astype(float) @ solver.state.v.numpy()
    start = solid.mass * np.array(solid.velocity)
    assert momentum[2] < 0.3 * start[2]
    momentum += solid.mass * solver.free.motions()[0, :3]
    np.testing.assert_allclose(momentum, start, atol=0.08 * abs(start[2]))


def test_momentum_of_liquid_and_body_is_conserved():
    lower, upper = box((0.25, 0.25, 0.7), (4, 4, 4))
    body = block(lower, upper, CELLS)
    water = block((0, 0, 0), (0.5, 0.5, 0.5), CELLS)
    solver = mixed(water, body, 1000.0, gravity=0, walls=())
    v = np.zeros((len(water) + len(body), 3))
    v[len(water) :] = (0.5, 0, -2)
    solver.state.v.assign(v)
    mass = solver.model.mass.numpy().astype(float)
    start = mass @ v
    run(solver, 12, fps=48)
    v = solver.state.v.numpy()
    assert (mass[: len(water)] @ v[: len(water)])[2] < 0.2 * start[2]
    np.testing.assert_allclose(mass @ v, start, atol=0.08 * abs(start[2]))


@pytest.mark.slow
def test_ball_that_lands_in_a_pool_is_pushed_by_the_water():
    scene = pool(wrenches=True).replaced({"accuracy.solver": "mpm"})
    clip = Simulation(prepare(ball(), scene, RunContext(threads=1))).run()
    assert clip.report["complete"]
    assert clip.report["balance"]["momentum_gain"] < 0.02
    assert clip.report["balance"]["energy_gain"] < 0.05
    assert clip.report["pairs"]["object_on_pool"]["largest_force"] > 100
    assert clip.report["walls"]["container_z_low"]["largest_force"] > 1000


def test_press_starts_above_all_bodies_not_at_the_surface():
    solver = with_block(0.5 * DENSITY, 0.35, walls=(TANK, Press()))
    press = solver.liquid.walls.all[-2]
    assert press.name == "tank_1"
    highest = solver.state.x.numpy()[:, 2].max()
    assert highest > LEVEL + DX
    assert np.array(press.geometry)[2] == pytest.approx(highest)


def test_run_stops_where_walls_leave_too_little_room():
    press = {"kind": "press", "depth": 0.85, "down": 0.1}
    walls = [*pool().data()["boundaries"], press]
    scene = pool(boundaries=walls, accuracy={"cells": 5})
    report = Simulation(prepare(ball(), scene, RunContext(threads=1))).run().report
    assert not report["complete"]
    assert "too little room for the liquid and the bodies in it" in report["stopped"]


@pytest.mark.slow
def test_liquid_on_a_block_that_fills_its_tank_gains_no_energy():
    """No film lies below such a block, whatever the pressure on its top."""
    block = {"name": "block", "shape": "box", "size": 1.4, "sides": (1.0, 1.0, 0.3)}
    inside = {"lower": (-0.7, -0.7, 0), "upper": (0.7, 0.7, 9)}
    scene = pool(
        accuracy={"cells": 12, "liquid": "projection"},
        object={"on": "block"},
        material={"law": "fluid"},
        objects=[{**block, "material": {"law": "neo_hookean", "density": 700, "E": 1e4}}],
        boundaries=[{"kind": "container", "inside": inside, "friction": 0.0}],
        time={"frames": 3, "fps": 24},
    )
    clip = Simulation(prepare(ball(), scene, RunContext(threads=1))).run()
    assert clip.report["complete"], clip.report["stopped"]
    assert clip.report["balance"]["energy_gain"] < 0.02


def test_liquid_does_not_seep_past_a_block_that_fills_its_tank():
    """The walls are 0.37 cells beyond the lines of the grid."""
    low, width, height = 0.37 * DX, 8 * DX, 4 * DX
    inside = Region(lower=(low, low, low), upper=(low + width, low + width, 1e9))
    water = block((0, 0, height), (width, width, 2 * height), CELLS) + low
    body = block((0, 0, 0), (width, width, height), CELLS) + low
    walls = (Container(inside=inside, contact="slip"),)
    solver = run(mixed(water, body, 0.7 * DENSITY, walls=walls, E=3e4), 24)
    x, speeds = solver.state.x.numpy(), np.linalg.norm(solver.state.v.numpy(), axis=1)
    top = x[len(water) :, 2].max()
    assert (x[: len(water), 2] < top - DX).mean() < 1e-3
    assert speeds.max() < np.sqrt(2 * G * height)


def test_steps_resolve_the_vibration_of_a_body_below_a_liquid():
    solver = with_block(0.7 * DENSITY, 0.0, cells=(16, 16, 3))
    run(solver, 2)
    clock = solver.liquid.clock
    assert 0.02 < clock.period < 0.1
    assert solver.liquid.clock.last_dt <= clock.period / 4


def test_vibration_depends_on_the_size_of_each_body():
    soft = {"law": "neo_hookean", "E": 2e4, "nu": 0.3, "density": 1500, "damping": 10}
    shape = {"shape": "box", "sides": [1, 1, 0.5], "material": soft}
    large = {**shape, "name": "large", "sides": [1, 1, 1], "size": 0.5, "place": [-1, 0]}
    small = {**shape, "name": "small", "size": 0.3, "place": [1, 0]}
    inside = {"lower": [-1.4, -0.7, 0], "upper": [1.4, 0.7, 1e9]}
    data = {"material": {"law": "fluid"}, "accuracy": {"cells": 8, "solver": "mpm"}}
    data["boundaries"] = [{"kind": "ground"}, {"kind": "container", "inside": inside}]
    periods = []
    for objects in ([large, small], [small, large]):
        scene = Scene.from_data({**data, "forces": [{"kind": "gravity"}], "objects": objects})
        simulation = Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1)))
        for _ in range(4):
            simulation.step()
        periods.append(simulation.solver.bodies.period)
    assert periods[0] == pytest.approx(periods[1], rel=1e-2)


@pytest.mark.parametrize("solver", ["mpm", pytest.param("lattice", marks=pytest.mark.slow)])
def test_vibration_depends_on_the_stiffness_profile(solver):
    """A slab under a liquid, which is soft or is softened, limits the same number of steps."""
    inside = {"lower": [-0.7, -0.7, 0], "upper": [0.7, 0.7, 1e9]}
    softer = {"kind": "keyframes", "times": [0, 5], "factors": [0.01, 0.01]}
    limited = []
    for E, changes in ((2e4, {}), (2e6, {"stiffness_profile": softer})):
        soft = {"law": "neo_hookean", "E": E, "nu": 0.3, "density": 1500, "damping": 10}
        slab = {"name": "slab", "shape": "box", "sides": [1, 1, 0.5], "size": 0.5, "material": soft}
        scene = {"material": {"law": "fluid"}, "object": {"on": "slab"}, "objects": [slab]}
        scene |= {"boundaries": [{"kind": "ground"}, {"kind": "container", "inside": inside}]}
        scene |= {"accuracy": {"cells": 8, "solver": solver}, "forces": [{"kind": "gravity"}]}
        declared = Scene.from_data({**scene, **changes})
        simulation = Simulation(prepare(surface_of_ball(100), declared, RunContext(threads=1)))
        for _ in range(12):
            simulation.step()
        limited.append(simulation.solver.liquid.clock.limiters["elastic"])
    assert limited[0] == limited[1] > 0


@pytest.mark.parametrize(("density", "short"), [(0.04, True), (0.06, False)])
def test_steps_resolve_the_vibration_of_a_light_body(density, short):
    solver = run(with_block(density * DENSITY, LEVEL, cells=(6, 6, 6), E=5e3), 1)
    clock = solver.liquid.clock
    assert np.isfinite(clock.light) == short
    assert (clock.last_dt <= clock.light / 8) or not short


@pytest.mark.parametrize(
    ("period", "light", "rest", "steps", "limiter"),
    [
        (0.01, np.inf, 1 / 24, 2, "wave"),
        (0.03, np.inf, 1 / 24, 6, "elastic"),
        (0.06, np.inf, 1 / 24, 3, "elastic"),
        (0.1, np.inf, 1 / 24, 2, "wave"),
        (np.inf, np.inf, 1 / 24, 2, "wave"),
        (np.inf, np.inf, 0.1, 3, "wave"),
        (np.inf, 0.04, 1 / 24, 2, "wave"),
        (np.inf, 0.05, 1 / 24, 7, "elastic"),
        (np.inf, 0.15, 1 / 24, 3, "elastic"),
        (np.inf, 0.17, 1 / 24, 2, "wave"),
        (0.03, 0.15, 1 / 24, 6, "elastic"),
    ],
)
def test_equal_steps_resolve_a_vibration_or_average_it(period, light, rest, steps, limiter):
    model = Model.of(np.full((1, 3), 0.5), [DX**3], [Fluid(density=DENSITY)], dx=DX)
    clock = LiquidClock(model)
    clock.acceleration, clock.period, clock.light = G, period, light
    dt, limit = clock.divide(rest)
    assert dt == pytest.approx(rest / steps)
    assert limit.limiter == limiter


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_mixed_run_repeats_and_resumes_bit_for_bit(threads):
    zone = {"kind": "zone", "a": (2, 0, 0), "place": {"lower": (-2, -2, -2), "upper": (2, 2, 2)}}
    stone = {"name": "stone", "shape": "sphere", "size": 0.4, "lift": 0.4, "place": (0.4, 0.4)}
    scene = pool(forces=[{"kind": "gravity"}, zone])
    scene = scene.replaced({"objects": [scene.objects[0], {**stone, "motion": {"kind": "free"}}]})
    whole = Simulation(prepare(ball(), scene, RunContext(threads=threads)))
    for frame in range(4):
        whole.solver.advance((frame + 1) / 24)
        if frame == 1:
            kept = whole.solver.snapshot()
    other = Simulation(prepare(ball(), scene, RunContext(threads=threads))).solver
    other.restore(kept)
    for frame in range(2, 4):
        other.advance((frame + 1) / 24)
    np.testing.assert_array_equal(other.state.x.numpy(), whole.solver.state.x.numpy())
    np.testing.assert_array_equal(other.free.poses(), whole.solver.free.poses())


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.7])
def test_elastic_cube_floats_within_a_part_of_its_height(ratio):
    solver = run(with_block(ratio * DENSITY, LEVEL - 6 * ratio * DX, cells=(6, 6, 6)), 72)
    depths = [depth(run(solver, 1)) for _ in range(48)]
    assert np.mean(depths) == pytest.approx(6 * ratio, abs=0.03 * 6)


@pytest.mark.slow
def test_stone_presses_on_the_floor_by_weight_minus_buoyancy():
    """The mean acceleration is zero, so the floor carries what the liquid does not."""
    solver = run(with_block(2.5 * DENSITY, 0.1), 48)
    solver.pairs.begin()
    run(solver, 24)
    lift = solver.pairs.wrenches(1.0)[0, 1].force[2]
    assert lift == pytest.approx(DENSITY * G * 75 * DX**3, rel=0.1)
    assert abs(solver.state.v.numpy()[-600:, 2].mean()) < 0.02


def pool_with_cube(solver, E=1e5, density=500, **changes):
    """Return a run of an elastic cube that falls into a pool."""
    soft = {"law": "neo_hookean", "E": E, "nu": 0.3, "density": density, "damping": 10}
    cube = {"name": "cube", "shape": "box", "sides": [1, 1, 1], "size": 0.4, "material": soft}
    inside = {"lower": [-0.7, -0.7, 0], "upper": [0.7, 0.7, 1e9]}
    data = {"material": {"law": "fluid"}, "accuracy": {"cells": 8, "solver": solver}, **changes}
    data["boundaries"] = [{"kind": "ground"}, {"kind": "container", "inside": inside}]
    data |= {"forces": [{"kind": "gravity"}], "objects": [{**cube, "on": "object", "lift": 0.05}]}
    scene = Scene.from_data(data)
    return Simulation(prepare(surface_of_ball(100), scene, RunContext(threads=1)))


@pytest.mark.parametrize("solver", ["mpm", "lattice"])
def test_repeated_frame_halves_the_steps_of_the_liquid(monkeypatch, solver):
    simulation = pool_with_cube(solver)
    simulation.step()
    clock, steps = simulation.solver.liquid.clock, []

    def fail_once():
        steps.append(clock.last_dt)
        return Violation("", ()) if len(steps) == 1 else None

    monkeypatch.setattr(simulation, "after_attempt", fail_once)
    simulation.step()
    assert steps[1] <= steps[0] / 2
    assert clock.ceiling == np.inf


@pytest.mark.slow
def test_stiffness_profile_acts_on_the_coupling_with_a_liquid():
    softer = {"kind": "keyframes", "times": [0, 5], "factors": [0.01, 0.01]}
    soft = pool_with_cube("mpm", 1e3, 20)
    softened = pool_with_cube("mpm", 1e5, 20, stiffness_profile=softer)
    for run in (soft, softened):
        for _ in range(6):
            run.step()
    x = [run.solver.state.x.numpy() for run in (soft, softened)]
    assert np.abs(x[0] - x[1]).max() < 1e-3 * DX
