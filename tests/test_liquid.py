"""Projected liquids: tanks, slopes and closed boxes with known results."""

import numpy as np
import pytest

from phy124.accuracy.probe import run_pilot
from phy124.boundaries import Box, Container, HalfSpace
from phy124.budget.cost import count_substeps
from phy124.budget.effects import Effects
from phy124.budget.remedies import find_speedups
from phy124.errors import InputError
from phy124.forces import Gravity, ZoneForce
from phy124.kernels.liquid.active import make_forget
from phy124.liquid.cells import needed_cells, restrict
from phy124.liquid.solver import LiquidSolver
from phy124.monitor.diagnostics import describe_substep
from phy124.mpm import FreeBody
from phy124.mpm.tracks import Sine
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from support.liquids import DENSITY, FPS, TANK, G, block, field, heights, liquid, run
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_still_tank_keeps_level_and_pressure(offset):
    solver = run(liquid(block((0, 0, 0), (1, 1, 0.5), 8), 8, [TANK], offset=offset), 24)
    level = heights(solver)
    assert level.mean() == pytest.approx(0.5, rel=0.005)
    assert solver.crowding < 0.05
    assert np.ptp(level) < 0.05 * solver.model.dx
    z = solver.model.origin[2] + (solver.cells.low[2] + np.arange(solver.cells.size[2]) + 0.5) / 8
    pressure = field(solver, "pressure") * DENSITY * solver.model.dx / solver.clock.last_dt
    wet = field(solver, "liquid") == 1
    expected = np.broadcast_to(DENSITY * G * (level.mean() - z), wet.shape)
    assert np.abs(pressure - expected)[wet].max() < 0.01 * DENSITY * G * 0.5


@pytest.mark.parametrize("offset", [0.0, 0.25])
def test_floor_carries_the_weight(offset):
    solver = run(liquid(block((0, 0, 0), (1, 1, 0.5), 8), 8, [TANK], offset=offset), 24)
    impulse = solver.impulses.wrench("wall_0_z_low").numpy()
    weight = solver.model.total_mass * G * (solver.clock.time - solver.clock.last_dt / 2)
    assert impulse[2] == pytest.approx(weight, rel=0.01)
    assert impulse[3] == pytest.approx(weight / 2, rel=0.015)  # acts at the tank's middle


@pytest.mark.parametrize("tilt", [pytest.param(5, marks=pytest.mark.slow), 20])
def test_pile_slides_down_a_smooth_slope(tilt):
    """The centroid gains g sin(tilt) t, even if the pile has spread into thin layers."""
    angle, cells = np.radians(tilt), 32
    normal = (-np.sin(angle), 0.0, np.cos(angle))
    along = np.array([-np.cos(angle), 0.0, -np.sin(angle)])
    rotation = np.array([along, [0, 1, 0], normal])
    x = block((-0.25, -0.125, 0.0), (0.25, 0.125, 0.1875), cells) @ rotation
    slope = HalfSpace(point=(0, 0, 0), normal=normal, contact="slip")
    solver = liquid(x, cells, [slope])
    for _ in range(2):
        run(solver, 12)
        duration = solver.clock.time - solver.clock.last_dt / 2
        speed = solver.state.v.numpy().mean(axis=0) @ along
        assert speed == pytest.approx(G * np.sin(angle) * duration, rel=0.01)


def test_immersed_box_is_lifted_by_the_water_that_it_displaces():
    cells, lower, upper = 16, (0.35, 0.35, 0.3), (0.65, 0.65, 0.5)
    x = block((0, 0, 0), (1, 1, 0.375), cells)
    x = x[~((x > lower) & (x < upper)).all(axis=1)]
    solver = liquid(x, cells, [TANK, Box(lower=lower, upper=upper, contact="slip")])
    run(solver, 8)
    before = solver.impulses.wrench("wall_1").numpy()[2]
    run(solver, 8)
    force = (before - solver.impulses.wrench("wall_1").numpy()[2]) * FPS / 8
    depth = np.median(heights(solver)) - lower[2]
    assert force == pytest.approx(DENSITY * G * 0.3**2 * depth, rel=0.05)


