"""Several objects in one scene: how they are declared, made, placed, kept and written."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from phy124 import Live, pipeline
from phy124.errors import InputError
from phy124.gaussians import Frame, as_objects
from phy124.generators.shapes import make_shape
from phy124.io.clip import Clip
from phy124.io.formats.usd import write_usd
from phy124.io.ply import read_ply, write_ply
from phy124.monitor.tearing import Pieces
from phy124.monitor.watchdog import Watchdog
from phy124.motion.deform import Deformer
from phy124.motion.scenery import Scenery
from phy124.particles import Particles, compute_bounds
from phy124.runtime.context import RunContext
from phy124.scene import Pair, Scene
from phy124.scene.objects import find_pair
from phy124.simulation import Simulation, prepare
from phy124.simulation.bodies import notes
from support.clips import random_clip
from support.pages import blocks
from support.runs import resumed
from support.shapes import ball
from support.solids import coarse

pytestmark = pytest.mark.usefixtures("coarse_solids")

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BOX = {"name": "box", "shape": "box", "size": 1.2, "sides": [1, 1, 0.4], "place": [0, 2]}
ON_BOX = {"object.on": "box", "object.name": "ball", "objects": [{**BOX, "place": [0, 0]}]}
QUICK = {"accuracy": {"cells": 8}, "time.frames": 3, "time.fps": 48}


def scene(**changes) -> Scene:
    """Some quick drop."""
    return Scene.named("drop").replaced({**QUICK, **changes})


@pytest.fixture(scope="module", autouse=True)
def few_gaussians():
    """Shapes have fewer Gaussians than usual, which takes less time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phy124.generators.shapes.COUNT", 1000)
        yield


@pytest.fixture(scope="module")
def run(few_gaussians) -> Simulation:
    """A ball on a box, and a smaller copy on it."""
    copy = {"name": "copy", "on": "ball", "size": 0.6, "material": {"law": "neo_hookean"}}
    objects = [*ON_BOX["objects"], copy]
    with coarse():
        made = Simulation(
            prepare(ball(400), scene(**{**ON_BOX, "objects": objects}), RunContext(threads=1))
        )
        made.run()
    return made


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"objects": [{"name": "object"}]}, "two objects are called object. Give them different"),
        ({"objects": [{"name": "any"}]}, "no object can be called any"),
        ({"objects": [{"name": "a b"}]}, "objects.0.name = a b: it must be text"),
        ({"objects": [{}]}, "objects.0.name = nothing: it is required"),
        ({"objects": [{"name": "a", "on": "b"}]}, "no object is called b. There are floor, "),
        ({"object": {"on": "object"}}, "in a circle (object on object)"),
        (
            {"object": {"on": "b"}, "objects": [{"name": "b", "shape": "box", "on": "object"}]},
            "(object on b on object)",
        ),
        ({"objects": [{**BOX, "picture": "a.png"}]}, "box has picture and shape. Give one of them"),
        ({"pairs": [{"between": ["object", "cat"]}]}, "no object is called cat. There are object"),
        ({"pairs": [{"between": ["object", "object"]}]}, "`between` names object twice"),
        (
            {
                "objects": [{**BOX, "motion": {"kind": "free"}}],
                "pairs": [{"between": ["box", "object"]}],
            },
            "moved shape box is the same with every object. Use between = ['box', 'any']",
        ),
        ({"pairs": [{}, {"friction": 0}]}, "two entries of `pairs` are for any and any"),
        ({"forces": [{"kind": "gravity", "object": "cat"}]}, "no object is called cat"),
    ],
)
def test_impossible_objects_are_refused_in_a_sentence(data, said):
    with pytest.raises(InputError) as refused:
        Scene.from_data(data)
    assert said in str(refused.value)


def test_scene_of_a_single_object_has_the_short_form():
    plain = Scene.named("drop")
    assert set(plain.data()["object"]) == {"size", "lift", "velocity", "spin"}
    assert not {"objects", "pairs"} & plain.data().keys()
    assert "object" not in plain.data()["forces"][0]
    several = scene(**ON_BOX, pairs=[{"friction": 0.2}])
    assert Scene.from_data(several.data()) == several


