"""Sweeps: what is planned, that it is made once and resumed, and what is read back."""

import json
import signal
import sys
import tarfile
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.__main__ import main
from phy124.errors import Cancelled, Incomplete, InputError
from phy124.io.ply import write_ply
from phy124.runtime.failures import failure
from phy124.studies.sweep import Dataset, Plan, keys, list_refused, on_ray, run, running
from phy124.studies.sweep.dataset import pack
from phy124.studies.sweep.keys import key_of
from phy124.studies.sweep.manifest import read_manifest
from phy124.studies.sweep.report import format_lines, summarise, write_page
from phy124.studies.sweep.storage import Storage, list_matching
from support.pages import ROOT, blocks
from support.processes import clips_of
from support.shapes import ball
from support.solids import coarse
from support.sweeps import declared, write_balls

pytestmark = pytest.mark.usefixtures("coarse_solids")


@pytest.fixture(scope="module")
def balls(tmp_path_factory) -> Path:
    return write_balls(tmp_path_factory.mktemp("balls"))


@pytest.fixture(scope="module")
def made(balls, tmp_path_factory):
    """A small sweep, whole."""
    out = tmp_path_factory.mktemp("sweep") / "out"
    with coarse():
        counts = run(Plan(declared(balls)), str(out), workers=0)
    assert counts.ended == {"done": 6} and counts.here == 0
    return out


def test_combinations_are_all_and_the_last_axis_changes_fastest(balls):
    plan = Plan(declared(balls))
    items = list(plan)
    assert len(plan) == len(items) == 6
    assert [Path(i.picture).name for i in items] == ["a.ply"] * 3 + ["b.ply"] * 3
    assert [i.changes["material.E"] for i in items[:3]] == pytest.approx([1e4, 1e5, 1e6])
    assert plan.item(4) == items[4]
    stiffness = plan.scene_of(items[4]).material.E
    assert stiffness == pytest.approx(1e5)
    shared = [index for part in (1, 2, 3, 4) for index in plan.share(part, 4)]
    assert sorted(shared) == list(range(6))


def test_samples_fill_all_axes_evenly_and_follow_the_seed(balls):
    axes = {
        "material.E": {"log_uniform": [1e3, 1e7]},
        "material.nu": {"uniform": [0.1, 0.4]},
        "material.law": {"choice": ["hencky", "sand"], "weights": [3, 1]},
    }
    plan = Plan(declared(balls, set=axes, samples=2048, seed=5))
    items = list(plan)
    assert len(items) == 2048 and items[1500] == plan.item(1500)
    decades = Counter(int(np.log10(i.changes["material.E"])) for i in items)
    assert all(abs(decades[d] - 512) <= 4 for d in (3, 4, 5, 6))
    laws = Counter(i.changes["material.law"] for i in items)
    assert abs(laws["sand"] - 512) <= 4
    assert np.mean([i.changes["material.nu"] for i in items]) == pytest.approx(0.25, abs=1e-3)
    assert {Path(i.picture).name for i in items} == {"a.ply", "b.ply"}
    assert list(Plan(plan.sweep)) == items
    other = Plan(declared(balls, set=axes, samples=2048, seed=6))
    assert other.item(0) != plan.item(0)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"set": {"a": {"uniform": [2, 1]}}}, r"set\.a = .*2 is larger than 1"),
        ({"set": {"material.nu": {"uniform": [0, 0.4]}}}, "Set samples"),
        ({"set": {"a": []}}, "the axis has no values"),
        ({"set": {"a": {"numbers": [1]}}}, "the axis has no values. Give one of choice"),
        ({"set": {"a": {"first": 1, "last": 2}}}, r"set\.a\.count = nothing"),
        ({"set": {"a": {"first": 0, "last": 2, "count": 2, "spacing": "log"}}}, "numbers above 0"),
        ({"set": {"a": {"choice": [1, 2], "weights": [1]}}}, "2 values have 1 weights"),
        ({"set": {"a": {"uniform": [float("nan"), 1]}}}, "= nan: it must be a number"),
        ({"pictures": []}, "pictures"),
        ({"pictures": "no/such/*.png"}, "there is no such file"),
        ({"pictures": "s4://bucket/a.png"}, "s4:// needs a package"),
        ({"samples": 0}, "samples = 0"),
        ({"sample": 3}, "Did you mean samples"),
        ({"scene": "dropp"}, "Did you mean drop"),
        (
            {"set": {f"a{i}": {"first": 0, "last": 1, "count": 1000} for i in range(4)}},
            "but at most",
        ),
    ],
)
def test_a_sweep_that_cannot_be_made_is_refused(balls, changes, said):
    with pytest.raises(InputError, match=said):
        Plan(declared(balls, **changes))


