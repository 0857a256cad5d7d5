import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from phy124.__main__ import main
from phy124.accuracy.convergence import Convergence
from phy124.accuracy.promises import Promise, format_percent
from phy124.commands.accuracy import KEPT, ShowAccuracy
from phy124.commands.cutout import PictureOptions
from phy124.errors import Cancelled, InputError
from phy124.io.ply import write_ply
from phy124.monitor.tearing import Tearing
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Stopped, prepare
from phy124.studies.validation.accuracy import plots
from phy124.studies.validation.accuracy import report as report_of
from phy124.studies.validation.accuracy import study as study_of
from phy124.studies.validation.accuracy.report import (
    Report,
    Row,
    error_on,
    kept_promises,
    recommend,
)
from phy124.studies.validation.accuracy.study import Study
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

LEVELS = (8, 12, 16)
PARTICLES = {"accuracy": {"cells": 16, "solver": "mpm"}}
"""On a lattice, material cannot tear, and the energy lost is not split."""


@pytest.fixture
def levels_alone(monkeypatch):
    """Studies run their levels only, and no variation of the finest."""
    plan = Study._plan

    def levels(self: Study) -> list[tuple[str, Scene]]:
        return [entry for entry in plan(self) if entry[0].startswith("D/")]

    monkeypatch.setattr(Study, "_plan", levels)


@pytest.fixture(scope="module")
def study() -> tuple[Study, Report]:
    scene = Scene.named("drop").replaced(
        {"time.frames": 5, "view.size": 64, **PARTICLES, "object.lift": 0.1}
    )
    made = Study(ball(800), scene, levels=LEVELS)
    return made, made.run()


@pytest.mark.slow
def test_every_level_and_variation_is_run(study):
    names = [row.name for row in study[1].rows]
    assert names == [
        "D/8",
        "D/12",
        "D/16",
        "half the substep at D/16",
        "float64 at D/16",
        "binding particles at D/16",
    ]
    assert not study[1].skipped


def test_liquid_by_projection_is_not_run_with_half_the_substep():
    names = [name for name, _ in Study(ball(10), Scene.named("water"), levels=LEVELS)._plan()]
    assert names[3:] == ["float64 at D/16", "liquid compressible at D/16"]


def test_study_for_a_gpu_varies_the_solver_that_a_gpu_has():
    scene, gpu = Scene.named("press"), RunContext(device="cuda:0")
    plan = dict(Study(ball(10), scene, gpu, levels=LEVELS)._plan())
    assert {each.solver for each in plan.values()} == {"mpm"} and scene.solver == "lattice"
    assert "solver mpm at D/16" not in plan and "binding particles at D/16" in plan


def test_errors_fall_and_hold_the_finest_levels_own(study):
    result = study[1].convergence
    levels = [row for row in study[1].rows if row.level]
    errors = [row.error for row in levels]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == result.error > 0
    apart = levels[0].from_finest
    assert errors == pytest.approx(list(result.errors))
    assert abs(errors[0] / result.factor - apart.relative) < result.error
    assert apart.psnr < levels[1].from_finest.psnr
    assert levels[0].pixels > levels[1].pixels > 0


def test_a_smaller_substep_and_more_digits_buy_nothing(study):
    rows = {row.name: row for row in study[1].rows}
    level = rows["D/16"].error
    assert rows["half the substep at D/16"].substeps > 1.8 * rows["D/16"].substeps
    assert rows["half the substep at D/16"].error > 0.9 * level
    assert rows["float64 at D/16"].error == pytest.approx(level, rel=0.1)


def test_study_loses_energy_and_omits_momentum_in_contact(study):
    for row in study[1].rows:
        assert -0.02 < row.energy_lost < 1
        assert row.angular_momentum_lost is None


