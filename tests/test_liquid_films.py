"""Films of a projected liquid that are thinner than a few cells, and single drops."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.boundaries import Container, HalfSpace
from phy124.kernels.work import WORK
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.stress.liquids import Balance
from support.liquids import FPS, TANK, G, block, field, liquid, run
from support.shapes import ball


@pytest.mark.parametrize(("layer", "offset"), [(0.25, 0.0), (0.5, 0.0), (1.0, 0.37)])
def test_thin_layer_presses_with_its_weight_and_slides(layer, offset):
    x = block((0, 0, 0), (1, 1, 1 / 16), 8)
    x[:, 2] *= 2 * layer
    solver = liquid(x, 8, [TANK], offset=offset)
    solver.model.volume.assign(2 * layer * solver.model.volume.numpy())
    solver.model.mass.assign(2 * layer * solver.model.mass.numpy())
    middle = (np.abs(x[:, :2] - 0.5) < 0.125).all(axis=1)
    v = np.zeros_like(x)
    v[:, 0] = 0.5
    solver.state.v.assign(v)
    run(solver, 4)
    assert solver.state.v.numpy()[middle, 0] == pytest.approx(0.5, rel=0.1)
    before = solver.impulses.wrench("wall_0_z_low").numpy()[2]
    run(solver, 12)
    force = (solver.impulses.wrench("wall_0_z_low").numpy()[2] - before) * FPS / 12
    assert force == pytest.approx(solver.model.mass.numpy().sum() * G, rel=0.06)


@pytest.mark.parametrize("thickness", [1e-4, 1e-3])
def test_film_much_thinner_than_a_cell_runs(thickness):
    sheet = ball()
    means = sheet.means * np.float32([1, 1, thickness])
    sheet = replace(sheet, means=means, scales=np.full_like(sheet.scales, 1e-4))
    scene = Scene.named("water").replaced({"accuracy": {"cells": 16}, "time.frames": 4})
    report = Simulation(prepare(sheet, scene, RunContext(threads=1))).run().report
    assert report["stopped"] is None and report["balance"]["energy_gain"] < 0.01


def test_layer_of_a_cell_rests_in_its_tank():
    cells = 16
    sheet = ball()
    means = np.clip(1.5 * sheet.means, -0.5, 0.5) * np.float32([1, 1, 1 / cells])
    sheet = replace(sheet, means=means, scales=np.full_like(sheet.scales, 1e-4))
    inside = {"lower": (-0.5, -0.5, 0), "upper": (0.5, 0.5, 9)}
    walls = [{"kind": "container", "inside": inside, "friction": 0.0}]
    changes = {"accuracy": {"cells": cells}, "time.frames": 4, "boundaries": walls}
    scene = Scene.named("water").replaced(changes)
    report = Simulation(prepare(sheet, scene, RunContext(threads=1))).run().report
    assert report["stopped"] is None and report["balance"]["energy_gain"] < 0.2


def test_film_and_lone_particle_come_to_rest_on_the_floor():
    for x in (block((0, 0, 0), (1, 1, 1 / 16), 8), np.array([[0.5, 0.5, 0.3]])):
        solver = run(liquid(x, 8, [TANK]), 24)
        x, v = solver.state.x.numpy(), solver.state.v.numpy()
        assert np.abs(v).max() < 1e-3
        assert x[:, 2].min() > 0 and x[:, 2].max() < 0.04


@pytest.mark.parametrize(("contact", "speed"), [("sticky", 0.0), ("slip", 1.0)])
def test_drop_sticks_to_a_sticky_floor(contact, speed):
    solver = liquid(np.array([[0.5, 0.5, 0.01]]), 8, [HalfSpace(contact=contact)])
    solver.state.v.assign(np.array([[1.0, 0.0, 0.0]]))
    run(solver, 3)
    assert solver.state.v.numpy()[0, 0] == pytest.approx(speed, abs=1e-3)


@pytest.mark.parametrize(
    ("height", "tilt", "fall"), [(0.001, 0.0, 0.0), (0.3, 0.0, 0.28), (0.001, 20.0, 0.0)]
)
def test_walls_take_only_the_energy_of_a_fall_from_drops(height, tilt, fall):
    """A film of a hundredth of a cell starts too near the floor, falls, or slides down a slope.

    Heights are in cells.
    """
    tilt = np.radians(tilt)
    normal = (-np.sin(tilt), 0.0, np.cos(tilt))
    x = block((0.25, 0.25, 0), (0.75, 0.75, 1 / 16), 8)
    x[:, 2] = x[:, 0] * np.tan(tilt) + height / 8
    solver = liquid(x, 8, [HalfSpace(point=(0, 0, 0), normal=normal, contact="slip")])
    for array in (solver.model.volume, solver.model.mass):
        array.assign(array.numpy() / 50)
    solver.start()
    assert (solver.state.x.numpy() @ normal).min() > 0.019 / 8
    run(solver, 12)
    work = solver.impulses.total.numpy()[0, WORK]
    weight = solver.model.total_mass * G
    assert work == pytest.approx(-weight * fall / 8, rel=0.1, abs=1e-5 * weight / 8)


def test_film_of_a_sixth_of_a_cell_spreads_like_shallow_water():
    """Ritter's dam break; 2 % of the water is in front of each of the measured ends."""
    thick, frames = 0.01, 36
    x = block((0, 0, 0), (1, 1, 1 / 32), 16)
    x[:, 2] = thick / 2
    solver = liquid(x, 16, [HalfSpace(contact="slip")], offset=0.75)
    for array in (solver.model.volume, solver.model.mass):
        array.assign(array.numpy() * 32 * thick)
    run(solver, frames)
    wave = np.sqrt(G * thick) * frames / FPS
    front = 0.5 + wave * (2 - (27 * 0.02 / wave) ** (1 / 3))
    ends = np.quantile(solver.state.x.numpy()[:, 0], (0.02, 0.98))
    assert np.ptp(ends) == pytest.approx(2 * front, rel=0.1)


def test_puddle_that_spreads_gains_no_energy():
    """It starts half a cell thick and becomes a film of single drops."""
    x = block((0, 0, 0), (0.5, 0.5, 0.0625), 8)
    floor, balance = HalfSpace(point=(0, 0, 0), normal=(0, 0, 1), contact="slip"), Balance()
    solver = liquid(x, 8, [floor], accumulators=[balance])
    balance.follow(solver)
    for _ in range(24):
        run(solver, 1)
        balance.compare()
    assert balance.energy < 1e-3


@pytest.mark.parametrize("cells", [10, 15, 20, 25])
def test_faces_that_lie_on_a_wall_are_closed(cells):
    """Rounding errors must not open them, so that a tank has the same pressure on both sides."""
    inside = Region(lower=(-0.6, -0.6, 0), upper=(0.6, 0.6, 9))
    walls = Container(inside=inside, contact="slip")
    water = block((-0.6, -0.6, 0), (0.6, 0.6, 0.3), cells)
    solver = run(liquid(water, cells, [walls]), 1)
    x = (solver.cells.low[0] + np.arange(solver.cells.size[0])) / cells
    on_walls = field(solver, "open")[np.isclose(np.abs(x), 0.6)]
    assert on_walls.shape[0] == 2
    assert not on_walls[..., 0].any()