def floating(density: float, bottom: float, threads: int = 1, **options) -> LiquidSolver:
    """A flat block of some density in a tank whose water is 0.4 m deep, 16 cells per metre."""
    half, cells = (0.15, 0.15, 0.075), 16
    body = FreeBody("block", "box", half, (0.5, 0.5, bottom + half[2]), density=density)
    x = block((0, 0, 0), (1, 1, 0.4), cells)
    x = x[(np.abs(x - body.place) >= half).any(axis=1)]
    options |= {"free": [body], "planes": TANK.sides(), "threads": threads}
    return liquid(x, cells, [TANK], **options)


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_block_of_half_the_density_stays_at_half_its_height(threads):
    solver = run(floating(0.5 * DENSITY, 0.325, threads), 12)
    level = solver.model.total_mass / DENSITY + 0.5 * solver.free.all[0].volume
    depth = level - (solver.free.poses()[0, 2] - 0.075)
    assert depth == pytest.approx(0.075, abs=0.05 * 0.15)
    other = run(floating(0.5 * DENSITY, 0.325, threads), 12)
    np.testing.assert_array_equal(other.free.poses(), solver.free.poses())


def test_block_floats_where_a_zone_adds_to_the_weight_of_water():
    """The zone acts on the water only, so the water seems twice as dense."""
    zone = ZoneForce(place=Region(lower=(-1, -1, -1), upper=(2, 2, 2)), a=(0, 0, -G / 2))
    solver = floating(DENSITY, 0.325, gravity=(0, 0, -G / 2), pushes=[zone])
    level = (solver.model.total_mass + 0.5 * solver.free.all[0].mass) / DENSITY
    heights = [run(solver, 2).free.poses()[0, 2] - 0.075 for _ in range(12)]
    assert level - np.mean(heights) == pytest.approx(0.075, abs=0.05 * 0.15)


@pytest.mark.parametrize("tilt", [0.1, 0.3])
def test_tilted_plank_is_lifted_and_turned_back_by_the_water(tilt):
    """The righting arm of a plank whose sides are vertical at rest is known exactly."""
    cells, half, level, tank = 16, np.array((0.25, 0.125, 0.125)), 0.4, (1, 0.5)
    place, turn = (0.5, 0.25, level), (np.cos(tilt / 2), 0, np.sin(tilt / 2), 0)
    body = FreeBody("plank", "box", tuple(half), place, turn, density=1e9)
    walls = Container(inside=Region(lower=(0, 0, 0), upper=(*tank, 9)), contact="slip")
    x = block((0, 0, 0), (*tank, level), cells)
    solver = liquid(x[body.measure_depth(x) < 0], cells, [walls], free=[body])
    sums = []
    for step in range(12):
        # The plank is so heavy that only its own weight moves it.
        rise = G / FPS / (2 if step == 0 else 1)
        solver.free.put(0, (place, turn, (0, 0, rise), (0, 0, 0)))
        sums.append(np.array(run(solver, 1).free.total(0).numpy()[:6]))
    push = (sums[5] - sums[-1]) * FPS / 6
    torque = push[3:] - np.cross(place, push[:3])
    across, area, c = 2 * half[0], 4 * half[0] * half[1], np.cos(tilt)
    volume = solver.model.total_mass / DENSITY
    height = (volume + area * (half[2] - level / c)) / (np.prod(tank) - area / c)
    draught = (height - level) / c + half[2]
    assert push[2] == pytest.approx(DENSITY * G * area * draught, rel=0.05)
    metacentre = across**2 / (12 * draught) * (1 + np.tan(tilt) ** 2 / 2)
    arm = np.sin(tilt) * (metacentre + draught / 2 - half[2])
    assert -torque[1] / push[2] == pytest.approx(arm, abs=0.15 / cells)


def momentum_errors(height: float, frames: int, **options) -> list[float]:
    """Relative change of the total momentum, after each frame, while a solid hits a blob."""
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 16)
    place = (0.25, 0.25, height)
    body = FreeBody("stone", "sphere", (0.1,) * 3, place, velocity=(0, 0, -2))
    solver = liquid(x, 16, gravity=(0, 0, 0), free=[body], **options)
    start, errors = body.mass * np.array(body.velocity), []
    for _ in range(frames):
        moved = solver.model.mass.numpy() @ run(solver, 1).state.v.numpy()
        total = moved + body.mass * solver.free.motions()[0, :3]
        errors.append(np.linalg.norm(total - start) / np.linalg.norm(start))
    assert moved[2] < 0.1 * start[2]
    return errors


