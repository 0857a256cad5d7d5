"""Shapes among the objects that move freely as rigid solids: scenes, clips, reports, live runs."""

import numpy as np
import pytest

from phy124 import Live, resume
from phy124.errors import InputError
from phy124.gaussians import Frame, as_objects, quaternions, rotation_matrices
from phy124.io.axes import euler
from phy124.mpm import FreeBody
from phy124.particles.scenery import Scenery
from phy124.scene import Scene
from phy124.simulation import Simulation, props
from support.shapes import ball

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
        ({"objects": [{**FREE, "held": True}]}, "Leave out static, held"),
        ({"objects": [{**FREE, "shape": "sphere"}]}, "Give 3 equal sides"),
        (
            {"objects": [FREE, {**FREE, "name": "more", "place": [3, 0], "on": "floor"}]},
            "box and more are both free solids, which would pass through each other",
        ),
        ({"object.held": True}, "object is held, and the free solid box would pass through it"),
        (
            {"objects": [FREE, {"name": "led", "shape": "sphere", "motion": {"kind": "swing"}}]},
            "led follows a path, and the free solid box would pass",
        ),
        ({"boundaries": [{"kind": "sphere"}]}, "pass through the boundary sphere. Use ground"),
        ({"objects": [{**FREE, "motion": {"kind": "free", "density": 0}}]}, "density"),
        ({"forces": [{"kind": "gravity", "object": "box"}]}, "no object is called box"),
    ],
)
def test_what_a_free_solid_would_pass_through_is_refused(changes, said):
    with pytest.raises(InputError, match=said):
        scene(**changes)


def test_a_free_solid_is_where_its_gaussians_are():
    two = as_objects({0: ball(50), 1: ball(80)})
    two = two.moved(1.0, np.array([0.5, -0.25, 1.0]))
    (one,) = props.free_bodies(scene(pairs=[{"friction": 0.2}]), two)
    np.testing.assert_allclose(one.place, two.means[two.object_id == 1].mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(one.half, [0.25, 0.2, 0.15])
    np.testing.assert_allclose(one.axes, euler((10, 20, 30)), atol=1e-12)
    assert (one.density, one.friction, one.sticky) == (400, 0.2, False)
    told = scene(boundaries=[{"kind": "ground"}, {"kind": "container"}, {"kind": "press"}])
    assert len(props.planes(told)) == 1 + 6 + 1
    assert props.planes(scene(objects=[])) == []
    assert scene().with_solids().boundaries == scene().boundaries, "it is no wall"


def test_the_gaussians_of_a_free_solid_turn_with_it():
    two = as_objects({0: ball(50), 1: ball(80)})
    own = two.object_id == 1
    first, then = quaternions(np.stack([euler((40, 0, 0)), euler((0, 0, 90)) @ euler((40, 0, 0))]))
    start = np.array([[0.1, 0.2, 0.3, *first]])
    poses = [start, np.array([[1.1, 0.2, 0.3, *then]])]
    frame = Frame(1, 0.1, two.select(~own), velocities=np.zeros((50, 3), np.float32))
    moving = np.array([[0, 0, 1.0, 0, 0, 2.0]])
    whole = Scenery(two, ~own, free=(1,)).whole(frame, poses, moving)
    arms = two.means[own] - start[0, :3]
    turned = np.stack([-arms[:, 1], arms[:, 0], arms[:, 2]], axis=1)
    np.testing.assert_allclose(whole.gaussians.means[own], turned + [1.1, 0.2, 0.3], atol=1e-6)
    np.testing.assert_allclose(
        rotation_matrices(whole.gaussians.quats[own]),
        euler((0, 0, 90)) @ rotation_matrices(two.quats[own]),
        atol=1e-6,
    )
    rates = np.stack([-2 * turned[:, 1], 2 * turned[:, 0], np.ones(80)], axis=1)
    np.testing.assert_allclose(whole.velocities[own], rates, atol=1e-5)
    assert np.array_equal(whole.gaussians.means[~own], two.means[~own])


def test_one_that_starts_inside_material_is_refused():
    inside = {**FREE, "on": "floor", "place": [0.2, 0.0]}
    with pytest.raises(InputError, match=r"objects = box: it overlaps what it would meet at the"):
        Simulation(ball(400), scene(objects=[inside]), threads=1)


@pytest.mark.parametrize("shape", ["sphere", "box", "capsule"])
def test_depth_is_that_below_its_surface(shape):
    half = (0.1, 0.1, 0.3) if shape == "capsule" else (0.2, 0.2, 0.2)
    turn = tuple(quaternions(euler((0, 90, 0))[None])[0].tolist())
    one = FreeBody("one", shape, half, (1.0, 0, 0), turn=turn)
    along = np.array([[1.0, 0, 0], [1.15, 0, 0], [1.4, 0, 0], [1.0, 0, 0.3]])
    deep = {
        "sphere": [0.2, 0.05, -0.2, -0.1],
        "box": [0.2, 0.05, -0.2, -0.1],
        "capsule": [0.1, 0.1, -0.1, -0.2],
    }
    np.testing.assert_allclose(one.depth(along), deep[shape], atol=1e-12)


@pytest.mark.slow
def test_a_free_solid_falls_rests_is_kept_and_goes_on(tmp_path):
    told = scene(**{"velocities": True, "wrenches": True, "time.sleep": True, "time.frames": 30})
    made = Simulation(ball(400), told, threads=1)
    clip = made.run()
    own = clip.object_id == 1
    report = clip.report
    assert report["complete"] and report["balance"]["momentum_gain"] < 1e-5
    assert "free rigid solid box" in report["effects"]["ran"]
    poses = np.array(report["objects"]["box"]["poses"])
    assert poses.shape == (30, 7) and report["sleep"] is None
    np.testing.assert_allclose(clip.means[:, own].mean(axis=1), poses[:, :3], atol=1e-5)
    assert report["pairs"]["object_on_box"]["largest_force"] > 20
    # Until a corner may be at the floor, its momentum is what gravity and the ball gave it.
    corner = np.linalg.norm(made.solver.free.all[0].half)
    first = slice(1, int(np.argmax(poses[:, 2] < corner)))
    assert first.stop > 12
    given = np.stack([f.wrenches["object_on_box"].force for f in made.frames[first]]).sum(0) / 24
    seconds = len(made.frames[first]) / 24
    kept = made.solver.free.all[0].mass * made.frames[first][-1].velocities[own].mean(axis=0)
    weight = made.solver.free.all[0].mass * 9.81 * seconds
    np.testing.assert_allclose(given - [0, 0, weight], kept, atol=0.02 * weight)

    paused = Simulation(ball(400), told, threads=1)
    for _ in range(12):
        paused.step()
    resume.save(paused, tmp_path / "pause.safetensors")
    again = resume.load(tmp_path / "pause.safetensors").run()
    assert np.array_equal(again.means, clip.means) and np.array_equal(again.quats, clip.quats)
    assert again.report["objects"]["box"]["poses"] == report["objects"]["box"]["poses"]

    live = Live(ball(400), told, threads=1)
    for index in range(12):
        assert np.array_equal(live.step().gaussians.means, clip.means[index])
    np.testing.assert_allclose(live.centres["box"], poses[11, :3])
    assert live.pairs == {"object_on_box": "box"} and "object_on_box" in live.contacts()
    live.push((0.5, 0, 0))
    live.step()
    assert live.centres["box"][2] > 0.1
    with pytest.raises(InputError, match=r"push.object = box: it has no particles that a hand"):
        live.push((1, 0, 0), object="box")