def test_study_reports_where_the_energy_went(study):
    for row in study[1].rows:
        inside = row.lost_to["material"] + row.lost_to["numerical"]
        assert inside == pytest.approx(row.energy_lost, abs=1e-6), "walls are not in energy_lost"
        assert row.lost_to["material"] > 0.002, "the ball is damped"
        assert 0 <= row.lost_to["contact"] < 2e-3, "it hardly slides on the ground"
    by_name = {row.name: row.lost_to["numerical"] for row in study[1].rows}
    assert by_name["D/8"] > 2 * by_name["D/16"] > 0, "finer grids lose less"


@pytest.mark.parametrize("settings", ["^D/8|^solver", pytest.param("", marks=pytest.mark.slow)])
def test_unknown_energy_loss_is_not_reported(settings, monkeypatch):
    """By the material point method, walls must be at rest.

    In double precision, the kernels of the lattice would be compiled for this test only.
    """
    plan = Study._plan

    def is_chosen(setting: tuple[str, Scene]) -> bool:
        return re.search(settings, setting[0]) is not None

    monkeypatch.setattr(Study, "_plan", lambda self: filter(is_chosen, plan(self)))
    scene = Scene.named("press").replaced({"time.frames": 2, "view.size": 32})
    report = Study(ball(300), scene, levels=(8,)).run()
    assert all(row.energy_lost is not None for row in report.rows)
    splits = {row.name: row.lost_to is not None for row in report.rows}
    assert splits == {name: name != "solver mpm at D/8" for name in splits}
    assert not all(splits.values())


@pytest.mark.parametrize("solver", ["mpm", "lattice"])
def test_a_free_spin_keeps_its_angular_momentum(solver):
    chosen = {"accuracy": {"cells": 8, "solver": solver}, "time.frames": 3, "view.size": 32}
    scene = Scene.named("spin").replaced(chosen)
    made = Study(ball(300), scene, levels=(8,), thorough=False).run()
    row = made.rows[0]
    assert row.angular_momentum_lost < 1e-4
    assert -1e-3 < row.energy_lost < 0.2
    assert "fewer than three levels" in made.convergence.why_not


def test_too_few_particles_are_refused():
    few = {"accuracy": {"particles_per_axis": 1.0}, "time.frames": 2, "view.size": 32}
    scene = Scene.named("spin").replaced(few)
    with pytest.raises(InputError, match=r"particles_per_axis = 1: with fewer than 1\.5"):
        Study(ball(300), scene, levels=(12,)).run()


@pytest.mark.parametrize("name", ["snow", "sand", "metal", "foam"])
def test_levels_run_with_default_particles(name):
    scene = Scene.named(name).replaced({"time.frames": 2, "view.size": 32})
    assert scene.particles_per_axis == 1.5
    report = Study(ball(300), scene, levels=(8,), thorough=False).run()
    assert [row.name for row in report.rows] == ["D/8"] and not report.skipped


def test_levels_alone_are_run_where_nothing_else_is_asked():
    quick = {**PARTICLES, "time.frames": 3, "view.size": 32, "binding": "lattice"}
    scene = Scene.named("drop").replaced(quick)
    messages = []
    report = Study(
        ball(300),
        scene,
        levels=(8, 10),
        thorough=False,
        context=RunContext(progress=lambda *at: messages.append(at)),
    ).run()
    assert [row.name for row in report.rows] == ["D/8", "D/10"]
    assert all(row.predicted is None and row.from_finest is None for row in report.rows)
    assert messages.count(("study", 1, 2)) > report.rows[1].substeps / 2, "also while it runs"


def test_a_level_that_is_stopped_is_left_out():
    quick = {**PARTICLES, "time.frames": 3, "view.size": 32, "binding": "lattice"}
    scene = Scene.named("drop").replaced(quick)

    def progress(stage: str, done: int, total: int) -> None:
        if (stage, done) == ("study", 1):
            raise Stopped("the time is up")

    report = Study(
        ball(300), scene, levels=(8, 10), thorough=False, context=RunContext(progress=progress)
    ).run()
    assert [row.name for row in report.rows] == ["D/8"]
    assert report.skipped == ("D/10 is left out: the time is up",)