def test_clips_are_complete_and_listed_in_the_manifest(made):
    rows = read_manifest(Storage(str(made)))
    assert [row["index"] for row in rows] == list(range(6))
    for row in rows:
        assert row["status"] == "done" and row["frames"] == 3 and row["largest_force"] >= 0
        assert row["seconds.simulate"] > 0 and row["energy_gain"] <= 0.01
        promised = json.loads((made / row["folder"] / "report.json").read_text())["promise"]
        assert row["own_error"] is None and row["expected_error"] == promised["error"]
        assert (made / row["folder"] / "thumbnail.webp").stat().st_size > 50
    stiff = [row["substeps"] for row in rows[:3]]
    assert stiff == sorted(stiff) and stiff[2] > 5 * stiff[0]
    assert not [p for p in made.rglob("*") if p.name.startswith(".")]


def test_a_second_run_makes_only_what_is_missing_and_the_same(made, balls, tmp_path):
    before = clips_of(made)
    again = run(Plan(declared(balls)), str(made), workers=0)
    assert again.here == 6 and not again.ended
    lost = json.loads(next((made / "rows").rglob("*.json")).read_text())
    (made / "rows" / lost["key"][0] / f"{lost['key']}.json").unlink()
    (made / lost["folder"] / "clip.safetensors").write_bytes(b"half of it")
    repaired = run(Plan(declared(balls)), str(made), workers=0)
    assert repaired.here == 5 and repaired.ended == {"done": 1}
    assert clips_of(made) == before


def test_shares_of_several_machines_are_together_the_whole(made, balls, tmp_path):
    for part in (1, 2, 3, 4):
        run(Plan(declared(balls)), str(tmp_path / "out"), workers=0, shard=(part, 4))
    assert clips_of(tmp_path / "out") == clips_of(made)
    assert len(read_manifest(Storage(str(tmp_path / "out")))) == 6


def test_failed_clip_is_a_row_and_others_continue(balls, tmp_path):
    (tmp_path / "broken.ply").write_bytes(b"ply\nformat ascii 1.0\n")
    sweep = declared(balls, pictures=[str(balls / "a.ply"), str(tmp_path / "broken.ply")])
    axes = {
        **sweep.model_dump(by_alias=True)["set"],
        "material.E": [1e4],
        "material.nu": [0.3, 0.7],
    }
    plan = Plan(declared(balls, pictures=list(sweep.pictures), set=axes))
    assert [item.index for item, why in list_refused(plan)] == [1, 3]
    counts = run(plan, str(tmp_path / "out"), workers=0)
    assert counts.ended == {"done": 1, "refused": 3}
    rows = {row["index"]: row for row in read_manifest(Storage(str(tmp_path / "out")))}
    assert "material.nu = 0.7" in rows[1]["sentence"] and "broken.ply" in rows[2]["sentence"]
    text = "\n".join(format_lines(summarise(Storage(str(tmp_path / "out")))))
    assert "1 done, 3 refused" in text and "material.nu = 0.7" in text


