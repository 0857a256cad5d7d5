"""Captures: the floor is found whatever the unit and orientation, and the object stands on it."""

import json
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.errors import Cancelled, InputError
from phy124.gaussians import join, rotation_matrices
from phy124.generators.ply_file import PlyFile, Reading
from phy124.io.axes import orientation
from phy124.io.clip import Clip
from phy124.io.ply import write_ply
from phy124.particles import compute_bounds
from phy124.pipeline.capture import capture, find_floaters
from phy124.pipeline.capture.floor import find_floor
from phy124.rendering.framing import cameras
from phy124.scene import Scene, View
from phy124.schema.region import PartRegion
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.accuracy.study import Study
from support.captures import captured
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

FLOOR = Reading(floor=True)
QUICK = {"accuracy": {"cells": 10}, "time.frames": 3, "parts": []}


def scene(name="bounce", **changes) -> Scene:
    return Scene.named(name).replaced({**QUICK, "object.lift": 0.0} | changes)


def saved(folder, place) -> str:
    write_ply(folder / "capture.ply", place.gaussians)
    return str(folder / "capture.ply")


def degrees(a, b) -> float:
    return float(np.degrees(np.arccos(np.clip(np.dot(a, b), -1, 1))))


@pytest.mark.parametrize(
    ("seed", "changes"),
    [
        *((seed, {}) for seed in range(6)),
        (6, {"noise": 0.02}),
        (7, {"floaters": 600}),
        (8, {"floor": 1500}),
        (9, {"noise": 0.0}),
    ],
)
def test_the_floor_is_found_in_any_unit_and_orientation(tmp_path, seed, changes):
    place = captured(seed, **changes)
    read = capture(PlyFile(saved(tmp_path, place), FLOOR), scene())
    floor = read.about["capture"]["floor"]
    assert degrees(floor["normal"], place.up) < 1
    (part,) = read.scene.parts
    region = part.gaussians[0]
    assert part.static and part.gaussians[1] == len(read.gaussians)
    # Floaters below the floor, and the rim of the ball, are counted with it.
    assert 0.95 * (place.kind == 1).sum() <= len(read.gaussians) - region
    assert floor["gaussians"] <= 1.12 * (place.kind == 1).sum()
    assert region >= (0.97 - 3 * changes.get("noise", 0)) * (place.kind == 0).sum()
    # The object is upright, 1 m, and its floor is at z = 0.
    low, high = (f(read.gaussians.means[:region], axis=0) for f in (np.min, np.max))
    assert low == pytest.approx([-0.5, -0.5, 0], abs=0.07)
    assert high == pytest.approx([0.5, 0.5, 1], abs=0.07)
    heights = read.gaussians.means[region:, 2]
    assert abs(np.median(heights)) < 0.01


def test_which_gaussians_are_the_floors(rng):
    place = captured(3)
    means = place.gaussians.means
    floor = find_floor(means[place.gaussians.opacities > 0.1])
    lies = floor.heights(means) <= floor.tolerance
    assert lies[place.kind == 1].mean() > 0.95
    assert lies[place.kind == 0].mean() < 0.01


def test_the_object_stands_on_its_floor(tmp_path):
    """The object does not fall, and the floor stays the same bit for bit; only the object is
    simulated and framed."""
    place = captured(4)
    read = capture(PlyFile(saved(tmp_path, place), FLOOR), scene("drop", **{"time.frames": 6}))
    run = Simulation(prepare(read.gaussians, read.scene))
    clip = run.run()
    first, last = clip.scene["parts"][0]["gaussians"]
    floor = clip.means[:, first:last]
    assert clip.report["complete"] and (floor == floor[0]).all()
    assert clip.report["static"] == last - first > 5000
    height = np.median(floor[0, :, 2])
    assert abs(height) < 0.03
    lowest = clip.means[:, :first, 2].min(axis=1)
    assert (lowest > height - 0.03).all() and (lowest < height + 0.06).all()
    tall = np.ptp(clip.means[0, :first, 2])
    assert tall == pytest.approx(1, abs=0.07)
    # No particle is the floor's, and the camera is as near as it would be without it.
    assert np.ptp(run.setup.particles.x, axis=0).max() < 1.05
    camera = cameras(clip, View(), "front")[0]
    assert np.linalg.norm(np.subtract(camera.eye, camera.target)) < 2.1


