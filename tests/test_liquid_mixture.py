"""Liquids of different densities and viscosities in one tank, by pressure projection."""

import numpy as np
import pytest

from phy124.accuracy.expectation import features
from phy124.boundaries import Container, HalfSpace
from phy124.errors import InputError
from phy124.forces import Gravity
from phy124.generators.shapes import ball
from phy124.liquid.mixed import MixedSolver
from phy124.liquid.solver import LiquidSolver
from phy124.materials import Fluid, NeoHookean
from phy124.mpm import Model, State
from phy124.pipeline.resume import load, save
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.liquids import refuse_unprojectable
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from support.liquids import DENSITY, TANK, G, block, field, heights, pool, run

pytestmark = pytest.mark.usefixtures("coarse_solids")

OIL = 0.8 * DENSITY
NARROW = Container(inside=Region(lower=(0, 0, 0), upper=(1, 0.25, 1e9)), contact="slip")


def two_liquids(x, second, densities, *, cells=8, viscosities=(0.0, 0.0), walls=(), g=G, threads=1):
    """Particles of two liquids, with 8 in each cell; `second` says which ones are of the second."""
    order = np.argsort(second, kind="stable")
    x, number = x[order], second[order].astype(int)
    pairs = zip(densities, viscosities, strict=True)
    liquids = [Fluid(density=density, viscosity=viscosity) for density, viscosity in pairs]
    volume = np.full(len(x), 1 / cells**3 / 8)
    model = Model.of(x, volume, liquids, dx=1 / cells, material=number, body=number)
    forces = [Gravity(g=(0, 0, -g))] if g else []
    named = [(f"wall_{index}", wall) for index, wall in enumerate(walls)]
    state = State.of(model)
    return LiquidSolver(model, state, forces=forces, boundaries=named, threads=threads), number


def layers(below, above, walls=(TANK,), depth=1.0, **options):
    """Two layers in a tank, each 0.25 m deep."""
    x = block((0, 0, 0), (1, depth, 0.5), 8)
    return two_liquids(x, x[:, 2] > 0.25, (below, above), walls=walls, **options)


