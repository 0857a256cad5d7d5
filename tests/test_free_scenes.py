"""Freely moving solids in scenes: how they are declared, where their Gaussians are, and runs."""

import numpy as np
import pytest

from phy124 import Live
from phy124.errors import InputError
from phy124.gaussians import Frame, as_objects, quaternions, rotation_matrices
from phy124.io.axes import euler
from phy124.motion.scenery import Scenery
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, bodies, prepare
from support.runs import resumed
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

FREE = {
    "name": "box",
    "shape": "box",
    "size": 0.5,
    "sides": [1, 0.8, 0.6],
    "lift": 0.1,
    "place": [0.0, 0.1],
    "on": "object",
    "turn": [10, 20, 30],
    "spin": [0, 0, 2.0],
    "colour": "tomato",
    "motion": {"kind": "free", "density": 400},
}


def scene(**changes) -> Scene:
    """A drop on a soft ball."""
    quick = {"accuracy": {"cells": 10}, "time.frames": 7, "time.fps": 24, "objects": [FREE]}
    return Scene.named("drop").replaced({**quick, "object.lift": 0, **changes})


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"objects": [{**FREE, "shape": None}]}, "Only shapes follow a motion"),
        ({"objects": [{**FREE, "held": True}]}, "Remove static, held"),
        ({"objects": [{**FREE, "shape": "sphere"}]}, "Make all 3 sides equal"),
        (
            {"objects": [FREE, {**FREE, "name": "more", "place": [3, 0], "on": "floor"}]},
            "between box and more, two freely moving solids, is not computed",
        ),
        ({"object.held": True}, "object is held, and the freely moving solid box would pass"),
        (
            {"objects": [FREE, {"name": "led", "shape": "sphere", "motion": {"kind": "swing"}}]},
            "led follows a path, and the freely moving solid box would pass",
        ),
        ({"boundaries": [{"kind": "sphere"}]}, "pass through the boundary sphere. Use ground"),
        ({"objects": [{**FREE, "motion": {"kind": "free", "density": 0}}]}, "density"),
        ({"forces": [{"kind": "gravity", "object": "box"}]}, "box has no particles, so that"),
    ],
)
def test_obstacles_that_ignore_free_solids_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        scene(**changes)