def test_an_object_of_fewer_gaussians_keeps_its_size_beside_its_floor(tmp_path):
    file = PlyFile(saved(tmp_path, captured(4)), FLOOR)
    sizes = []
    for count in (None, 1200):
        read = capture(file, scene(), count=count)
        assert count is None or len(read.gaussians) <= count
        body = read.gaussians.select(slice(*read.scene.parts[0].gaussians[:1]))
        sizes.append(np.subtract(*compute_bounds(body)[::-1]))
    np.testing.assert_allclose(sizes[1], sizes[0], rtol=0.01)


@pytest.mark.slow
def test_a_lifted_object_leaves_its_floor_on_the_ground(tmp_path):
    read = capture(
        PlyFile(saved(tmp_path, captured(2)), FLOOR), scene("drop", **{"object.lift": 0.4})
    )
    run = Simulation(prepare(read.gaussians, read.scene))
    region = run.setup.cleaned_scene.parts[0].gaussians[0]
    assert abs(np.median(run.setup.gaussians.means[region:, 2])) < 0.03
    assert run.setup.gaussians.means[:region, 2].min() == pytest.approx(0.4, abs=0.03)


def test_up_option_excludes_walls(tmp_path, rng):
    """A wall twice as dense as the floor wins, unless up is told roughly."""
    place = captured(5, floaters=0)
    wall = rng.uniform([-2, 1.5, 0], [2, 1.5, 4], (15_000, 3))
    wall[:, 1] += 0.003 * rng.normal(size=15_000)
    everything = np.concatenate([place.gaussians.means @ orientation(), place.in_file(wall)])
    assert degrees(find_floor(everything).normal, place.up) > 45
    tilted = place.up + 0.3 * np.cross(place.up, [0.3, 0.5, 0.8])
    result = find_floor(everything, tilted / np.linalg.norm(tilted))
    assert degrees(result.normal, place.up) < 1


def test_up_option_excludes_ceilings(rng):
    """A ceiling four times as dense as the floor has everything below it."""
    place = captured(5, floaters=0)
    ceiling = rng.uniform([-2, -2, 2.5], [2, 2, 2.5], (24_000, 3))
    ceiling[:, 2] += 0.003 * rng.normal(size=24_000)
    everything = np.concatenate([place.gaussians.means @ orientation(), place.in_file(ceiling)])
    floor = find_floor(everything, place.up)
    assert degrees(floor.normal, place.up) < 1
    assert floor.holds(everything).mean() < 0.3
    with pytest.raises(InputError, match="no floor was found"):
        find_floor(everything[: -len(ceiling)], -place.up)


@pytest.mark.parametrize(
    ("points", "words"),
    [
        (ball(3000).means, "no floor was found: the best plane"),
        (np.random.default_rng(0).uniform(-1, 1, (4000, 3)), "no floor was found: the best plane"),
        (np.zeros((50, 3)), "there are too few Gaussians"),
        (np.zeros((2, 3)), "there are too few Gaussians"),
        (captured(0, floaters=0).gaussians.means[-6000:], "of the Gaussians are above"),
    ],
)
def test_capture_without_a_floor_is_refused(points, words):
    with pytest.raises(InputError, match=words):
        find_floor(points)


def test_a_box_alone_has_no_floor(rng):
    """The faces of the box are planes that end at the box."""
    faces = rng.uniform(-1, 1, (6000, 3))
    axis = rng.integers(0, 3, 6000)
    faces[np.arange(6000), axis] = np.sign(faces[np.arange(6000), axis])
    with pytest.raises(InputError, match="is no larger than the object on it"):
        find_floor(faces)


def test_floaters_are_distinguished_from_sparse_objects():
    shell = ball(2000)
    rng = np.random.default_rng(0)
    far = ball(2000).select(np.arange(30))
    far = join([shell, far.transform(1.0, np.zeros(3))])
    means = far.means.copy()
    means[2000:] = rng.uniform(1.5, 6, (30, 3))
    assert find_floaters(replace(far, means=means)).tolist() == [False] * 2000 + [True] * 30
    assert not find_floaters(shell).any()
    assert not find_floaters(shell.select(np.arange(3))).any()


