"""Wrenches: what the object exerts on each wall adds up to all that the walls give."""

import json
import runpy

import numpy as np
import pytest

from phy124.boundaries import Box, Container, Gripper, Ground, base
from phy124.io.clip import Clip
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import IMPULSES, WALL
from phy124.monitor.wrenches import Wrenches, summary, wall_names
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare
from support.pages import ROOT
from support.runs import resumed
from support.shapes import ball, thrown_block

pytestmark = pytest.mark.usefixtures("coarse_solids")

SCENE = {"accuracy": {"cells": 8}, "time.frames": 4, "time.fps": 60.0, "wrenches": True}


@pytest.mark.parametrize("threads", [1, 2])
def test_wrenches_add_up_to_the_change_of_momenta(threads):
    walls, wrenches = [Ground(height=0.0), Box(upper=(0.4, 1, 0.4))], Wrenches()
    solver, external = thrown_block(walls, wrenches, v=(1.0, 0.3, -2.0), threads=threads)
    external.open(solver.clock)
    fps, inputs, before = 20, np.zeros(3), diagnose(solver).angular
    for frame in range(3):
        wrenches.before_attempt()
        solver.advance((frame + 1) / fps)
        result = wrenches.contacts(solver, fps)
        total = external._sum(WALL)[IMPULSES]
        force = sum(wrench.force for wrench in result.values())
        assert np.allclose(-force / fps, total - inputs, rtol=1e-12, atol=1e-12)
        inputs, mass = total, solver.model.mass.numpy()
        middle = mass @ solver.state.x.numpy() / mass.sum()
        torque = sum(wrench.torque for wrench in result.values())
        angular = diagnose(solver).angular
        gained = angular - before
        about_origin = torque + np.cross(middle, force)
        assert np.allclose(
            -about_origin / fps, gained, rtol=1e-9, atol=1e-9 * np.abs(angular).max()
        )
        before = angular
    assert result.keys() == {"ground", "box"}
    assert np.linalg.norm(torque) > 0.01, "it tumbles"
    kept = wrenches.snapshot()
    solver.advance(0.2)
    wrenches.restore(kept)
    again = wrenches.contacts(solver, fps)
    assert np.array_equal(again["box"].force, result["box"].force)


def test_a_body_at_rest_weighs_on_the_ground():
    scene = Scene.named("drop").replaced({**SCENE, "material.damping": 300, "time.frames": 60})
    scene = scene.replaced({"object.lift": 0.0, "object.size": 0.2, "material.E": 2e4})
    clip = Simulation(prepare(ball(400), scene)).run()
    weight = 9.81 * clip.report["mass"]
    assert not clip.wrenches[0].any()
    (force, torque) = clip.frame(59).wrenches["ground"]
    assert force[2] == pytest.approx(-weight, rel=0.01)
    assert np.abs(force[:2]).max() < 0.01 * weight
    assert np.abs(torque).max() < 0.01 * weight * 0.1
    assert clip.report["walls"]["ground"]["last"]["force"] == force.tolist()
    assert clip.report["walls"]["ground"]["largest_force"] >= weight


def test_walls_of_a_boundary_are_distinguished():
    tray = Container(inside=Region(lower=(-1, -1, 0), upper=(1, 1, 1e6)))
    assert tray.part_names() == ["x_low", "x_high", "y_low", "y_high", "z_low"]
    assert Gripper(axis="x").part_names() == ["x_low", "x_high"]
    assert wall_names([Ground(), Box(), Box()]) == ["ground", "box", "box_2"]
    gripper = {"kind": "gripper", "closed": 0.8, "opening": 1.0, "close": 0.1, "thick": 0.5}
    scene = Scene.named("drop").replaced({**SCENE, "boundaries": [gripper], "time.fps": 24.0})
    clip = Simulation(prepare(ball(400), scene)).run()
    assert clip.walls == ("gripper_y_low", "gripper_y_high")
    low, high = clip.wrenches[-1, :, 0, 1]
    assert low < 0 < high, "the ball pushes the pads apart"
    assert abs(low + high) < 0.2 * high


def test_container_without_walls_has_no_wrenches():
    sides = {"kind": "container", "inside": {"lower": [-1e9] * 3, "upper": [1e9] * 3}}
    changes = {**SCENE, "boundaries": [sides, {"kind": "ground"}], "accuracy.solver": "mpm"}
    run = Simulation(prepare(ball(300), Scene.named("drop").replaced(changes)))
    run.step()
    assert run.step().wrenches.keys() == {"ground"}


def test_clips_keep_them_and_old_clips_have_none(tmp_path):
    scene = Scene.named("press").replaced(SCENE)
    plain = Simulation(
        prepare(ball(300), scene.replaced({"wrenches": False}), RunContext(threads=1))
    ).run()
    clip = Simulation(prepare(ball(300), scene, RunContext(threads=1))).run()
    assert plain.wrenches is None and plain.walls == () and plain.report["walls"] is None
    assert np.array_equal(plain.means, clip.means) and np.array_equal(plain.scales, clip.scales)
    clip.save(tmp_path / "clip.safetensors")
    loaded = Clip.load(tmp_path / "clip.safetensors")
    assert loaded.walls == ("ground", "press")
    assert np.array_equal(loaded.wrenches, clip.wrenches)
    assert np.array_equal(loaded.surface.wrenches, clip.wrenches)
    plain.save(tmp_path / "plain.safetensors")
    assert Clip.load(tmp_path / "plain.safetensors").frame(1).wrenches is None
    json.dumps(clip.report, allow_nan=False)


def test_a_paused_run_goes_on_with_them(tmp_path):
    scene = Scene.named("press").replaced(SCENE)
    whole = Simulation(prepare(ball(300), scene, RunContext(threads=1))).run()
    run = Simulation(prepare(ball(300), scene, RunContext(threads=1)))
    again = resumed(run, 1, tmp_path / "pause.safetensors").run()
    assert np.array_equal(whole.wrenches, again.wrenches)


def test_without_walls_there_are_none():
    run = Simulation(prepare(ball(300), Scene.named("spin").replaced({**SCENE, "boundaries": []})))
    clip = run.run()
    assert (
        clip.wrenches.shape == (4, 0, 2, 3) and summary(run.frames, run.find(Wrenches).walls) == {}
    )


@pytest.fixture(scope="module")
def pressed_ball():
    return runpy.run_path(str(ROOT / "tests/benchmarks/hertz.py"))


@pytest.mark.slow
@pytest.mark.parametrize("cells", [24, 32])
def test_a_pressed_ball_is_as_stiff_as_finite_elements_say(cells, pressed_ball):
    for depth in pressed_ball["DEPTHS"]:
        assert abs(np.mean(pressed_ball["errors"](cells, depth))) < 0.05


@pytest.mark.slow
def test_fine_grid_wrench_is_right_between_nodes(pressed_ball):
    for depth in pressed_ball["DEPTHS"]:
        assert np.abs(pressed_ball["errors"](48, depth)).max() < 0.041


@pytest.mark.slow
def test_finer_grids_come_closer_to_finite_elements(pressed_ball, monkeypatch):
    def mean(cells):
        return np.mean(pressed_ball["errors"](cells))

    def order():
        return pressed_ball["order"]((16, mean(16)), (44, mean(44)))

    assert 1.5 < order() < 3.5
    monkeypatch.setattr(base, "contact_mass_fraction", lambda model: 0.8)
    assert order() < 1, "walls that are met early hide the other errors"