def test_the_error_on_any_grid_follows_from_those_that_were_run():
    errors = {12: 0.08, 16: 0.06, 24: 0.04}
    assert error_on(16, errors, 1.0) == error_on(20, errors, 1.0) == 0.06
    assert error_on(48, errors, 1.0) == pytest.approx(0.02)
    assert error_on(48, errors, 9.0) == pytest.approx(0.01), "no higher order is trusted"
    assert error_on(48, errors, None) == 0.04
    assert error_on(8, errors, 1.0) is None and error_on(8, {}, 1.0) is None


def test_level_that_may_be_torn_is_reported():
    soft = {**PARTICLES, "material.E": 300, "time.frames": 8, "view.size": 32, "binding": "lattice"}
    scene = Scene.named("spin").replaced(soft)
    report = Study(ball(300), scene, levels=(8,), thorough=False).run()
    assert report.rows[0].name == "D/8"
    assert re.match(r"D/8: \d+ particles were stretched \(by up to \d\.\d times", report.skipped[0])


@pytest.mark.slow
def test_a_torn_level_promises_nothing(monkeypatch, tmp_path):
    """However close two grids are: what both tear is not what the material does."""
    likely = property(lambda self: self._model.dx < 1 / 13)
    monkeypatch.setattr(Tearing, "likely", likely)
    quick = {**PARTICLES, "time.frames": 2, "view.size": 32, "binding": "lattice"}
    report = Study(ball(300), Scene.named("drop").replaced(quick), levels=(8, 10, 12, 16)).run()
    rows = {row.name: row for row in report.rows}
    assert all(rows[f"D/{cells}"].error is not None for cells in (8, 10, 12))
    assert report.convergence.errors == tuple(rows[f"D/{cells}"].error for cells in (8, 10, 12))
    torn = [row for row in report.rows if row.torn]
    assert {row.cells for row in torn} == {16}
    assert all(row.error is None and row.from_finest is None for row in torn)
    assert report.promises["draft"] == "none: on D/16 the grid may tear the material"
    assert "D/16" not in report.recommendation
    assert not plots.find_dominated(report.rows) & {row.name for row in torn}
    plots.save_page(report, tmp_path / "a.html")
    points = json.loads(re.search(r"const points = (.*);", (tmp_path / "a.html").read_text())[1])
    assert all(point["error"] is None for point in points if "16" in point["name"])
    assert {point["off"] for point in points if "16" in point["name"]} == {"may be torn"}
    first = points[0]
    assert first["off"] == f"off by about {format_percent(first['error'] / 100)}"


def test_too_few_whole_levels_have_no_order(monkeypatch):
    monkeypatch.setattr(Tearing, "likely", property(lambda self: self._model.dx < 1 / 9))
    quick = {**PARTICLES, "time.frames": 2, "view.size": 32, "binding": "lattice"}
    scene = Scene.named("drop").replaced(quick)
    report = Study(ball(300), scene, levels=(8, 10, 12), thorough=False).run()
    assert report.convergence.order is None
    assert "D/10, D/12 may be torn" in report.convergence.why_not
    assert not any("holds" in said for said in report.promises.values())
    monkeypatch.setattr(Tearing, "likely", property(lambda self: True))
    report = Study(ball(300), scene, levels=(8, 16), thorough=False).run()
    assert report.recommendation == "on every level the grid may tear the material"
    assert report.sentences.count(report.recommendation) == 1
    assert report.promises["draft"].startswith("none: on D/16")


def test_study_has_the_error_that_each_run_states(study):
    stated = {row.name: row.stated for row in study[1].rows}
    assert all("of the simulation time" in stated[f"D/{n}"]["why_not"] for n in LEVELS)
    assert {stated[name] for name in stated if not name.startswith("D/")} == {None}