def test_momentum_of_liquid_and_solid_is_conserved():
    """Without walls and gravity, the error depends on the solid's position between grid lines."""
    errors = [momentum_errors(height, 8)[-1] for height in (0.69, 0.7, 0.71, 0.72, 0.73)]
    assert np.sqrt(np.mean(np.square(errors))) < 0.03


def test_momentum_is_conserved_in_short_steps():
    """Faces without pressure must not lose their own momentum once per step."""
    assert max(momentum_errors(0.7, 16, ceiling=1 / (5 * FPS))) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [0.3, 0.5, 0.7])
def test_block_floats_at_the_depth_of_its_density(ratio):
    solver = floating(ratio * DENSITY, 0.4 - ratio * 0.15)
    level = solver.model.total_mass / DENSITY + ratio * solver.free.all[0].volume
    run(solver, 240)
    depths = []
    for _ in range(96):
        run(solver, 1)
        depths.append(level - (solver.free.poses()[0, 2] - 0.075))
    assert np.mean(depths) == pytest.approx(ratio * 0.15, abs=0.03 * 0.15)


@pytest.mark.slow
def test_stone_sinks_to_the_floor():
    solver = run(floating(2.5 * DENSITY, 0.2), 96)
    assert solver.free.poses()[0, 2] == pytest.approx(0.075, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "offset"), [(8, 0.0), (16, 0.0), (16, 0.37)])
def test_tank_keeps_its_level_for_a_minute(cells, offset):
    solver = liquid(block((0, 0, 0), (1, 1, 0.5), cells), cells, [TANK], offset=offset)
    run(solver, 60 * FPS)
    assert heights(solver).mean() == pytest.approx(0.5, rel=0.005)
    assert np.linalg.norm(solver.state.v.numpy(), axis=1).mean() < 0.005


def test_full_box_without_a_surface_stays_still():
    box = Container(inside=Region(lower=(0, 0, 0), upper=(1, 1, 1)), contact="slip")
    x = block((0, 0, 0), (1, 1, 1), 8)
    solver = run(liquid(x, 8, [box]), 12)
    assert np.abs(solver.state.v.numpy()).max() < 1e-3
    assert np.abs(solver.state.x.numpy() - x).max() < 0.01 * solver.model.dx


def test_solver_may_advance_to_the_time_it_has():
    solver = liquid(block((0, 0, 0), (0.25, 0.25, 0.25), 8), 8)
    solver.advance(0.0)
    assert solver.clock.time == solver.crowding == 0.0


def test_liquid_without_walls_falls_freely():
    solver = run(liquid(block((0, 0, 0), (0.5, 0.5, 0.5), 8), 8), 12)
    duration = solver.clock.time - solver.clock.last_dt / 2
    np.testing.assert_allclose(solver.state.v.numpy()[:, 2], -G * duration, rtol=1e-4)


def test_window_of_a_wide_sheet_keeps_most_of_it(rng):
    sheet = rng.uniform((-5, -4, 0), (5, 4, 0.1), (10000, 3))
    lower, upper, outside = restrict(sheet, 0.1, 1e5)
    sides = needed_cells(lower, upper, 0.1)
    assert 0.99e5 < sides.prod() <= 1.0001e5
    assert sides[0] == pytest.approx(sides[1]) and sides[2] == pytest.approx(21, abs=0.1)
    assert outside / 10000 == pytest.approx(1 - (0.1 * sides[0]) ** 2 / 80, abs=0.03)


def test_particles_outside_the_largest_window_are_counted_and_fall(monkeypatch):
    monkeypatch.setattr("phy124.liquid.solver.MOST_CELLS", 20000)
    assert run(liquid(block((0, 0, 0), (0.5, 0.5, 0.5), 8), 8), 2).outliers.most == 0
    x = block((-3, -3, 0), (3, 3, 0.125), 8)
    solver, other = liquid(x, 8), liquid(x, 8)
    run(solver, 2)
    assert solver.cells.count < 25000
    assert 0.2 < solver.outliers.most / len(x) < 0.8
    other.restore(solver.snapshot())
    assert other.outliers.most == solver.outliers.most
    duration = solver.clock.time - solver.clock.last_dt / 2
    np.testing.assert_allclose(solver.state.v.numpy()[:, 2], -G * duration, rtol=1e-4)