def test_a_region_in_the_files_own_units(tmp_path):
    """A box of the file holds the same Gaussians before and after they are turned and scaled."""
    place = captured(7, floaters=0)
    path = saved(tmp_path, place)
    as_file = PlyFile(path, Reading(up="z", front="x")).open().gaussians.means
    centre = place.in_file([[0, 0, 0.8]])[0]
    half = 0.35 * place.scale
    region = {"lower": (centre - half).tolist(), "upper": (centre + half).tolist(), "units": "file"}
    chosen = scene(**{"parts": [{"material": {"law": "metal"}, "region": region}]})
    for floor in (False, True):
        read = capture(PlyFile(path, Reading(floor=floor)), chosen)
        assert read.scene.parts[0].region.units == "metres"
        run = Simulation(prepare(read.gaussians, read.scene))
        inside = read.scene.parts[0].region.contains(run.setup.gaussians.means)
        expected = (np.abs(as_file - centre) < half).all(axis=1)
        assert inside.sum() == pytest.approx(expected.sum(), abs=2)
        assert 100 < inside.sum() < 2900
        assert Scene.from_data(read.scene.data()) == read.scene


@pytest.mark.parametrize("floor", [False, True])
def test_a_cylinder_turned_in_the_files_own_units(tmp_path, rng, floor):
    """The region stays a cylinder, and its own rotation adds to that of the file."""
    place = captured(7, floaters=0)
    path = saved(tmp_path, place)
    as_file = PlyFile(path, Reading(up="z", front="x")).open().gaussians.means
    turn = rng.normal(size=4)
    turn /= np.linalg.norm(turn)
    axes = rotation_matrices(turn[None])[0]
    centre, half = place.in_file([[0, 0, 0.8]])[0] @ axes, 0.35 * place.scale
    region = PartRegion(
        lower=(centre - half).tolist(),
        upper=(centre + half).tolist(),
        cylinder="y",
        turn=turn.tolist(),
        units="file",
    )
    part = {"material": {"law": "metal"}, "region": region.model_dump()}
    read = capture(PlyFile(path, Reading(floor=floor)), scene(**{"parts": [part]}))
    placed = read.scene.parts[0].region
    assert (placed.cylinder, placed.units) == ("y", "metres")
    inside = placed.contains(prepare(read.gaussians, read.scene).gaussians.means).sum()
    off = as_file @ axes - centre
    expected = (np.abs(off[:, 1]) < half) & (np.hypot(off[:, 0], off[:, 2]) < half)
    assert inside == pytest.approx(expected.sum(), abs=2)
    assert 100 < inside < (np.abs(off) < half).all(axis=1).sum() - 20


def test_a_region_beyond_everything_is_refused(tmp_path):
    """A file in kilometres may tell of places that no scene in metres reaches."""
    place = captured(7, floaters=0)
    region = {"lower": [8e8, 0, 0], "upper": [9e8, 1, 1], "units": "file"}
    chosen = scene(**{"parts": [{"static": True, "region": region}], "object.size": 100.0})
    with pytest.raises(InputError, match=r"parts\.0\.region = .* the object is not that far"):
        capture(PlyFile(saved(tmp_path, place)), chosen)


def test_a_region_in_file_units_without_a_file_is_refused():
    region = {"lower": [0, 0, 0], "units": "file"}
    with pytest.raises(
        InputError, match=r"parts\.0\.region\.units = file: the object was not read"
    ):
        Simulation(prepare(ball(500), scene(**{"parts": [{"static": True, "region": region}]})))


def test_parts_count_the_gaussians_that_were_given():
    """Dropping some before the run does not shift which ones a part names."""
    gaussians = ball(1000)
    means = gaussians.means.copy()
    means[:50] = np.nan
    part = {"static": True, "gaussians": [500, 600]}
    run = Simulation(prepare(replace(gaussians, means=means), scene(**{"parts": [part]})))
    assert len(run.setup.gaussians) == 950
    assert np.flatnonzero(~run.setup.scenery.moves).tolist() == list(range(450, 550))
    assert run.clip is not None and run.setup.cleaned_scene.parts[0].gaussians == (450, 550)


