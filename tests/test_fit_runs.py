"""Runs of a fit, which are kept, and the report of their values."""

import shutil
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from phy124.errors import Cancelled, InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import WHOLE
from phy124.progress import silent
from phy124.scene import Scene
from phy124.studies.fit import budget, running
from phy124.studies.fit.budget import Budget, Outlook
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.estimate import Estimate
from phy124.studies.fit.report import format_table, make_report
from phy124.studies.fit.running import SCENE, fit
from phy124.studies.fit.runs import Runs
from phy124.studies.fit.target import Target
from support.clips import falling
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")


class Heights:
    """Stands in for runs of a scene: E and the grid are what is measured; a stiff one fails."""

    def __init__(self):
        self.calls = 0

    def __call__(self, scene):
        self.calls += 1
        result = np.array([scene["material"]["E"], scene["accuracy"]["cells"]], float)
        return (None if result[0] > 9e4 else result), 0.25


def runs_in(folder, progress=silent, colours=1.0, times=1.0):
    """Runs whose player is a stand-in."""
    _, rest = falling()
    n = len(rest)
    cube = Gaussians.from_rgb(
        rest, np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.1), np.ones(n), colours * rest
    )
    declared = Fit.from_data({"target": "x", "find": {"material.E": "1e4..1e5"}})
    seen = SimpleNamespace(
        measured=np.zeros(2), groups=np.arange(2), kinds=[], times=times * np.arange(2)
    )
    target = SimpleNamespace(
        declared=declared, observations=seen, played=Scene(), gaussians=cube, crop=WHOLE
    )
    runs = Runs(cast(Target, target), folder, Budget(60), progress)
    runs.player = Heights()
    return runs


def test_each_run_is_made_once_and_kept(tmp_path):
    runs = runs_in(tmp_path)
    places = [np.array([0.0]), np.array([0.5]), np.array([1.0])]
    low, middle, stopped = runs.predict(places, 0)
    assert (low[0], low[1], round(middle[0])) == (1e4, 16, 31623)
    assert stopped is None
    assert runs.predict(places[:1], 1)[0][1] == 24
    again = runs_in(tmp_path)
    assert np.array_equal(again.predict(places, 0)[1], middle)
    assert (again.player.calls, again.kept, again.made) == (0, 3, [0, 0])
    assert runs.made == [3, 1]
    assert runs.seconds == 1.0


def report_of(folder, *places, sampling, cells=32):
    """Report of a fit of E in 1e4..1e5 with these places on the grids 16 and 24."""
    runs, size = runs_in(folder), np.array([sampling])
    estimated = Estimate(
        places=tuple(np.array([place]) for place in places),
        misfits=tuple([] for _ in places),
        grids=(16, 24)[: len(places)],
        sampling=size,
        model=0 * size,
        correlation=np.eye(1),
        notes=(),
    )
    scene = Scene().replaced({"accuracy.cells": cells})
    target = SimpleNamespace(scene=scene, declared=Fit.from_data(
        {"target": "x", "find": {"material.E": "1e4..1e5"}}))  # fmt: skip
    clip = SimpleNamespace(report={"complete": False, "stopped": "stopped"})
    return make_report(target, runs, estimated, clip, seconds=1.0)


def test_values_beyond_their_range_are_reported_with_a_note(tmp_path):
    report = report_of(tmp_path, 0.8, 0.95, sampling=0.01)
    limit = report["found"]["material.E"]["limit"]
    assert limit["value"] == pytest.approx(1e4 * 10**1.25, rel=1e-4)
    assert limit["interval"][1] == pytest.approx(1e4 * 10**1.56, rel=1e-4)
    assert report["notes"][0].startswith("A value of material.E was extrapolated from the grids")
    wide = report_of(tmp_path, 0.95, 0.95, sampling=0.1)
    assert wide["notes"][0].startswith("The interval of material.E is extrapolated beyond")
    assert len(report_of(tmp_path, 0.5, 0.5, sampling=0.1)["notes"]) == 1


def test_a_scene_coarser_than_the_grids_of_a_fit_is_noted(tmp_path):
    notes = report_of(tmp_path, 0.5, 0.5, sampling=0.1, cells=10)["notes"]
    assert notes[0].startswith("The scene has 10 cells, fewer than the grids of the fit")
    assert notes[0].endswith("give --grids 10,16.")
    assert report_of(tmp_path, 0.5, 0.5, sampling=0.1, cells=16)["notes"] == notes[1:]