def test_the_key_knows_everything_that_makes_a_clip(balls, tmp_path):
    plan = Plan(declared(balls))
    item, other = plan.item(0), plan.item(1)
    key = key_of(plan.sweep, item, plan.scene_of(item))
    assert key == key_of(plan.sweep, item, plan.scene_of(item))
    assert key != key_of(plan.sweep, item, plan.scene_of(other))
    assert key != key_of(plan.sweep, plan.item(3), plan.scene_of(plan.item(3)))
    filmed = declared(balls, films=True)
    assert key != key_of(filmed, item, plan.scene_of(item))
    fewer = declared(balls, gaussians=10)
    assert key != key_of(fewer, item, plan.scene_of(item))


def test_the_key_knows_the_native_code(tmp_path, monkeypatch):
    (tmp_path / "native").mkdir()
    header = tmp_path / "native" / "tile.h"
    monkeypatch.setattr(keys.phy124, "__file__", str(tmp_path / "__init__.py"))
    digests = set()
    for text in ("int one;", "int two;"):
        header.write_text(text)
        digests.add(keys.code.__wrapped__())
    assert len(digests) == 2


def test_equal_clips_are_made_once(balls, tmp_path):
    (tmp_path / "same.ply").write_bytes((balls / "a.ply").read_bytes())
    pictures = [str(balls / "a.ply"), str(tmp_path / "same.ply")]
    counts = run(Plan(declared(balls, pictures=pictures)), str(tmp_path / "out"), workers=0)
    assert counts.ended == {"done": 3} and counts.here == 3


def test_one_broken_clip_stops_no_other_and_is_tried_again(balls, tmp_path, monkeypatch):
    whole, broken = on_ray.make_row, iter([OSError(5, "Input/output error"), RuntimeError("odd")])

    def sometimes(order, source, progress):
        if order.index in (1, 4) and (error := next(broken, None)):
            raise error
        return whole(order, source, progress)

    monkeypatch.setattr(on_ray, "make_row", sometimes)
    counts = run(Plan(declared(balls)), str(tmp_path), workers=0)
    assert counts.ended == {"done": 4, "failed": 2}
    rows = read_manifest(Storage(str(tmp_path)))
    assert "Input/output error" in rows[1]["sentence"] and "RuntimeError" in rows[4]["sentence"]
    again = run(Plan(declared(balls)), str(tmp_path), workers=0)
    assert again.here == 4 and again.ended == {"done": 2}


def test_a_mended_picture_takes_the_place_of_its_refusal(balls, tmp_path):
    picture, out = tmp_path / "object.ply", str(tmp_path / "out")
    picture.write_bytes(b"ply\nformat ascii 1.0\n")
    sweep = declared(balls, pictures=str(picture))
    assert run(Plan(sweep), out, workers=0).ended == {"refused": 3}
    picture.write_bytes((balls / "a.ply").read_bytes())
    assert run(Plan(sweep), out, workers=0).ended == {"done": 3}
    rows = read_manifest(Storage(out))
    assert [row["status"] for row in rows] == ["done"] * 3