def test_the_entry_that_names_most_decides_about_a_pair():
    some = [Pair(friction=0.1), Pair(between=("a", "any"), friction=0.2)]
    some.append(Pair(between=("b", "a"), contact="sticky"))
    result = [find_pair(some, *two) for two in (("a", "b"), ("c", "a"), ("b", "c"))]
    assert result == [some[2], some[1], some[0]]
    assert find_pair([], "a", "b").friction == 0.5


@pytest.mark.parametrize("name", ["sphere", "box", "capsule"])
def test_shape_has_its_size_and_faces_outwards(name):
    made = make_shape(name, (0.5, 1.0, 0.5), (1, 0, 0))
    low, high = compute_bounds(made)
    assert np.allclose(high, [0.25, 0.5, 0.25], atol=0.02) and np.allclose(low, -high, atol=0.02)
    assert 900 < len(made) < 1300
    assert made.rgb[:, 0].mean() > 0.6 and made.rgb[:, 1:].max() == 0


def test_objects_stand_at_their_places(run):
    middle, box, copy = (run.setup.gaussians.of_object(index) for index in range(3))
    assert compute_bounds(box)[0][2] == pytest.approx(0, abs=0.01)
    assert compute_bounds(middle)[0][2] == pytest.approx(compute_bounds(box)[1][2] + 0.3, abs=0.03)
    assert compute_bounds(copy)[0][2] == pytest.approx(compute_bounds(middle)[1][2], abs=0.03)
    beside = scene(objects=[{**BOX, "turn": [0, 90, 0]}])
    turned = prepare(ball(400), beside, RunContext(threads=1)).gaussians.of_object(1)
    low, high = compute_bounds(turned)
    assert (low + high)[:2] / 2 == pytest.approx([0, 2], abs=0.01)
    assert high - low == pytest.approx([0.48, 1.2, 1.2], abs=0.03)


def test_every_gaussian_knows_its_object(run, tmp_path):
    clip = run.clip()
    assert clip.objects == ("ball", "box", "copy")
    assert np.array_equal(np.unique(clip.object_id), [0, 1, 2])
    clip.save(tmp_path / "c.safetensors")
    again = Clip.load(tmp_path / "c.safetensors")
    assert again.objects == clip.objects and np.array_equal(again.object_id, clip.object_id)
    write_ply(tmp_path / "f.ply", again.frame(1).gaussians)
    assert np.array_equal(read_ply(tmp_path / "f.ply").gaussians.object_id, clip.object_id)
    entry = clip.report["objects"]
    assert [item["gaussians"] for item in entry.values()] == np.bincount(clip.object_id).tolist()
    assert sum(item["particles"] for item in entry.values()) == clip.report["particles"]
    assert entry["copy"]["place"][2] > entry["ball"]["place"][2] > entry["box"]["place"][2]


def test_particles_are_sorted_by_object(run):
    body = run.setup.particles.body
    assert np.all(np.diff(body) >= 0)
    for index in range(3):
        members, x = run.setup.gaussians.of_object(index), run.setup.particles.x[body == index]
        assert np.all(x.min(axis=0) > compute_bounds(members)[0] - 0.1)
        assert np.all(x.max(axis=0) < compute_bounds(members)[1] + 0.1)


def test_run_of_several_objects_resumes_unchanged(run, tmp_path):
    half = Simulation(prepare(run.setup.source, run.scene, RunContext(threads=1)))
    again = resumed(half, 0, tmp_path / "pause").run()
    assert np.array_equal(again.means, run.clip().means)
    assert np.array_equal(again.object_id, run.clip().object_id)


def test_gaussians_move_with_their_own_object_only():
    """Two that touch, of which one leaves: none of the other's Gaussians goes with it."""
    sides = [ball(200).transform(1.0, np.array([x, 0, 0])) for x in (-0.5, 0.5)]
    both = as_objects(dict(enumerate(sides)))
    x = both.means
    particles = Particles(
        x, np.ones(400), np.ones(400), np.zeros(400, np.int32), np.full(400, -1), both.object_id
    )
    carry = Deformer(both, particles)
    apart = x + np.where(both.object_id[:, None] == 1, [3.0, 0, 0], 0.0)
    frame = carry(apart, np.tile(np.eye(3), (400, 1, 1)), index=1, time=0.1)
    assert np.allclose(frame.gaussians.means, apart, atol=1e-6)
    single = Deformer(replace(both, object_id=None), replace(particles, body=None))
    mixed = single(apart, np.tile(np.eye(3), (400, 1, 1)), index=1, time=0.1)
    assert np.abs(mixed.gaussians.means - apart).max() > 0.5


