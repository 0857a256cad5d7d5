"""phy124.pipeline.inputs: a run is resumed only with the files and options of its objects."""

import shutil
from pathlib import Path

import pytest

from phy124 import pipeline
from phy124.__main__ import main
from phy124.errors import Cancelled
from phy124.io.ply import write_ply
from phy124.scene import Scene
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
OPTIONS = [
    *("--scene", "press", "--frames", "3", "--size", "32", "--views", "front", "--device", "cpu"),
    *("--stage", "plain", "--set", "accuracy={cells=8}", "time.sleep=false"),
]
CHANGES = {
    "accuracy": {"cells": 8},
    "time.frames": 3,
    "time.sleep": False,
    "view.size": 32,
    "view.views": ["front"],
    "view.stage": "plain",
}


def cancel(stage, done, total):
    if (stage, done) == ("simulate", 2):
        raise Cancelled


def test_resume_refuses_other_files_and_options(tmp_path, capsys):
    picture, out = tmp_path / "picture.png", tmp_path / "out"
    shutil.copy(DUCK, picture)
    scene = Scene.named("press").replaced(CHANGES)
    pipeline.generate(picture, scene, out, count=1000, progress=cancel, keep=True)
    command = ["generate", str(picture), *OPTIONS, "--out", str(out), "--resume"]
    same = [*command, "--gaussians", "1000", "--threads", "1"]
    write_ply(tmp_path / "ball.ply", ball(300))
    for words, said in (
        (command, "has gaussians = 1000, not default"),
        ([*same, "--thickness", "0.5"], "has thickness = default, not 0.5"),
        ([*same, "--generator", str(tmp_path / "ball.ply")], "another file than the present gener"),
        ([*same, "--mask", str(DUCK)], "another file than the present mask"),
    ):
        assert main(words) == 2
        assert said in capsys.readouterr().err
    shutil.copy(DUCK.with_name("teddy.png"), picture)
    assert main(same) == 2
    assert "another file than the present input 1" in capsys.readouterr().err
    picture.unlink()
    assert main(same) == 2
    assert "the input 1 cannot be read and compared" in capsys.readouterr().err
    shutil.copy(DUCK, picture)
    assert main(same) == 0