def test_surroundings_are_static_and_picked_by_number():
    for part in ({"region": {}, "static": True}, {"gaussians": [0, 5]}):
        with pytest.raises(
            InputError, match="surroundings must be static and selected by gaussians"
        ):
            Scene.from_data({"parts": [part | {"surroundings": True}]})


def test_the_command_line(tmp_path, capsys):
    place = captured(8)
    run = ["simulate", saved(tmp_path, place), "--scene", "drop", "--floor", "--views", "front"]
    run += ["--frames", "3", "--size", "64", "--set", "accuracy={cells=8}", "--device", "cpu"]
    assert main([*run, "--out", str(tmp_path / "out")]) == 0
    assert "floor: " in capsys.readouterr().out
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert degrees(report["capture"]["floor"]["normal"], place.up) < 1
    assert report["static"] > 5000 and report["departures"] == []
    clip = Clip.load(tmp_path / "out/clip.safetensors")
    # What was saved is what can be simulated again.
    again = Scene.from_toml(tmp_path / "out/scene.toml")
    assert again.parts[-1].gaussians[1] == clip.means.shape[1]


OPTIONS = [
    *("--scene", "drop", "--floor", "--views", "front", "--frames", "4", "--size", "32"),
    *("--set", "accuracy={cells=8}", "time.sleep=false", "--device", "cpu"),
]


def test_interrupted_capture_resumes_with_the_same_command(tmp_path, capsys):
    """The floor is detected again, equal bit for bit; without --floor the run would be another
    one."""

    def cancel(stage: str, done: int, total: int) -> None:
        if (stage, done) == ("simulate", 2):
            raise Cancelled

    path = saved(tmp_path, captured(8, floor=1500))
    changes = {"time.frames": 4, "time.sleep": False, "view.size": 32, "view.views": ["front"]}
    changes["view.stage"] = "studio"  # as the command has it
    chosen = Scene.named("drop").replaced({"accuracy": {"cells": 8}} | changes)
    read = capture(PlyFile(path, FLOOR), chosen)
    pipeline.simulate(read.gaussians, read.scene, tmp_path / "out", progress=cancel, keep=True)
    again = ["simulate", path, *OPTIONS, "--out", str(tmp_path / "out"), "--resume"]
    assert main([word for word in again if word != "--floor"]) == 2
    assert "the interrupted run has different parts" in capsys.readouterr().err
    assert main(again) == 0
    assert Clip.load(tmp_path / "out/clip.safetensors").report["complete"]


@pytest.mark.slow
def test_a_capture_at_an_accuracy_that_is_looked_for(tmp_path, capsys):
    """The floor is in every run that is compared; with --gaussians it is thinned, too."""
    path = saved(tmp_path, captured(8))
    options = [word for word in OPTIONS if "accuracy" not in word]
    wish = ["--max-error", "20%", "--gaussians", "2000", "--out", str(tmp_path / "out")]
    assert main(["simulate", path, *options, *wish]) == 0
    assert "asked for an error of at most 20%" in capsys.readouterr().out
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["goal"]["met"] and 1800 < report["gaussians"] <= 2000
    assert 0.5 < report["static"] / report["gaussians"] < 0.8


@pytest.mark.slow
def test_a_study_reads_captures_as_a_simulation_does(tmp_path, capsys, monkeypatch):
    """Its levels suffice: variations of the finest read nothing."""
    plan = Study._plan
    path = saved(tmp_path, captured(8, floor=600))
    (tmp_path / "s.toml").write_text(
        'accuracy = {cells = 6, solver = "mpm"}\ntime = {frames = 2}\n'
        'view = {size = 32, views = ["front"]}\n'
    )
    out = str(tmp_path / "o")
    study = ["accuracy", str(tmp_path / "s.toml"), "--device", "cpu", "--out", out]
    study += ["--levels", "4", "5", "6"]
    monkeypatch.setattr(Study, "_plan", lambda made: islice(plan(made), len(made.levels)))
    assert main([*study, "--image", path, "--floor"]) == 0
    assert "D/6" in capsys.readouterr().out
    assert main([*study, "--floor"]) == 2
    assert "image = none: --floor is for a file of Gaussians" in capsys.readouterr().err