def test_separating_objects_are_not_torn():
    x = np.random.default_rng(0).uniform(0, 1, (2000, 3))
    body = (x[:, 0] > 0.5).astype(int)
    apart = x + np.where(body[:, None] == 1, [2.0, 0, 0], 0.0)
    assert Pieces(x, 0.15, body).loose(apart) == 0
    assert Pieces(x, 0.15).loose(apart) > 500
    one_torn = np.where((x[:, :1] > 0.75), x + [0, 3.0, 0], x)
    assert Pieces(x, 0.15, body).loose(one_torn) > 300


def test_scenery_is_seen_and_has_no_particles():
    run = Simulation(
        prepare(ball(400), scene(objects=[{**BOX, "static": True}]), RunContext(threads=1))
    )
    clip = run.run()
    assert clip.report["objects"]["box"]["particles"] == 0
    selected = clip.object_id == 1
    assert selected.any() and np.array_equal(clip.means[-1][selected], clip.means[0][selected])


def test_overlapping_objects_are_refused_by_name():
    with pytest.raises(InputError, match=r"object and box: they overlap .* by about 0\.\d+ m"):
        Simulation(prepare(ball(400), scene(objects=[{**BOX, "place": [0, 0.3]}])))


@pytest.mark.parametrize("sides", [[1, 1, 0.01], [1, 0.02, 0.02]])
def test_thin_object_inside_another_is_refused(sides):
    """The sheet and the rod are thinner than a cell, so they share at most a layer of cells."""
    thin = {**BOX, "sides": sides, "size": 0.6, "place": [0, 0]}
    for lift in (0.6, 0.85):
        inside = scene(objects=[{**thin, "lift": lift}])
        with pytest.raises(InputError, match=r"overlap at the start: \d+% of one of them"):
            prepare(ball(400), inside, RunContext(threads=1))


def test_adjacent_object_does_not_stand_on_the_other():
    with pytest.raises(InputError, match=r"objects.0.on = object: it is not above the object"):
        Simulation(
            prepare(ball(400), scene(objects=[{"name": "copy", "on": "object", "place": [0, 3]}]))
        )


def test_a_small_object_is_noted():
    assert notes(scene(objects=[BOX])) == []
    (note,) = notes(scene(objects=[{**BOX, "size": 0.6}]))
    assert note.startswith(
        "box is 5 cells long, which is coarse: the grid spacing follows from the size of obj"
    )


def test_each_object_is_made_from_its_own_file(tmp_path):
    write_ply(tmp_path / "first.ply", ball(300))
    write_ply(tmp_path / "second.ply", ball(500))
    waiting = scene(objects=[{"name": "copy", "place": [0, 2]}])
    single, two = tmp_path / "first.ply", tmp_path / "second.ply"
    alone = pipeline.make_gaussians(single, waiting, generator=str(single)).gaussians
    assert np.array_equal(np.unique(alone.object_id), [0])
    both = pipeline.make_gaussians([single, two], waiting, generator=str(single)).gaussians
    assert np.bincount(both.object_id).tolist() == [300, 500]
    named = scene(objects=[{"name": "copy", "place": [0, 2], "file": str(two)}])
    made = pipeline.make_gaussians(single, named, generator=str(single))
    assert len(made.gaussians) == 800 and made.about["sources"]["copy"]["source"] == "second.ply"
    with pytest.raises(InputError, match=r"takes one picture. .*collide, stack"):
        pipeline.make_gaussians([single, two], scene(), generator=str(single))
    with pytest.raises(InputError, match="the object's file has not been read"):
        Simulation(prepare(ball(300), named))
    with pytest.raises(InputError, match="belong to 3 objects, but the scene has 2"):
        Simulation(prepare(as_objects({0: ball(300), 2: ball(300)}), waiting))