@pytest.mark.parametrize("threads", [1, 2])
def test_liquid_repeats_and_resumes_bit_for_bit(threads):
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 8)

    def end(pause: int | None) -> np.ndarray:
        solver = liquid(x, 8, [TANK], threads=threads)
        if pause is None:
            return run(solver, 12).state.x.numpy()
        run(solver, pause)
        other = liquid(x, 8, [TANK], threads=threads)
        other.restore(solver.snapshot())
        return run(other, 12 - pause).state.x.numpy()

    whole = end(None)
    np.testing.assert_array_equal(end(None), whole)
    np.testing.assert_array_equal(end(5), whole)


def test_simd_and_plain_transfers_agree(rng):
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 8)
    x += rng.uniform(-0.02, 0.02, x.shape)
    simd, plain = (run(liquid(x, 8, [TANK], simd=form), 8) for form in (True, False))
    assert plain.model.form == "plain"
    np.testing.assert_allclose(simd.state.x.numpy(), plain.state.x.numpy(), atol=1e-4)
    np.testing.assert_allclose(simd.state.C.numpy(), plain.state.C.numpy(), atol=0.05)


def test_native_and_plain_conjugate_gradients_agree(monkeypatch):
    def end(form):
        monkeypatch.setattr("phy124.liquid.projection.form_on", lambda device: form)
        solver = run(floating(0.5 * DENSITY, 0.325), 8)
        return solver.state.x.numpy(), solver.free.poses()

    for native, plain in zip(end("native"), end("plain"), strict=True):
        np.testing.assert_allclose(native, plain, atol=1e-6)


@pytest.mark.parametrize("form", ["plain", "native"])
def test_iterations_after_an_exact_solution_change_nothing(form, monkeypatch):
    """A GPU takes up to eight iterations before it checks the residual."""
    monkeypatch.setattr("phy124.liquid.projection.form_on", lambda device: form)
    solver = run(liquid(block((0, 0, 0), (0.5, 0.5, 0.5), 8), 8, gravity=(0, 0, 0)), 1)
    solver.cells.right.zero_()
    solver.cells.pressure.zero_()
    begin = solver._phases.group("pressure")[0]
    for phase in range(7):
        solver.runner.run(begin + phase)
    assert not solver.cells.pressure.numpy().any()


def test_only_cells_near_particles_are_active():
    solver = run(liquid(block((0, 0, 0), (0.5, 0.5, 0.5), 8), 8), 6)
    cells, x = solver.cells, solver.state.x.numpy()
    active = cells.active.numpy()[: cells.ends.numpy()[-1]]
    assert np.all(np.diff(active) > 0)
    assert len(active) <= 14**3 < cells.count
    at = np.floor((x - np.array(solver.model.origin)) * 8).astype(int) - cells.low
    assert np.isin(np.ravel_multi_index(at.T, cells.size), active).all()


def test_launch_over_cells_has_a_thread_for_each_active_cell():
    solver = run(liquid(block((0, 0, 0), (0.5, 0.5, 0.5), 8), 8), 2)
    cells = solver.cells
    outputs = [cells.phi, cells.known, cells.also, cells.liquid]
    launch = cells.record(0, make_forget(solver.model.real), [], outputs)
    launch.launch()
    assert launch.recorded.bounds.size == cells.ends.numpy()[-1] < cells.count
    assert not cells.liquid.numpy().any()


def test_vortex_in_a_box_decays_by_viscosity():
    """The speed of a Taylor-Green vortex decays with exp(-2 pi^2 nu t)."""
    cells, nu = 16, 0.05
    box = Container(inside=Region(lower=(0, 0, 0), upper=(1, 0.25, 1)), contact="slip")
    x = block((0, 0, 0), (1, 0.25, 1), cells)
    a, b = np.pi * x[:, 0], np.pi * x[:, 2]
    v = 0.2 * np.stack([np.sin(a) * np.cos(b), 0 * a, -np.cos(a) * np.sin(b)], axis=1)
    speeds = []
    for viscosity in (0.0, nu * DENSITY):
        solver = liquid(x, cells, [box], gravity=(0, 0, 0), viscosity=viscosity)
        solver.state.v.assign(v.astype(np.float32))
        run(solver, 24)
        speeds.append(np.linalg.norm(solver.state.v.numpy()))
    assert speeds[1] / speeds[0] == pytest.approx(np.exp(-2 * np.pi**2 * nu * 0.5), rel=0.03)


