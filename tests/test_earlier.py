"""A second run into the same folder: what the first one left goes, what the user put stays."""

import json

import pytest

from phy124 import pipeline
from phy124.errors import InputError
from phy124.pipeline.run_folder import list_results, remove_results
from phy124.scene import Scene
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

SCENE = Scene().replaced({"time.frames": 2, "accuracy": {"cells": 8}, "view.size": (16, 16)})


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_films_of_an_earlier_run_go_when_the_new_ones_are_there(tmp_path):
    sides = SCENE.replaced({"view.views": ["front", "back"]})
    first = pipeline.simulate(ball(200), sides, tmp_path)
    assert set(first.report["files"]) == names(tmp_path) >= {"front.mp4", "back.mp4"}
    (tmp_path / "mine.mp4").write_bytes(b"the user's")
    second = pipeline.simulate(ball(200), SCENE.replaced({"view.views": ["front"]}), tmp_path)
    assert names(tmp_path) == {*second.report["files"], "mine.mp4"}
    assert "back.mp4" not in second.report["files"]


def test_a_run_that_fails_leaves_the_earlier_results(tmp_path, monkeypatch):
    pipeline.simulate(ball(200), SCENE.replaced({"view.views": ["back"]}), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(progress, *_):
        raise ZeroDivisionError(progress)

    with pytest.raises(ZeroDivisionError):
        pipeline.simulate(ball(200), SCENE, tmp_path, progress=fail)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_two_runs_at_once_in_a_folder_are_not_mixed(tmp_path):
    refusals = []

    def start_another(*_):
        with pytest.raises(InputError, match="another run is writing") as caught:
            pipeline.simulate(ball(200), SCENE.replaced({"view.views": ["back"]}), tmp_path)
        refusals.append(caught.value)

    made = pipeline.simulate(ball(200), SCENE, tmp_path, progress=start_another)
    assert refusals and names(tmp_path) == set(made.report["files"])
    pipeline.simulate(ball(200), SCENE, tmp_path)


@pytest.mark.parametrize(
    "report",
    ['{"files": ["../kept", "/kept", "..", ".", "", "a/b", 3, null]}', "[]", "not JSON", "{}"],
)
def test_a_strange_report_removes_nothing(tmp_path, report):
    (tmp_path / "kept").touch()
    out = tmp_path / "out"
    out.mkdir()
    (out / "report.json").write_text(report)
    remove_results(out, list_results(out))
    assert names(tmp_path) == {"kept", "out"} and names(out) == {"report.json"}


def test_folders_of_pictures_go_and_links_are_not_followed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "picture.png").touch()
    out = tmp_path / "out"
    (out / "front").mkdir(parents=True)
    (out / "front" / "0000.png").touch()
    (out / "left").symlink_to(tmp_path / "mine")
    (out / "report.json").write_text(json.dumps({"files": ["front", "left", "gone.mp4"]}))
    remove_results(out, list_results(out))
    assert names(out) == {"report.json"} and names(tmp_path / "mine") == {"picture.png"}