def test_forces_and_walls_act_on_the_object_they_name():
    beside = {**BOX, "shape": "sphere", "sides": [1, 1, 1], "size": 1.0}
    push = {"kind": "acceleration", "a": [4.0, 0.0, 0.0], "object": "box"}
    foot = {"kind": "foot", "fraction": 1.0, "object": "object"}
    fall = {"kind": "gravity"}
    pushed = scene(objects=[beside], forces=[fall, push], boundaries=[foot])
    run = Simulation(prepare(ball(400), pushed, RunContext(threads=1)))
    clip = run.run()
    moved = [(clip.means[-1] - clip.means[0])[clip.object_id == index] for index in (0, 1)]
    assert np.abs(moved[0]).max() < 1e-3
    assert moved[1].mean(axis=0) == pytest.approx([4 / 48**2 * 2, 0, -9.81 / 48**2 * 2], rel=0.01)
    assert clip.report["balance"]["momentum_gain"] < 1e-4
    with pytest.raises(InputError, match=r"box has no particles.*choose one of: object"):
        scene(objects=[{**BOX, "static": True}], forces=[push])


def test_one_that_is_held_stays_and_carries():
    still = {**BOX, "place": [0, 0], "held": True}
    changes = {"object.lift": 0.0, "object.on": "box", "boundaries": [], "time.frames": 12}
    clip = Simulation(
        prepare(ball(400), scene(**{**changes, "objects": [still]}), RunContext(threads=1))
    ).run()
    box = clip.object_id == 1
    assert clip.report["complete"] and np.array_equal(clip.means[-1][box], clip.means[0][box])
    fallen = clip.means[0][~box][:, 2].mean() - clip.means[-1][~box][:, 2].mean()
    assert fallen < 0.16 < 0.25 < 9.81 / 2 * clip.times[-1] ** 2, "a cell until it is met"
    assert clip.walls == ("object_on_box",)
    assert clip.report["pairs"]["object_on_box"]["largest_force"] > 1000
    assert clip.wrenches[-4:, 0, 0, 2].max() < 0, "it presses down"


def scenes_of(page: str) -> list[str]:
    """Return the scenes on a page of the guide."""
    return [b.text for b in blocks() if b.page.name == page and b.words[0] == "toml"]


def test_the_scene_of_the_guide_runs():
    (text,) = scenes_of("objects.md")
    (meshed,) = scenes_of("objects-in-files.md")
    assert Scene.from_data(tomllib.loads(meshed)).objects[0].mesh == Path("chair.glb")
    kinds = ["path", "free"]
    for scene, kind in zip(scenes_of("moved-objects.md"), kinds, strict=True):
        assert Scene.from_data(tomllib.loads(scene)).objects[-1].motion.kind == kind
    shown = Scene.from_data(tomllib.loads(text)).replaced({**QUICK, "time.frames": 2})
    run = Simulation(prepare(ball(400), shown, RunContext(threads=1)))
    assert run.run().report["complete"] and run.solver.model.held == {2}
    assert [run.solver.pairs.all[i].sticky for i in range(2)] == [True, False]


def test_usd_names_the_object_of_each_gaussian(run, tmp_path):
    pytest.importorskip("pxr")
    write_usd(tmp_path / "c.usda", run.clip())
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(tmp_path / "c.usda"))
    prim = stage.GetPrimAtPath("/Splats")
    kept = UsdGeom.PrimvarsAPI(prim).GetPrimvar("objectId").Get()
    assert np.array_equal(kept, run.clip().object_id)
    assert list(prim.GetCustomDataByKey("objects")) == ["ball", "box", "copy"]


def test_live_grab_and_its_session_take_the_same_object():
    particles = {"accuracy": {"cells": 8, "solver": "mpm"}}
    live = Live(ball(300), scene(**ON_BOX, **particles), RunContext(threads=1))
    (frame,) = live.frames(1)
    assert list(frame.wrenches or {}) == list(live.contacts()) == ["ground", "ball_on_box"]
    assert live.pairs == {"ball_on_box": "box"} and set(live.centres) == {"ball", "box"}
    x, y, top = live.centres["box"] + (0, 0, 0.24)
    # The ball is above it, within the radius of the hand, which is strong enough to tear the box.
    live.grab((x, y, top), strength=3 * live.limits.weight)
    live.move_to((x, y + 0.5, top))
    live.push((0, 0, 300), object="ball")
    frames = [frame, *live.frames(4)]
    forces = {force.kind: force.object for force in live.session().forces}
    assert forces == {"gravity": None, "grab": "box", "wrench": "ball"}
    assert Scene.from_data(live.session().data()) == live.session()
    clip = live.clip()
    for index, item in enumerate(frames):
        count = len(item.gaussians)  # the clip has grains besides, since the box is torn
        assert np.array_equal(item.gaussians.means, clip.means[index, :count])
    assert np.array_equal(np.unique(clip.object_id[count:]), [1])
    for wrong, said in (
        ("cat", r"no such object\. Choose one of: ball, box\."),
        ("box", "nearest point"),
    ):
        with pytest.raises(InputError, match=said):
            live.grab(live.centres["ball"].tolist(), object=wrong, radius=0.1)