def test_viscous_liquid_falls_slowly_between_sticky_plates():
    """A long slab approaches the parabola g y (H - y) / (2 nu) (Batchelor 1967, 4.3.12)."""
    cells, nu, g, width = 16, 0.1, 2.0, 0.5
    plates = [
        HalfSpace(point=(0, y, 0), normal=(0, sign, 0), contact="sticky")
        for y, sign in ((0.0, 1), (width, -1))
    ]
    x = block((0, 0, 0), (0.25, width, 1.5), cells)
    sides = Container(inside=Region(lower=(0, -9, -9), upper=(0.25, 9, 9)), contact="slip")
    solver = liquid(x, cells, [*plates, sides], gravity=(0, 0, -g), viscosity=nu * DENSITY)
    run(solver, 24)
    x, v = solver.state.x.numpy(), solver.state.v.numpy()
    middle = (np.abs(x[:, 2] - x[:, 2].mean()) < 0.2) & (np.abs(x[:, 1] - width / 2) < 0.05)
    time = solver.clock.time - solver.clock.last_dt / 2
    k = np.arange(1, 20, 2)
    decay = np.exp(-((k * np.pi / width) ** 2) * nu * time)
    shape = np.sin(k * np.pi / 2)
    exact = 4 * g * width**2 / (np.pi**3 * nu) * np.sum(shape / k**3 * (1 - decay))
    assert -v[middle, 2].mean() == pytest.approx(exact, rel=0.05)


def test_two_threads_agree_with_one():
    x = block((0, 0, 0), (0.5, 0.5, 0.5), 8)
    single, two = (run(liquid(x, 8, [TANK], threads=n), 8).state.x.numpy() for n in (1, 2))
    np.testing.assert_allclose(single, two, atol=1e-3)


def test_projected_water_lands_in_its_basin():
    changes = {"accuracy": {"cells": 8, "liquid": "projection"}, "time.frames": 12}
    scene = Scene.named("water").replaced({**changes, "wrenches": True})
    clip = Simulation(prepare(ball(), scene, RunContext(threads=1))).run()
    assert clip.report["complete"]
    assert clip.report["substeps"] < 60
    assert clip.report["walls"]["container_z_low"]["largest_force"] > 0


def test_crowded_liquid_rises_before_the_first_step():
    x = block((0, 0, 0), (1, 1, 0.5), 8)
    x[:, 2] *= 0.97
    solver = liquid(x, 8, [TANK])
    solver.start()
    settled = solver.state.x.numpy()[:, 2].mean()
    assert settled == pytest.approx(0.25, abs=0.01 / 8)
    assert not solver.state.v.numpy().any()
    run(solver, 4)
    assert solver.state.x.numpy()[:, 2].mean() == pytest.approx(settled, abs=0.01 / 8)


def test_effects_say_that_a_projected_liquid_is_inviscid():
    scene = Scene.named("water").replaced({"accuracy": {"liquid": "projection"}})
    effects = Effects.of(scene)
    assert "pressure projection" in effects.ran
    reasons = {omission.name: omission.why for omission in effects.left_out}
    assert "inviscid" in reasons["viscosity"] and "surface tension" in reasons


def test_liquid_that_an_impact_compresses_is_not_crowded():
    x = block((0.25, 0.25, 0.2), (0.5, 0.5, 0.45), 8)
    drop = liquid(x, 8, [TANK])
    drop.state.v.assign(np.tile(np.float32([0, 0, -3]), (len(x), 1)))
    box = Container(inside=Region(lower=(0, 0, 0), upper=(1, 1, 1)), contact="slip")
    layer = liquid(block((0, 0, 0), (1, 1, 0.4), 8), 8, [box], gravity=(0, 0, 60))
    for solver, most in ((drop, 0.05), (layer, 0.1)):
        for frame in range(20):
            solver.advance((frame + 1) / 24)
        assert solver.lasting < most