@pytest.mark.parametrize("threads", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_oil_on_water_stays_flat_with_hydrostatic_pressure(threads):
    solver, number = layers(DENSITY, OIL, threads=threads)
    run(solver, 24)
    level = heights(solver)
    assert level.mean() == pytest.approx(0.5, rel=0.005)
    assert np.ptp(level) < 0.05 / 8
    x = solver.state.x.numpy()
    assert (x[number == 0, 2] < 0.26).all() and (x[number == 1, 2] > 0.24).all()
    density = (DENSITY + OIL) / 2  # the reference of the unknown
    pressure = field(solver, "pressure") * density / 8 / solver.clock.last_dt
    bottom = pressure.max(axis=2)[pressure.max(axis=2) > 0]
    exact = G * (OIL * 0.25 + DENSITY * (0.25 - 1 / 16))
    np.testing.assert_allclose(bottom, exact, rtol=0.01)
    impulse = solver.impulses.wrench("wall_0_z_low").numpy()[2]
    duration = solver.clock.time - solver.clock.last_dt / 2
    assert impulse == pytest.approx(solver.model.total_mass * G * duration, rel=0.01)


@pytest.mark.parametrize("below", [DENSITY, OIL])
def test_layer_presses_with_its_weight_on_the_layer_below(below):
    """Two layers of equal density also press on each other."""
    solver, _ = layers(below, OIL)
    run(solver, 6)
    solver.pairs.begin()
    start = solver.clock.time
    force, torque = run(solver, 12).pairs.wrenches(solver.clock.time - start)[0, 1]
    weight = OIL * 0.25 * G
    np.testing.assert_allclose(force, (0, 0, weight), atol=0.06 * weight)
    np.testing.assert_allclose(torque, np.cross((0.5, 0.5, 0.25), force), atol=0.02 * weight)


def test_oil_below_water_rises_and_settles_on_top():
    solver, number = layers(OIL, DENSITY, walls=[NARROW], depth=0.25)
    x, mass = solver.state.x.numpy(), solver.model.mass.numpy().astype(float)
    v = np.zeros_like(x)
    v[:, 2] = 0.2 * np.cos(np.pi * x[:, 0])
    solver.state.v.assign(v)
    start = G * mass @ x[:, 2] + mass @ np.sum(v**2, axis=1) / 2
    run(solver, 9 * 48)
    x, v = solver.state.x.numpy(), solver.state.v.numpy()
    assert G * mass @ x[:, 2] + mass @ np.sum(v**2, axis=1) / 2 < start
    oil, water = x[number == 0, 2], x[number == 1, 2]
    assert np.median(oil) == pytest.approx(0.375, abs=0.04)
    assert np.median(water) == pytest.approx(0.125, abs=0.04)
    assert (np.sum(oil < 0.1875) + np.sum(water > 0.3125)) / len(x) < 0.12
    assert heights(solver).mean() == pytest.approx(0.5, rel=0.01)


def test_colliding_liquids_conserve_momentum():
    x = np.concatenate([block((0, 0, z), (0.5, 0.5, z + 0.5), 8) for z in (0.0, 0.625)])
    solver, number = two_liquids(x, x[:, 2] > 0.5, (DENSITY, 0.5 * DENSITY), g=0)
    v = np.where(number[:, None] == 1, (0.0, 0.0, -2.0), 0.0)
    solver.state.v.assign(v)
    mass = solver.model.mass.numpy().astype(float)
    start = mass @ v
    run(solver, 12)
    v = solver.state.v.numpy()
    assert mass[number == 0] @ v[number == 0, 2] < 0.3 * start[2]
    np.testing.assert_allclose(mass @ v, start, atol=0.03 * abs(start[2]))


def test_liquids_side_by_side_fall_as_their_viscosities_say():
    """Between sticky plates, both halves approach a parabola with the same stress in the middle."""
    g, width, viscosities = 2.0, 0.5, np.array([100.0, 300.0])
    plates = [
        HalfSpace(point=(0, y, 0), normal=(0, sign, 0), contact="sticky")
        for y, sign in ((0.0, 1), (width, -1))
    ]
    sides = Container(inside=Region(lower=(0, -9, -9), upper=(0.125, 9, 9)), contact="slip")
    x = block((0, 0, 0), (0.125, width, 1.5), 16)
    solver, _ = two_liquids(
        x, x[:, 1] > width / 2, (DENSITY, DENSITY), cells=16, viscosities=viscosities,
        walls=[*plates, sides], g=g,
    )  # fmt: skip
    run(solver, 48)
    x, v = solver.state.x.numpy(), solver.state.v.numpy()
    middle = np.abs(x[:, 2] - np.median(x[:, 2])) < 0.2
    half, (a, b) = width / 2, viscosities
    stress = DENSITY * g * half * (1 / a - 1 / b) / (1 / a + 1 / b) / 2
    for place, viscosity, sign in ((half / 2, a, 1), (3 * half / 2, b, -1)):
        y = half / 2  # distance from the plate
        exact = (DENSITY * g * (half * y - y * y / 2) - sign * stress * y) / viscosity
        near = middle & (np.abs(x[:, 1] - place) < 1 / 16)
        assert -v[near, 2].mean() == pytest.approx(exact, rel=0.05)


def test_error_of_two_liquids_is_not_predicted():
    assert "liquids of different densities" in features(Scene.named("oil"))
    assert "liquids of different densities" not in features(Scene.named("water"))


def with_body(density, bottom, cells, oil) -> MixedSolver:
    """A tank with 4 cells of water below 4 cells of oil, and an elastic block in its middle."""
    step = 1 / 16
    low = np.array([(8 - cells[0]) / 2, (8 - cells[1]) / 2, bottom]) * step
    high = low + np.array(cells) * step
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 16)
    x = x[~((x > low) & (x < high)).all(axis=1)]
    parts = [x[x[:, 2] < 0.25], x[x[:, 2] > 0.25], block(low, high, 16)]
    x, number = np.concatenate(parts), np.repeat([0, 1, 2], [len(part) for part in parts])
    materials = [Fluid(density=DENSITY), Fluid(density=oil), NeoHookean(density=density, E=1e5)]
    volume, names = np.full(len(x), step**3 / 8), ["water", "oil", "block"]
    model = Model.of(
        x, volume, materials, dx=step, material=number, body=number, names=names, wet=[0, 1]
    )
    inside = Region(lower=(0, 0, 0), upper=(0.5, 0.5, 1e9))
    pull, walls = [Gravity(g=(0, 0, -G))], Container(inside=inside, contact="slip")
    options = {"forces": pull, "on_liquid": pull, "boundaries": [walls], "walls": [("tank", walls)]}
    return MixedSolver(model, State.of(model), **options, threads=1)