def test_static_objects_cannot_be_grabbed():
    held = {**BOX, "place": [0, 0], "held": True}
    live = Live(ball(300), scene(**{**ON_BOX, "objects": [held]}), RunContext(threads=1))
    live.step()
    live.grab((live.centres["box"] + (0, 0, 0.2)).tolist(), radius=1.5)
    live.step()
    assert live.session().forces[-1].object == "ball"
    with pytest.raises(InputError, match=r"grab.object = box: it is held in place"):
        live.grab((0, 0, 0), object="box")
    with pytest.raises(InputError, match=r"push.object = box: it is held in place"):
        live.push((1, 0, 0), object="box")


PUSHER = {
    "name": "pusher",
    "shape": "box",
    "size": 1.0,
    "sides": [0.4, 1, 1],
    "place": [-0.95, 0],
    "motion": {"kind": "path", "times": [0, 0.5], "points": [[0, 0, 0], [1, 0, 0]]},
}


@pytest.mark.parametrize(
    ("changes", "lower", "upper"),
    [
        ({}, (-1.15, -0.5, 0), (-0.75, 0.5, 1)),
        ({"lift": 0.5}, (-1.15, -0.5, 0.5), (-0.75, 0.5, 1.5)),
        ({"shape": "sphere", "sides": [1, 1, 1]}, (-1.45, -0.5, 0), (-0.45, 0.5, 1)),
        ({"shape": "capsule", "sides": [0.4, 0.4, 1]}, (-1.15, -0.2, 0), (-0.75, 0.2, 1)),
    ],
)
def test_an_object_with_a_motion_is_a_wall_where_it_is_drawn(changes, lower, upper):
    declared = scene(objects=[{**PUSHER, **changes}], pairs=[{"friction": 0.3}])
    *_, wall = declared.with_solids().boundaries
    np.testing.assert_allclose(wall.extent(None), [lower, upper], rtol=0, atol=1e-12)
    assert (wall.friction, wall.contact) == (0.3, "separate")
    drawn = make_shape(declared.objects[0].shape, declared.objects[0].sides, (1, 1, 1)).means
    np.testing.assert_allclose(np.ptp(drawn, axis=0), np.subtract(upper, lower), atol=0.06)
    assert declared.with_solids().replaced({"objects": []}).names == ("object",)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shape": None, "file": "a.ply"}, "Only shapes follow a motion"),
        ({"held": True}, "Remove static, held, velocity and spin"),
        ({"velocity": [1, 0, 0]}, "Remove static, held, velocity and spin"),
        ({"on": "object"}, "cannot stand on another object. Use lift"),
        ({"turn": [0, 0, 30]}, "cannot be rotated. Remove `turn`"),
        ({"shape": "sphere"}, "Make all 3 sides equal"),
        ({"shape": "capsule", "sides": [0.4, 0.3, 1]}, "Make the 2 shorter sides equal"),
        ({"shape": "capsule", "sides": [1, 1, 1]}, "Lengthen one side, or use a sphere"),
    ],
)
def test_a_motion_that_no_wall_can_follow_is_refused(changes, said):
    with pytest.raises(InputError, match=said):
        scene(objects=[{**PUSHER, **changes}])


def test_scenery_with_a_track_is_shifted_and_the_rest_stays():
    two = as_objects({0: ball(50), 1: ball(50)})
    selected = two.object_id == 1
    track = Scene.from_data({"objects": [PUSHER]}).objects[0].motion.track()
    frame = Frame(3, 0.25, two.select(~selected), velocities=np.zeros((50, 3), np.float32))
    whole = Scenery(two, ~selected, ((1, track),)).whole(frame)
    shift = whole.gaussians.means - two.means
    np.testing.assert_allclose(shift[selected], [[0.5, 0, 0]] * 50, atol=1e-6)
    assert not shift[~selected].any() and np.all(whole.velocities[selected, 0] > 2.5)