def test_a_generator_that_is_a_capture(tmp_path, capsys):
    """`generate --generator x.ply` is `simulate x.ply`: the same floor, the same clip."""
    path, clips = saved(tmp_path, captured(8, floor=1500)), []
    for command in (["simulate", path], ["generate", "any.png", "--generator", path]):
        out = tmp_path / command[0]
        assert main([*command, *OPTIONS, "--gaussians", "1000", "--out", str(out)]) == 0
        assert "floor: " in capsys.readouterr().out
        clips.append(Clip.load(out / "clip.safetensors"))
    assert (clips[0].means == clips[1].means).all()
    assert clips[0].report["capture"] == clips[1].report["capture"]


@pytest.mark.slow
def test_an_interrupted_generator_that_is_a_capture_goes_on(tmp_path):
    def cancel(stage: str, done: int, total: int) -> None:
        if (stage, done) == ("simulate", 2):
            raise Cancelled

    path = saved(tmp_path, captured(8, floor=1500))
    changes = {"time.frames": 4, "time.sleep": False, "view.size": 32, "view.views": ["front"]}
    changes["view.stage"] = "studio"  # as the command has it
    chosen = Scene.named("drop").replaced({"accuracy": {"cells": 8}} | changes)
    out, answer = tmp_path / "out", {"generator": path, "reading": FLOOR}
    pipeline.generate("any.png", chosen, out, **answer, progress=cancel, keep=True)
    again = ["generate", "any.png", "--generator", path, *OPTIONS, "--out", str(out), "--resume"]
    assert main(again) == 0
    assert Clip.load(out / "clip.safetensors").report["complete"]


@pytest.mark.parametrize("options", [["--floor"], ["--crop", "0,0,0,1,1,1"], ["--up", "z"]])
def test_file_options_require_a_file(tmp_path, capsys, options):
    assert main(["generate", "any.png", *options, "--out", str(tmp_path / "out")]) == 2
    assert f"generator = relief: {options[0]} is for a file of Gaussians" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_floor_is_not_forgotten_where_there_is_no_scene():
    with pytest.raises(InputError, match="A floor becomes a part of the scene"):
        PlyFile("a.ply", FLOOR)()


def test_file_of_a_run_keeps_its_place_in_the_picture(tmp_path):
    """Masks and stiffness pictures are painted over the picture of the first run."""
    crop, mask = (0.1, 0.2, 0.5, 0.8), tmp_path / "mask.png"
    painted = Scene.from_data({"stiffness": {"kind": "picture", "file": str(mask)}})
    path = str(tmp_path / "gaussians.ply")
    write_ply(path, ball(200))
    for name, reading, place in (
        ("gaussians.ply", Reading(), crop),
        ("gaussians.ply", Reading(rotate="0,0,90"), (0, 0, 1, 1)),
        ("other.ply", Reading(), (0, 0, 1, 1)),
    ):
        (tmp_path / "report.json").write_text(json.dumps({"files": [name], "crop": crop}))
        read = capture(PlyFile(path, reading), painted)
        assert read.crop == place
        assert any("stiffness.file: the picture is stretched" in n for n in read.notes) == (
            place != crop
        )
    assert not capture(PlyFile(path), Scene()).notes


def test_file_of_a_further_object_keeps_its_place_in_the_picture(tmp_path):
    crop, folder, first = (0.1, 0.2, 0.5, 0.8), tmp_path / "run", str(tmp_path / "first.ply")
    folder.mkdir()
    for path in (folder / "gaussians.ply", first):
        write_ply(path, ball(200))
    (folder / "report.json").write_text(json.dumps({"files": ["gaussians.ply"], "crop": crop}))
    further = {"name": "second", "place": [0, 2], "file": str(folder / "gaussians.ply")}
    declared = Scene.from_data({"objects": [further]})
    made = pipeline.make_gaussians([first], declared, generator=first)
    assert made.scene.objects[0].crop == crop and made.crop == (0, 0, 1, 1)