def test_block_between_two_densities_floats_at_the_interface():
    """Half of it is in the water, which fills 64 columns of cells up to (232 + 16) / 64 cells."""
    solver = with_body(0.9 * DENSITY, 2.5, (4, 4, 2), OIL)
    for frame in range(24):
        solver.advance((frame + 1) / 24)
    heights = solver.state.x.numpy()[solver.model.particles(2), 2]
    assert heights.mean() * 16 == pytest.approx(3.875, abs=0.4)


def test_film_below_a_stone_bears_the_weights_of_both_layers():
    solver = with_body(2.5 * DENSITY, 0, (4, 4, 4), 0.5 * DENSITY)
    for frame in range(8):
        solver.advance((frame + 1) / 24)
    bodies = solver.liquid.snapshot()["bodies"]
    film = bodies["films"][0][0][2] / bodies["kick"]
    assert film == pytest.approx(0.75 * DENSITY * G * 0.5 * 0.25**2, rel=0.05)


def test_oil_on_water_may_hold_other_materials_and_a_free_solid():
    data = Scene.named("oil").data()
    stone = {"name": "stone", "shape": "sphere", "size": 0.2, "place": [0.3, 0.0]}
    cork = {**stone, "name": "cork", "lift": 1.0, "motion": {"kind": "free"}}
    data["objects"] = [*data["objects"], {**stone, "material": {"law": "sand"}}, cork]
    data["accuracy"] = {"liquid": "projection"}
    refuse_unprojectable(Scene.from_data(data))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"contacts": True}, r"^contacts = true: "),
        ({"view.outputs": ["force"]}, r"^view.outputs = force: "),
        ({"object.held": True}, r"^object.held = true: "),
        ({"stiffness_profile": {"kind": "sine", "offset": 2.0}}, r"^stiffness_profile = sine: "),
        ({"boundaries": [{"kind": "ground"}, {"kind": "held"}]}, r"^boundaries.1 = held: "),
        (
            {"boundaries": [{"kind": "gripper", "thick": 0.01}]},
            r"^boundaries.gripper = 0.01 m: each pad",
        ),
    ],
)
def test_refusals_of_projection_name_field_and_value(changes, said):
    accuracy = {"cells": 8, "liquid": "projection"}
    scene = Scene.named("water").replaced({"accuracy": accuracy, "time.frames": 1, **changes})
    with pytest.raises(InputError, match=said):
        Simulation(prepare(ball(400), scene, RunContext(threads=1)))


def test_projection_is_declared_for_several_liquids_and_accepts_bound_particles():
    assert Scene.named("oil").projects and len(Scene.named("oil").object_materials) == 2
    with pytest.raises(InputError, match="for one or several liquids"):
        Scene.named("oil").replaced({"accuracy": {"liquid": "foam"}})
    changes = {"accuracy": {"cells": 8, "liquid": "projection"}, "time.frames": 2}
    scene = Scene.named("water").replaced({**changes, "binding": "particles"})
    run = Simulation(prepare(ball(400), scene, RunContext(threads=1)))
    assert run.run().report["complete"] and isinstance(run.solver, LiquidSolver)


def test_mixed_run_with_a_zone_resumes_from_a_file(tmp_path):
    zone = {"kind": "zone", "a": (2, 0, 0), "place": {"lower": (-2, -2, -2), "upper": (2, 2, 2)}}
    scene = pool(material={"law": "sand"}, forces=[{"kind": "gravity"}, zone])
    first = Simulation(prepare(ball(), scene))
    for _ in range(2):  # the first frame takes no step
        first.step()
    save(first, tmp_path / "run.phy124")
    ahead = first.step().gaussians.means
    assert np.array_equal(load(tmp_path / "run.phy124").step().gaussians.means, ahead)


@pytest.mark.parametrize(("name", "projects"), [("object", True), ("pool", False)])
def test_walls_of_a_single_liquid_are_never_dropped(name, projects):
    data = pool().data()
    del data["accuracy"]["liquid"]
    data["boundaries"][0]["object"] = name
    assert Scene.from_data(data).projects == projects