@pytest.mark.slow
def test_a_moved_object_pushes_and_what_it_gives_is_known(tmp_path):
    """The wall's impulse equals the ball's momentum, and the wall follows its path."""
    changes = {"objects": [PUSHER], "forces": [], "boundaries": [], "time.frames": 13}
    declared = scene(**changes, **{"time.fps": 24, "velocities": True, "wrenches": True})
    made = Simulation(prepare(ball(400), declared, RunContext(threads=1)))
    clip = made.run()
    selected = clip.object_id == 1
    assert clip.report["complete"] and clip.walls == ("box",)
    assert not clip.scene.get("boundaries"), "the scene is the one that was given"
    went = clip.means[-1][selected] - clip.means[0][selected]
    np.testing.assert_allclose(went, [[1, 0, 0]] * selected.sum(), atol=1e-5)
    exchanged = -clip.wrenches[:, 0, 0].sum(axis=0) / 24
    kept = made.find(Watchdog).last.momentum  # on a lattice, that of the nodes
    np.testing.assert_allclose(exchanged, kept, rtol=1e-4, atol=1e-4 * abs(kept[0]))
    assert kept[0] / made.solver.model.total_mass > 1, "faster than 1 m/s"
    paused = Simulation(prepare(ball(400), declared, RunContext(threads=1)))
    again = resumed(paused, 5, tmp_path / "pause.safetensors").run()
    assert np.array_equal(again.means, clip.means)
    gap = clip.means[:, ~selected, 0].min(axis=1) - clip.means[:, selected, 0].max(axis=1)
    assert gap.min() > -0.6 * declared.dx, "a soft ball, hit at 3 m/s"


def test_an_object_is_that_of_a_clip(tmp_path):
    crop, path = (0.1, 0.2, 0.5, 0.8), tmp_path / "fell.safetensors"
    clip = random_clip(count=300).with_report({"crop": crop})
    clip.save(path)
    write_ply(tmp_path / "first.ply", ball(200))
    first, waiting = tmp_path / "first.ply", {"name": "second", "place": [0, 2]}
    for inputs, more in (({**waiting, "file": str(path)}, []), (waiting, [path])):
        made = pipeline.make_gaussians(
            [first, *more], Scene.from_data({"objects": [inputs]}), generator=str(first)
        )
        second = made.gaussians.of_object(1)
        assert np.array_equal(second.means, clip.frame(0).gaussians.means)
        assert made.about["sources"]["second"] == {"source": path.name, "generator": "clip"}
        assert made.scene.objects[0].crop == crop, "masks are painted on the clip's picture"
    replace(clip, object_id=np.repeat([0, 1], 150).astype(np.int32)).save(path)
    with pytest.raises(InputError, match=r"objects.0 \(second\).*clip of several objects"):
        pipeline.make_gaussians(
            [first, path], Scene.from_data({"objects": [waiting]}), generator=str(first)
        )


def test_a_file_of_more_objects_than_the_scene_has_is_refused(tmp_path):
    path = tmp_path / "several.ply"
    write_ply(path, replace(ball(300), object_id=np.arange(300, dtype=np.int32) % 3))
    scene = Scene.from_data({"objects": [{"name": "second", "place": [0, 2]}]})
    with pytest.raises(InputError, match="belong to 3 objects, but the scene has 2"):
        pipeline.make_gaussians(path, scene, generator=str(path))


@pytest.mark.slow
def test_notes_of_every_file_come_into_the_report(tmp_path):
    for name in ("first", "second"):
        write_ply(tmp_path / f"{name}.ply", ball(300))
        data = (tmp_path / f"{name}.ply").read_bytes()
        data = data.replace(b"property float nx", b"property float " + name.encode())
        (tmp_path / f"{name}.ply").write_bytes(data)
    first, second = tmp_path / "first.ply", tmp_path / "second.ply"
    scene = Scene.from_data(
        {
            "time": {"frames": 1},
            "accuracy": {"cells": 8},
            "objects": [{"name": "other", "place": [0, 2]}],
        }
    )
    made = pipeline.make_gaussians([first, second], scene, generator=str(first))
    report = pipeline.simulate(
        made.gaussians, made.scene, tmp_path / "out", about=made.about, films=False
    ).report
    assert report["notes"][:2] == [
        "Unknown columns are ignored: first.",
        "other: Unknown columns are ignored: second.",
    ]