@pytest.mark.slow
def test_a_clip_refused_for_lack_of_memory_is_tried_again(balls, tmp_path, monkeypatch):
    plan, out = Plan(declared(balls, pictures=str(balls / "a.ply"))), str(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("phy124.budget.limits.free_memory", lambda *_: 1e6)
        assert run(plan, out, workers=0).ended == {"refused": 3}
    assert "memory" in read_manifest(Storage(out))[0]["sentence"]
    assert run(plan, out, workers=0).ended == {"done": 3}
    assert len(Dataset(out)) == 3


def test_cancelling_keeps_what_is_made(balls, tmp_path):
    def stop(stage: str, done: int, total: int) -> None:
        if done == 2:
            raise Cancelled

    with pytest.raises(Cancelled):
        run(Plan(declared(balls)), str(tmp_path), workers=0, progress=stop)
    assert len(read_manifest(Storage(str(tmp_path)))) == 2
    assert run(Plan(declared(balls)), str(tmp_path), workers=0).here == 2


def test_a_full_disk_says_that_nothing_is_lost(balls, tmp_path, monkeypatch):
    def full(orders, *, beat):
        raise OSError(28, "No space left on device")
        yield

    monkeypatch.setattr(running, "in_turn", full)
    with pytest.raises(Incomplete, match=r"no finished clip in .* is lost") as caught:
        run(Plan(declared(balls)), str(tmp_path), workers=0)
    assert str(failure(caught.value)).count("Free some space") == 1


def test_a_folder_that_is_a_file_is_refused(balls, tmp_path):
    (tmp_path / "out").write_text("mine")
    with pytest.raises(InputError, match=r"out = .*: it is a file"):
        run(Plan(declared(balls)), str(tmp_path / "out"), workers=0)
    assert (tmp_path / "out").read_text() == "mine"


def test_the_clips_are_read_one_by_one(made):
    data = Dataset(str(made))
    assert len(data) == 6 and len(data[2].clip) == 3
    assert [sample.row["index"] for sample in data] == list(range(6))
    with pytest.raises(IndexError):
        data[6]
    with pytest.raises(InputError, match="no results of a sweep"):
        Dataset(str(made / "clips"))


def test_a_missing_folder_is_refused_even_without_pyarrow(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match="no results of a sweep"):
        read_manifest(Storage(str(tmp_path / "none")))


def test_results_may_be_anywhere_that_fsspec_knows(balls, made):
    address = "memory://sweeps/one"
    run(Plan(declared(balls)), address, workers=0)
    elsewhere, here = Dataset(address), Dataset(str(made))
    assert [s.row["key"] for s in elsewhere] == [s.row["key"] for s in here]
    assert np.array_equal(elsewhere[3].clip.means, here[3].clip.means)
    assert run(Plan(declared(balls)), address, workers=0).here == 6


def test_tar_files_hold_clips_beside_their_rows(made):
    storage = Storage(str(made))
    assert pack(storage, 4) == 2
    first = storage.read("archives/000000.tar")
    with tarfile.open(made / "archives" / "000000.tar") as tar:
        names = tar.getnames()
        row = json.load(tar.extractfile(names[1]))
    assert len(names) == 8 and names[0] == f"{row['key']}.clip.safetensors" and row["index"] == 0
    pack(storage, 4)
    assert storage.read("archives/000000.tar") == first
    (made / "archives/mine.tar").touch()
    assert pack(storage, 6) == 1
    assert storage.names("archives") == ["archives/000000.tar", "archives/mine.tar"]


def test_the_report_has_a_picture_of_each_clip(made):
    storage = Storage(str(made))
    text = "\n".join(format_lines(summarise(storage)))
    assert text.startswith("6 clips: 6 done") and "by material.E:" in text
    assert "wall time per clip, with compilation [s]" in text
    expected = [row["expected_error"] for row in read_manifest(storage)]
    assert ("error bound from similar scenes" in text) == any(
        value is not None for value in expected
    )
    assert "error bound measured for the clip" not in text  # these clips are too short for one
    page = Path(write_page(storage)).read_text()
    assert page.count("<img") == 6 and "largest force on a wall" in page


def test_the_report_is_printed_as_json(made, capsys):
    assert main(["sweep", "report", str(made), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["clips"] == 6 and report["statuses"] == {"done": 6}
    assert next(iter(report["by"]["material.E"].values()))[0] == 2
    assert len(report["measures"]["seconds.clip"]) == 3 and Path(report["page"]).is_file()


def test_the_name_of_an_existing_file_is_no_pattern(tmp_path):
    for name in ("duck [1].png", "duck 1.png"):
        (tmp_path / name).touch()
    picture = str(tmp_path / "duck [1].png")
    assert list_matching(picture) == [picture]
    assert list_matching(str(tmp_path / "duck [0-9].png")) == [str(tmp_path / "duck 1.png")]


def test_the_manifest_has_exactly_the_clips_of_the_present_plan(balls, tmp_path):
    def plan(scene, *stiffness):
        axes = {"accuracy.cells": 8, "time.frames": 2, "material.E": [*stiffness]}
        return Plan(declared(balls, pictures=str(balls / "a.ply"), scene=scene, set=axes))

    out = str(tmp_path)
    for scene, stiffness, ended in (
        ("drop", (1e4, 1e5), {"done": 2}),
        ("press", (1e5,), {"done": 1}),
        ("drop", (1e5, 1e6), {"done": 1}),
    ):
        assert run(plan(scene, *stiffness), out, workers=0).ended == ended
        data = Dataset(out)
        assert [row["index"] for row, _ in data] == list(range(len(stiffness)))
        assert [row["set.material.E"] for row, _ in data] == list(stiffness)
        assert [clip.scene["material"]["E"] for _, clip in data] == list(stiffness)
        assert {clip.scene["object"]["lift"] > 0 for _, clip in data} == {scene == "drop"}

    def stop(*_) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        run(plan("bounce", 1e5), out, workers=0, progress=stop)
    assert len(Dataset(out)) == 0, "no clip of this plan is made"


@pytest.mark.slow
def test_a_sweep_over_scenes_of_two_objects(balls, tmp_path):
    """The second object is one of two files, whose content is part of the key."""
    axes = {
        "accuracy.cells": 8,
        "time.frames": 3,
        "objects.0.material.E": [5e4, 1e5],
        "objects.0.file": [str(balls / "a.ply"), str(balls / "b.ply")],
    }
    sweep = declared(balls, pictures=str(balls / "a.ply"), scene="collide", set=axes)
    out = str(tmp_path / "out")
    assert run(Plan(sweep), out, workers=0).ended == {"done": 4}
    again = run(Plan(sweep), out, workers=0)
    assert again.here == 4 and not again.ended
    clips = [entry.clip for entry in Dataset(out)]
    counts = sorted(np.bincount(clip.object_id)[:2].tolist() for clip in clips)
    assert counts == [[60, 60], [60, 60], [60, 80], [60, 80]]
    assert {clip.objects for clip in clips} == {("left", "right")}
    write_ply(tmp_path / "b.ply", ball(80))
    item = next(iter(Plan(sweep)))
    scene = Plan(sweep).scene_of(item)
    copied = scene.replaced({"objects.0.file": str(tmp_path / "b.ply")})
    before = key_of(sweep, item, copied)
    write_ply(tmp_path / "b.ply", ball(81))
    assert key_of(sweep, item, copied) != before


@pytest.mark.slow
def test_python_of_sweeps_md_runs(tmp_path, monkeypatch, capsys):
    page = ROOT / "docs/guide/sweeps.md"
    for name in ("demo", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    shown = [b for b in blocks() if b.page == page]
    (toml,) = [b.text for b in shown if b.words[0] == "toml"]
    assert toml.strip() == (ROOT / "docs/guide/sweep.toml").read_text().strip()
    for block in shown:
        if block.words[0] == "python":
            exec(block.text, {})
    output = capsys.readouterr().out
    assert "duck.png 100000" in output and "mean error of log10 E" in output


@pytest.mark.parametrize("arrives", [False, True])
def test_ray_does_not_keep_its_handler_of_sigterm(monkeypatch, arrives):
    """Ray's handler ends the program with status 15, instead of stopping the sweep."""

    def init(**options) -> None:
        signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(number))
        if arrives:
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(init=init, shutdown=lambda: None))
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Cancelled) if arrives else nullcontext():
        on_ray._ray(None, 2)
    assert signal.getsignal(signal.SIGTERM) is before