@pytest.mark.slow
def test_shaken_box_keeps_its_volume():
    """Near its first sloshing mode for 20 s, then calm for 6 s."""
    cells, box = 16, Container(inside=Region(lower=(0, 0, 0), upper=(1, 1, 1)), contact="slip")
    shakes = [
        Gravity(),
        Gravity(g=(3, 0, 0), profile=Sine(frequency=0.85), end=20.0),
        Gravity(g=(0, 0, 4), profile=Sine(frequency=1.7), end=20.0),
    ]
    solver = liquid(block((0, 0, 0), (1, 1, 0.5), cells), cells, [box], gravity=(0, 0, 0))
    solver.bind(forces=shakes, boundaries=[("box", box)])
    volumes = []
    for step in range(26 * FPS):
        run(solver, 1)
        if step % 24 == 23:
            phi, solid = field(solver, "phi"), field(solver, "shares")[..., 0]
            wet = np.clip(0.5 - phi, 0, 1) * (1 - np.minimum(solid, 1))
            volumes.append(wet.sum() * solver.model.dx**3 / 0.5)
    assert np.abs(np.array(volumes) - 1).max() < 0.02
    assert np.mean(volumes[-8:]) == pytest.approx(1, abs=0.005)


@pytest.mark.parametrize(
    ("preset", "changes", "reason"),
    [
        ("water", {}, ""),
        ("lava", {"accuracy": "draft"}, ""),
        ("oil", {}, ""),
        ("water", {"contacts": True}, "forces of walls on single particles"),
        ("water", {"accuracy.transfer": "xpic2"}, "accuracy.transfer is xpic2"),
        ("water", {"binding": "particles"}, "binding is particles"),
        ("water", {"accuracy.liquid": "compressible"}, "accuracy.liquid is compressible"),
    ],
)
def test_liquids_are_projected_unless_the_report_says_why_not(preset, changes, reason):
    scene = Scene.named(preset).replaced(changes)
    effects = Effects.of(scene)
    assert scene.projects == ("pressure projection" in effects.ran) == (not reason)
    why = {omission.name: omission.why for omission in effects.left_out}
    assert reason in why.get("pressure projection", "")


def test_estimate_counts_the_steps_of_a_projected_liquid():
    scene = Scene.named("water")
    compressible = scene.replaced({"accuracy.liquid": "compressible"})
    assert 47 <= count_substeps(scene) <= 200 < count_substeps(compressible)


def test_projection_refuses_what_it_cannot_compute():
    changes = {"accuracy": {"liquid": "projection"}, "contacts": True}
    with pytest.raises(InputError, match=r"liquid = compressible") as error:
        prepare(ball(), Scene.named("water").replaced(changes))
    assert error.value.field == "contacts"


def test_slow_liquid_is_described_with_a_remedy():
    solver = run(liquid(block((0, 0, 0), (1, 1, 0.25), 8), 8, [TANK]), 1)
    assert solver.clock.stable().limiter == "wave"
    sentence = describe_substep(solver.model, solver.state, solver.clock)
    assert "limited by the waves on its surface" in sentence
    assert find_speedups(Scene.named("water"), "wave", 0.5)


def test_pilot_counts_the_steps_that_waves_limit():
    changes = {"accuracy": {"cells": 8, "liquid": "projection"}, "time.frames": 4}
    steps, limiters = run_pilot(ball(), Scene.named("water").replaced(changes)).substeps(8)
    assert steps >= 3
    assert limiters["wave"] > 0


@pytest.mark.parametrize("threads", [1, 2])
def test_force_on_particles_presses_the_floor_like_gravity(threads):
    zone = ZoneForce(place=Region(lower=(-1, -1, -1), upper=(2, 2, 2)), a=(0, 0, -G / 2))
    x, presses = block((0, 0, 0), (1, 1, 0.5), 8), []
    for pushes in ([zone], [Gravity(g=(0, 0, -G / 2))]):
        solver = run(
            liquid(x, 8, [TANK], gravity=(0, 0, -G / 2), pushes=pushes, threads=threads), 4
        )
        presses.append(solver.impulses.wrench("wall_0_z_low").numpy())
    weight = solver.model.total_mass * G * (solver.clock.time - solver.clock.last_dt / 2)
    assert presses[0][2] == pytest.approx(weight, rel=0.005)
    assert presses[0] == pytest.approx(presses[1], rel=1e-4, abs=1e-4 * weight)
