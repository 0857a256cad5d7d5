"""Goals and predictions of a run, declared once for both commands."""

import json
import re
from pathlib import Path

import pytest

from phy124.__main__ import main
from phy124.accuracy import companion
from phy124.accuracy.promises import SPREAD, format_percent, promise
from phy124.commands.cutout import PictureOptions
from phy124.commands.generate import Generate, Simulate
from phy124.commands.options import SceneOptions
from phy124.commands.plan import PlanOptions
from phy124.generators.ply_file import Reading
from phy124.io.ply import write_ply
from phy124.scene import Scene
from phy124.simulation.bodies import proportions_of
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
SMALL = ["--frames", "2", "--size", "16", "--views", "front", "--device", "cpu"]
BY_PARTICLES = ["--set", "accuracy.solver=mpm"]
"""For tests of what is said, not of lattices, whose set-up takes a second per grid."""


@pytest.fixture
def file(tmp_path):
    write_ply(tmp_path / "b.ply", ball(100))
    return tmp_path / "b.ply"


def test_both_commands_share_their_options():
    for command in (Generate, Simulate):
        assert command.__dataclass_fields__["plan"].default_factory is PlanOptions


def test_a_dry_run_says_what_would_run_and_writes_nothing(file, tmp_path, capsys):
    out = tmp_path / "o"
    arguments = ["simulate", str(file), "--out", str(out), *SMALL, "--accuracy", "draft"]
    arguments += BY_PARTICLES
    assert main([*arguments, "--dry-run"]) == 0
    said = capsys.readouterr().out
    draft = Scene.named("press").replaced({"accuracy": "draft", "time.frames": 2})
    scene = draft.replaced({"accuracy.solver": "mpm"})
    promised = promise(scene, proportions_of(ball(100), scene))
    for words in ("scene: neo_hookean (", "particles, ", "s, likely ", promised.sentence):
        assert words in said
    assert main([*arguments, "--dry-run", "--json"]) == 0
    output = json.loads(capsys.readouterr().out)
    assert output["scene"]["time"]["frames"] == 2 and output["seconds"] > 0
    assert output["promise"]["error"] == promised.error
    assert output["span"][0] < output["seconds"] < output["span"][1]
    assert not out.exists()


@pytest.mark.parametrize(("command", "source"), [("simulate", "{file}"), ("generate", str(DUCK))])
def test_a_dry_run_refuses_an_output_folder_that_is_a_file(command, source, file, capsys):
    arguments = [command, source.format(file=file), "--out", str(file), *SMALL[2:]]
    assert main([*arguments, "--dry-run"]) == 2
    assert f"out = {file}: it is a file." in capsys.readouterr().err


@pytest.mark.slow
def test_forecast_omits_the_own_error_like_the_run(file, capsys, monkeypatch):
    monkeypatch.setattr(companion, "AFFORDABLE", 1e9)
    arguments = [
        "simulate",
        str(file),
        *SMALL[2:],
        "--frames",
        "3",
        "--dry-run",
        "--json",
        *BY_PARTICLES,
    ]
    stages = []
    for more in ([], ["--no-error"]):
        assert main([*arguments, "--accuracy", "draft", *more]) == 0
        stages.append(json.loads(capsys.readouterr().out)["stages"])
    assert "companion" in stages[0] and "companion" not in stages[1]


def test_missing_error_names_the_study_of_this_scene(file, capsys):
    arguments = ["simulate", str(file), *SMALL, "--accuracy", "draft", "--dry-run"]
    change = ["--set", "material.extension=0.3"]
    assert main([*arguments, "--scene", "snow", *change]) == 0
    study = f"`phy124 accuracy snow --image {file} --frames 2 {' '.join(change)}` measures it."
    assert study in capsys.readouterr().out


def test_study_command_has_every_object_and_option():
    scene, pictures = SceneOptions(scene="collide", seed=3), (Path("a.png"), (Path("b.png"),))
    made = Generate(*pictures, options=scene, making=PictureOptions(gaussians=9))
    assert made._study() == (
        "phy124 accuracy collide --image a.png --more b.png --gaussians 9 --set seed=3"
    )
    read = Simulate(*pictures, options=scene, reading=Reading(up="y", floor=True))
    assert read._study() == (
        "phy124 accuracy collide --image a.png --more b.png --up y --floor --set seed=3"
    )
    still = Simulate(Path("a.png"), options=SceneOptions(scene="drop", frames=1))
    assert still._study() == "phy124 accuracy drop --image a.png --frames 1"