def test_json_is_whole(study):
    data = json.loads(json.dumps(study[1].data(), allow_nan=False))
    assert len(data["rows"]) == 6
    assert data["convergence"]["order"] == study[1].convergence.order
    assert set(data["promises"]) == {"draft", "standard", "fine"}


def row(cells: int, error: float | None, seconds: float, name: str = "") -> Row:
    return Row(
        name or f"D/{cells}", cells, "float32", 0.6, "particles", 1000, 2.0, 100, seconds, seconds,
        {"elastic": 1.0}, 0.1, None, None, None, error, None,
    )  # fmt: skip


def test_a_promise_that_holds_and_one_that_does_not(monkeypatch):
    result, scene = Convergence(1.0, (0.01,)), Scene.named("press")
    monkeypatch.setattr(report_of, "promise", lambda scene, thickness: Promise(0.06, ""))
    broken = replace(row(32, 0.08, 3), stated={"at_most": 0.09, "until": 0.5})
    said = kept_promises(scene, 0.5, (row(16, 0.05, 1), broken), result)
    assert said["draft"] == "at most 6.0 %, measured 5.0 %: the bound holds"
    assert said["standard"] == (
        "at most 6.0 %, measured 8.0 %: the bound DOES NOT HOLD; "
        "the run itself states at most 9.0 % in the first 0.50 s"
    )
    assert said["fine"] == "not tried"
    monkeypatch.setattr(
        report_of, "promise", lambda scene, thickness: Promise(None, "not measured")
    )
    said = kept_promises(scene, 0.5, (row(16, 0.05, 1),), result)
    assert said["draft"] == "this kind of scene has no expected error; measured here: 5.0 %"
    lost = Convergence(
        None, why_not="no convergence: results on finer grids are no closer together"
    )
    assert kept_promises(scene, 0.5, (row(16, None, 1),), lost)["draft"].startswith(
        "cannot be judged: no con"
    )


def test_the_recommendation_is_the_fastest_that_is_good_enough():
    result = Convergence(1.0, (0.01,))
    rows = (row(16, 0.09, 1.0), row(32, 0.03, 3.0), row(48, 0.02, 9.0))
    assert recommend(rows, result, (4, 4)) == (
        "Recommended: D/32, with an error of about 3.0 % of the object's size in 3.0 s; "
        "D/48 would take 3.0 times as long, with an error of about 2.0 %."
    )
    unknown = Convergence(None, why_not="no convergence: x")
    assert recommend((row(8, 0.3, 0.5), row(16, 0.2, 1.0)), result, (4, 4)) == (
        "Most accurate: D/16, with an error of about 20 % of the object's size in 1.0 s. No grid "
        "is recommended, since none has an error of at most 4.0 %; a finer grid is needed."
    )
    assert "no convergence" in recommend(rows, unknown, (4, 4))


def test_brief_errors_recommend_nothing():
    rows, result = (row(4, 0.001, 0.1), row(6, 0.001, 0.2)), Convergence(1.0, (0.01,))
    assert "coarser than D/8" in recommend(rows, result, (4, 4))
    fine = (row(16, 0.01, 1.0),)
    assert recommend(fine, result, (2, 4)).startswith("Recommended: D/16,")
    for known in ((1, 1), (1, 2), (2, 5)):
        assert f"for only {known[0]} of {known[1]} frames" in recommend(fine, result, known)


def test_setting_worse_than_another_is_dominated():
    rows = (row(16, 0.05, 1), row(32, 0.03, 3), row(32, 0.04, 6, "half the substep at D/32"))
    assert plots.find_dominated(rows) == {"half the substep at D/32"}


def test_the_page_needs_no_network_and_holds_every_point(study, tmp_path):
    plots.save_page(study[1], tmp_path / "a.html", title="<drop>")
    page = (tmp_path / "a.html").read_text()
    assert not re.findall(r"(?:src|href|url)\s*[=(]", page)
    assert set(re.findall(r"https?://[^\s\"']+", page)) == {"http://www.w3.org/2000/svg"}
    assert "<h1>&lt;drop&gt;</h1>" in page
    points = json.loads(re.search(r"const points = (.*);", page)[1])
    assert len(points) == len(study[1].rows)