def test_a_free_solid_is_where_its_gaussians_are():
    two = as_objects({0: ball(50), 1: ball(80)})
    two = two.transform(1.0, np.array([0.5, -0.25, 1.0]))
    (body,) = bodies.make_free(scene(pairs=[{"friction": 0.2}]), two)
    np.testing.assert_allclose(body.place, two.means[two.object_id == 1].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(body.half, [0.25, 0.2, 0.15])
    np.testing.assert_allclose(body.axes, euler((10, 20, 30)), rtol=0, atol=1e-12)
    assert (body.density, body.friction, body.sticky) == (400, 0.2, False)
    declared = scene(boundaries=[{"kind": "ground"}, {"kind": "container"}, {"kind": "press"}])
    assert len(bodies.planes_for_free(declared)) == 1 + 6 + 1
    assert bodies.planes_for_free(scene(objects=[])) == []
    assert scene().with_solids().boundaries == scene().boundaries, "it is no wall"


def test_the_gaussians_of_a_free_solid_turn_with_it():
    two = as_objects({0: ball(50), 1: ball(80)})
    selected = two.object_id == 1
    first, then = quaternions(np.stack([euler((40, 0, 0)), euler((0, 0, 90)) @ euler((40, 0, 0))]))
    start = np.array([[0.1, 0.2, 0.3, *first]])
    poses = [start, np.array([[1.1, 0.2, 0.3, *then]])]
    frame = Frame(1, 0.1, two.select(~selected), velocities=np.zeros((50, 3), np.float32))
    moving = np.array([[0, 0, 1.0, 0, 0, 2.0]])
    whole = Scenery(two, ~selected, free=(1,)).whole(frame, poses, moving)
    arms = two.means[selected] - start[0, :3]
    turned = np.stack([-arms[:, 1], arms[:, 0], arms[:, 2]], axis=1)
    np.testing.assert_allclose(whole.gaussians.means[selected], turned + [1.1, 0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(
        rotation_matrices(whole.gaussians.quats[selected]),
        euler((0, 0, 90)) @ rotation_matrices(two.quats[selected]),
        atol=1e-6,
    )
    rates = np.stack([-2 * turned[:, 1], 2 * turned[:, 0], np.ones(80)], axis=1)
    np.testing.assert_allclose(whole.velocities[selected], rates, atol=1e-5)
    assert np.array_equal(whole.gaussians.means[~selected], two.means[~selected])


def test_one_that_starts_inside_material_is_refused():
    inside = {**FREE, "on": "floor", "place": [0.2, 0.0]}
    with pytest.raises(InputError, match=r"objects = box: it overlaps another object or a wall"):
        Simulation(prepare(ball(400), scene(objects=[inside]), RunContext(threads=1)))


def test_plate_starts_above_bodies_and_free_solids():
    declared = scene(boundaries=[{"kind": "ground"}, {"kind": "press"}])
    setup = prepare(ball(400), declared, RunContext(threads=1))
    solver = Simulation(setup).solver
    plate = declared.boundaries[1]
    box = setup.appearance.gaussians.of_object(1)
    assert plate.geometry(solver.model)[0][2] == pytest.approx(box.means[:, 2].max(), abs=0.02)
    lower = plate.model_copy(update={"object": "object"}).geometry(solver.model)[0][2]
    assert lower == solver.surface.x[:, 2].max() > setup.particles.x[:, 2].max()


def test_one_that_starts_behind_a_wall_is_refused():
    wall = {"kind": "half_space", "point": [0, 0, 1.3], "normal": [0, 0, -1]}
    with pytest.raises(InputError, match=r"objects = box: it starts 0\.\d+ m deep in a wall"):
        Simulation(prepare(ball(400), scene(boundaries=[wall]), RunContext(threads=1)))


@pytest.mark.slow
def test_a_free_solid_falls_rests_is_kept_and_goes_on(tmp_path):
    declared = scene(
        **{"velocities": True, "wrenches": True, "time.sleep": True, "time.frames": 30}
    )
    made = Simulation(prepare(ball(400), declared, RunContext(threads=1)))
    clip = made.run()
    selected = clip.object_id == 1
    report = clip.report
    assert report["complete"] and report["balance"]["momentum_gain"] < 1e-5
    assert "free rigid solid box" in report["effects"]["ran"]
    poses = np.array(report["objects"]["box"]["poses"])
    assert poses.shape == (30, 7) and report["sleep"] is None
    np.testing.assert_allclose(clip.means[:, selected].mean(axis=1), poses[:, :3], atol=1e-5)
    assert report["pairs"]["object_on_box"]["largest_force"] > 20
    # Until a corner may be at the floor, its momentum is what gravity and the ball gave it.
    corner = np.linalg.norm(made.solver.free.all[0].half)
    first = slice(1, int(np.argmax(poses[:, 2] < corner)))
    assert first.stop > 12
    exchanged = (
        np.stack([f.wrenches["object_on_box"].force for f in made.frames[first]]).sum(0) / 24
    )
    seconds = len(made.frames[first]) / 24
    kept = made.solver.free.all[0].mass * made.frames[first][-1].velocities[selected].mean(axis=0)
    weight = made.solver.free.all[0].mass * 9.81 * seconds
    np.testing.assert_allclose(exchanged - [0, 0, weight], kept, atol=0.02 * weight)

    paused = Simulation(prepare(ball(400), declared, RunContext(threads=1)))
    again = resumed(paused, 11, tmp_path / "pause.safetensors").run()
    assert np.array_equal(again.means, clip.means) and np.array_equal(again.quats, clip.quats)
    assert again.report["objects"]["box"]["poses"] == report["objects"]["box"]["poses"]

    live = Live(ball(400), declared, RunContext(threads=1))
    for index in range(12):
        assert np.array_equal(live.step().gaussians.means, clip.means[index])
    np.testing.assert_allclose(live.centres["box"], poses[11, :3])
    assert live.pairs == {"object_on_box": "box"} and "object_on_box" in live.contacts()
    live.push((0.5, 0, 0))
    live.step()
    assert live.centres["box"][2] > 0.1
    with pytest.raises(InputError, match=r"push.object = box: it has no particles to hold"):
        live.push((1, 0, 0), object="box")