@pytest.mark.slow
def test_a_dry_run_tells_the_grid_that_a_time_leads_to(file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("phy124.accuracy.choose.CELLS", (8, 10))
    monkeypatch.setattr("phy124.accuracy.choose.START", 8)
    arguments = ["simulate", str(file), "--out", str(tmp_path / "o"), *SMALL, *BY_PARTICLES]
    arguments += ["--dry-run"]
    assert main([*arguments, "--max-seconds", "1000"]) == 0
    printed = capsys.readouterr().out
    assert "asked for at most 1000 s: D/" in printed
    assert re.search(r"^ +particles +\S+ s +\(measured\)$", printed, re.MULTILINE)
    assert main([*arguments, "--max-error", "2%"]) == 2
    assert "Remove --dry-run" in capsys.readouterr().err
    assert main([*arguments[:-1], "--max-error", "2%", "--forecast"]) == 2
    assert "Remove --forecast" in capsys.readouterr().err


def test_simulate_meets_a_time_and_compares_its_forecast(file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("phy124.accuracy.choose.CELLS", (8, 10))
    monkeypatch.setattr("phy124.accuracy.choose.START", 8)
    arguments = ["simulate", str(file), "--out", str(tmp_path / "o"), *SMALL, *BY_PARTICLES]
    assert main([*arguments, "--max-seconds", "1000", "--forecast"]) == 0
    assert "asked for at most 1000 s: D/" in capsys.readouterr().out
    report = json.loads((tmp_path / "o/report.json").read_text())
    assert report["goal"]["cells"] in (8, 10) and report["forecast"]["predicted"] > 0
    assert main([*arguments, "--accuracy", "draft", "--forecast"]) == 0
    assert "predicted " in capsys.readouterr().out


@pytest.mark.slow
def test_a_run_with_an_error_goal_names_one_error(file, tmp_path, capsys, monkeypatch):
    """The one that it has measured, not that of other objects, whatever the grid."""
    monkeypatch.setattr("phy124.accuracy.choose.CELLS", (8, 10, 12, 14, 16))
    monkeypatch.setattr("phy124.accuracy.choose.FIRST", (8, 10, 12))
    out = tmp_path / "o"
    assert main(["simulate", str(file), "--out", str(out), *SMALL, "--max-error", "9%"]) == 0
    said = capsys.readouterr().out
    error = json.loads((out / "report.json").read_text())["goal"]["fraction"]
    assert "1 m over as many cells as 9% needs, " in said
    assert "asked for an error of at most 9%: D/8 meets it; estimated errors: D/8 " in said
    size = f"about {format_percent(error)} of the object's size"
    assert f"off by {size}, at most {format_percent(SPREAD * error)}. Measured" in said


def test_a_time_that_cannot_be_met_says_what_can(file, tmp_path, capsys):
    arguments = ["simulate", str(file), "--out", str(tmp_path / "o"), *SMALL, *BY_PARTICLES]
    assert main([*arguments, "--max-seconds", "0.01"]) == 2
    said = capsys.readouterr().err
    assert "the coarsest grid, D/8, takes about " in said
    assert "Use --max-seconds " in said and "time.frames = 2" not in said


def test_causes_of_slow_runs_are_named_before_them(file, tmp_path, capsys):
    (tmp_path / "s.toml").write_text(
        "[[parts]]\nregion = {upper = [9, 9, 0.2]}\nmaterial = {law = 'rigid'}\n"
        "[material]\nlaw = 'neo_hookean'\nE = 1e4\n"
    )
    arguments = ["simulate", str(file), "--scene", str(tmp_path / "s.toml"), *SMALL, "--dry-run"]
    assert main([*arguments, "--set", "accuracy={cells=8}"]) == 0
    said = capsys.readouterr().out
    assert "note: parts.0.material (rigid) is so stiff that it needs" in said
    assert "parts.0.static = true" in said