def test_the_picture_is_small(study, tmp_path):
    pytest.importorskip("matplotlib")
    plots.save_picture(study[1], tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size < 300_000
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (900, 400)


def test_a_study_without_convergence_still_draws(study, tmp_path):
    pytest.importorskip("matplotlib")
    lost = Convergence(
        None, why_not="no convergence: results on finer grids are no closer together"
    )
    bare = replace(study[1], rows=(row(16, None, 1.0),), convergence=lost)
    plots.save_picture(bare, tmp_path / "a.png")
    plots.save_page(bare, tmp_path / "a.html")
    assert "no convergence" in (tmp_path / "a.html").read_text()


def test_levels_that_are_done_survive_an_interrupt():
    """The second level is cancelled in its second frame."""
    messages = []

    def cancel(stage, done, total):
        messages.append(done)
        if messages.count(1) == 3:
            raise Cancelled

    options = {"levels": (6, 8), "context": RunContext(progress=cancel)}
    scene = Scene.named("drop").replaced({**PARTICLES, "time.frames": 3, "view.size": 32})
    report = Study(ball(300), scene, keep=True, **options).run()
    assert report.interrupted and [row.name for row in report.rows] == ["D/6"]
    assert report.skipped[-4] == "D/8 was not run: interrupted." and len(report.skipped) >= 4
    messages.clear()
    with pytest.raises(Cancelled):
        Study(ball(300), scene, **options).run()


@pytest.mark.parametrize("late", [pytest.param("setting", marks=pytest.mark.slow), "comparison"])
def test_levels_that_are_done_survive_an_error(tmp_path, monkeypatch, capsys, levels_alone, late):
    """Memory runs out on the second level, or when the levels are compared."""

    def fail(*_: object, **options: object) -> object:
        raise MemoryError

    def prepare_or_fail(gaussians, scene, *context, **options):
        if late == "setting" and scene.accuracy.cells == 8:
            fail()
        return prepare(gaussians, scene, *context, **options)

    monkeypatch.setattr(study_of, "prepare", prepare_or_fail)
    if late == "comparison":
        monkeypatch.setattr(study_of, "difference", fail)
    write_ply(tmp_path / "b.ply", ball(300))
    command = ["accuracy", "drop", "--levels", "6", "8", "10", "--frames", "2", "--json"]
    command += ["--image", str(tmp_path / "b.ply")]
    command += ["--set", "view.size=32", "accuracy.solver=mpm"]
    assert main([*command, "--device", "cpu", "--out", str(tmp_path / "o")]) == 1
    said = capsys.readouterr()
    assert "there is not enough memory" in said.err and KEPT in said.err
    for kept in (json.loads(said.out), json.loads((tmp_path / "o/accuracy.json").read_text())):
        assert kept["interrupted"] and kept["rows"][0]["name"] == "D/6"
    assert "there is not enough memory" in " ".join(kept["skipped"])


def test_study_has_the_further_objects_of_a_scene(tmp_path):
    for name, count in (("a", 60), ("b", 40)):
        write_ply(tmp_path / f"{name}.ply", ball(count))
    study = ShowAccuracy("collide", tmp_path / "a.ply", (tmp_path / "b.ply",))
    gaussians, *_ = study._object(Scene.named("collide"), RunContext(device="cpu"))
    assert np.bincount(gaussians.object_id).tolist() == [60, 40]
    with pytest.raises(InputError, match="there is no picture of the first"):
        replace(study, image=None)._object(Scene.named("collide"), RunContext())


def test_study_on_the_command_line(tmp_path, capsys, monkeypatch, levels_alone):
    (tmp_path / "s.toml").write_text(
        'accuracy = {cells = 8, solver = "mpm"}\ntime = {frames = 2}\n'
        'view = {size = 32, views = ["front"]}\n'
    )
    arguments = ["accuracy", str(tmp_path / "s.toml"), "--out", str(tmp_path / "o")]
    arguments += ["--levels", "6", "8", "10"]
    seen = []
    plain = study_of.Study.__post_init__

    def looked(self):
        seen.append(self.scene)
        plain(self)

    monkeypatch.setattr(study_of.Study, "__post_init__", looked)
    monkeypatch.setattr(Tearing, "likely", property(lambda self: self._model.dx < 1 / 9))
    arguments += ["--set", "material.E=3e4", "--frames", "3"]
    assert main([*arguments, "--device", "cpu"]) == 0
    assert seen[0].material.E == 3e4 and seen[0].time.frames == 3
    text = capsys.readouterr().out
    assert re.search(r"the two finest levels differ by \d\S* % of the object's size", text)
    assert "fewer than three levels" in text
    assert f"Try `phy124 accuracy {tmp_path}/s.toml --frames 3 --levels 6 8 10 " in text
    assert "--set material.E=3e4 --set accuracy.particles_per_axis=3`" in text
    made = {path.name for path in (tmp_path / "o").iterdir()}
    assert made >= {"accuracy.json", "accuracy.html"}
    assert main(["accuracy"]) == 2
    assert "nothing to study" in capsys.readouterr().err


def test_a_proposed_command_keeps_the_options_of_the_picture():
    making = PictureOptions(generator="triposr", gaussians=5000)
    study = ShowAccuracy("press", Path("duck.png"), making=making)
    report = SimpleNamespace(rows=[SimpleNamespace(cells=n, level=True, torn="") for n in LEVELS])
    advice = study._advice(LEVELS, report, 2.0)
    assert "--image duck.png --generator triposr --gaussians 5000 --levels 12 16 24" in advice


def test_missing_matplotlib_is_a_note(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.setattr(study_of.Study, "_row", lambda *_: (None, "left out"))
    main(["accuracy", "drop", "--levels", "8", "12", "16", "--out", str(tmp_path / "o")])
    lines = capsys.readouterr().out.splitlines()
    (note,) = [line for line in lines if line.startswith("note: accuracy.png was not drawn: this")]
    assert "accuracy.html shows the same figures." in note
    assert lines[-1] == str(tmp_path / "o/accuracy.json")


def test_study_without_levels_has_a_status(tmp_path, capsys, monkeypatch):
    def stop(self, name, scene, progress):
        return None, f"{name} is left out: unstable"

    monkeypatch.setattr(study_of.Study, "_row", stop)
    command = ["accuracy", "drop", "--levels", "8", "12", "16", "--out", str(tmp_path / "o")]
    assert main(command) == 3
    text = capsys.readouterr().out
    assert "no level could be run" in text and "Try" not in text
    assert main([*command, "--json"]) == 3


@pytest.mark.parametrize("levels", [("16",), ("16", "32"), ("16", "16", "32")])
def test_too_few_levels_are_refused_at_once(levels, capsys, monkeypatch):
    monkeypatch.setattr(study_of.Study, "run", None)
    assert main(["accuracy", "drop", "--levels", *levels]) == 2
    error = capsys.readouterr().err
    assert "at least three grids" in error and "--levels 16 24 32" in error


def test_errors_of_a_run_that_parts_hold_until_then(study):
    """The finest level jumps aside in the last two of five frames."""
    made, whole = study
    kept = made.clips["D/16"]
    moved = kept.means.copy()
    moved[3:] += 5
    made.clips["D/16"] = replace(kept, means=moved)
    report = made._conclude(list(whole.rows), ())
    made.clips["D/16"] = kept
    assert report.until == pytest.approx(2 / 24)
    assert "diverge after 0.0833 s" in report.sentences[0]
    assert report.convergence.error < 0.05
    assert all("whole motion" in said or "not" in said for said in report.promises.values())