def test_a_fit_on_a_single_grid_names_no_other_grid(tmp_path):
    head, row, *_ = format_table(report_of(tmp_path, 0.5, sampling=0.1)).splitlines()
    assert " ".join(head.split()) == "value on 16 cells 95 %"
    assert row.split()[:2] == ["material.E", "3.162e+04"]
    head, *_ = format_table(report_of(tmp_path, 0.5, 0.5, sampling=0.1)).splitlines()
    assert "on 32 cells" in head and "without grid error" in head


def test_the_first_preparation_is_forecast_once_per_process(monkeypatch):
    def again(gaussians, scene, context, **_):
        context.watch.add({"particles": 0.5}, 0.5)

    stages = {"particles": 8.5, "simulate": 1.0, "deform": 0.5}
    monkeypatch.setattr(budget, "prepare", again)
    monkeypatch.setattr(
        budget.Forecaster, "forecast", lambda *_, **__: SimpleNamespace(stages=stages)
    )
    alone, two = (budget.make_outlook(ball(60), [Scene()] * 2, 1, n) for n in (1, 2))
    assert alone.each == two.each == (2.0, 2.0)
    assert alone.wall(6) == 2 * sum(alone.runs(6))
    assert two.wall(6) == alone.wall(6) / 2 + budget.STARTING + 16.0


@pytest.mark.parametrize("changed", ["colours", "times"])
def test_runs_of_other_inputs_are_not_reused(tmp_path, changed):
    runs_in(tmp_path).predict([np.array([0.5])], 0)
    again = runs_in(tmp_path, **{changed: 0.5})
    again.predict([np.array([0.5])], 0)
    assert (again.kept, again.player.calls) == (0, 1)


def test_a_cancelled_fit_keeps_its_runs(tmp_path):
    def stop(stage, done, total):
        if done == 1:
            raise Cancelled

    with pytest.raises(Cancelled):
        runs_in(tmp_path, stop).predict([np.array([0.0]), np.array([0.5])], 0)
    again = runs_in(tmp_path)
    again.predict([np.array([0.0]), np.array([0.5])], 0)
    assert (again.kept, again.player.calls) == (1, 1)


def test_lack_of_disk_space_is_reported_before_a_fit(tmp_path, monkeypatch):
    target = _named("object.lift")
    target.film = None
    monkeypatch.setattr(running, "Target", lambda declared: target)
    monkeypatch.setattr(running, "_outlook", lambda *_: Outlook((8,), (0.0,), 1, 1))
    monkeypatch.setattr(running, "estimate", lambda *_, **__: 1 / 0)
    usage = shutil.disk_usage(tmp_path)._replace(free=100)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    words = "need about .* has only 100 bytes of free space; after a full disk, the same command"
    with pytest.warns(UserWarning, match=words), pytest.raises(ZeroDivisionError):
        fit(target.declared, tmp_path / "out")


def test_a_path_that_is_no_field_is_refused_before_any_run(tmp_path):
    with pytest.raises(InputError, match=r"material\.stiff"):
        Runs(cast(Target, _named("material.stiff")), tmp_path, Budget(60))
    with pytest.raises(InputError, match=r"material\.nu"):
        Runs(cast(Target, _named("material.nu")), tmp_path, Budget(60))
    assert not any(tmp_path.iterdir())


def test_a_fit_does_not_replace_a_scene_that_it_reads(tmp_path):
    scene = tmp_path / SCENE
    scene.write_text(Scene().to_toml())
    options = {"target": str(tmp_path), "scene": str(scene), "find": {"material.E": "1e4..1e5"}}
    with pytest.raises(InputError, match="name of a file that this command reads"):
        fit(Fit.from_data(options), tmp_path)


def _named(path):
    declared = Fit.from_data({"target": "x", "find": {path: "0.2..0.9"}})
    seen = SimpleNamespace(measured=np.zeros(2), groups=np.arange(2), kinds=[])
    return SimpleNamespace(
        declared=declared, observations=seen, played=Scene(), gaussians=None, crop=WHOLE
    )
