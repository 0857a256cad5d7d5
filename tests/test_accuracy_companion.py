"""A run's own error: from a companion on a coarser grid, if that is cheap; the run is unchanged."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from phy124.accuracy import companion
from phy124.accuracy.companion import Factors, coarsen, estimate, forecast, with_own_error
from phy124.accuracy.promises import promise
from phy124.particles.thickness import Proportions
from phy124.pipeline import simulate
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

PARTICLES = {"accuracy": {"cells": 16, "solver": "mpm"}}
SCENE = Scene.named("press").replaced({**PARTICLES, "time.frames": 5})
TIMES = np.arange(4) / 10


@pytest.fixture(scope="module")
def run():
    simulation = Simulation(prepare(ball(300), SCENE))
    return simulation, simulation.run()


@pytest.mark.parametrize(
    ("distances", "about", "until"),
    [
        ([0.0, 0.02, 0.02, 0.02], 2 * np.sqrt(3 * 0.02**2 / 4), None),
        ([0.0, 0.2, 0.02, 0.02], 2 * np.sqrt((0.2**2 + 2 * 0.02**2) / 4), None),
        ([0.0, 0.03, 0.03, 0.5], 2 * np.sqrt(2 * 0.03**2 / 3), 0.3),
        ([0.0, 0.03, 0.5, 0.5], None, 0.2),
    ],
)
def test_error_is_that_before_the_grids_part(distances, about, until):
    result = estimate(np.array(distances), TIMES, Factors(2.0, 3.0))
    if about is None:
        assert result == (None, None, until)
    else:
        assert result == (pytest.approx(about), pytest.approx(1.5 * about + companion.FLOOR), until)


def test_expected_error_limits_the_bound_from_below():
    distances, factors = np.full(4, 1e-3), Factors(1.0, 2.0)
    _, alone, _ = estimate(distances, TIMES, factors)
    assert alone == pytest.approx(2e-3 + companion.FLOOR)
    assert estimate(distances, TIMES, factors, 0.001)[1] == alone
    assert estimate(distances, TIMES, factors, 0.01)[1] == pytest.approx(companion.LEAST * 0.01)


def test_own_error_leaves_the_run_unchanged(run, monkeypatch):
    monkeypatch.setattr(companion, "AFFORDABLE", 1e3)
    simulation, clip = run
    after = with_own_error(simulation, clip)
    stated = after.report["error"]
    assert (
        0 < stated["about"] < stated["at_most"] and stated["cells"] == 8 and not stated["why_not"]
    )
    assert after.means is clip.means
    same = ("error", "effects")
    assert {k: v for k, v in after.report.items() if k not in same} == {
        k: v for k, v in clip.report.items() if k not in same
    }
    assert "own error, from D/8" in after.report["effects"]["ran"][-1]
    entry = promise(SCENE, Proportions(0.5, 0.3), after.report)
    assert entry.error == stated["at_most"] and entry.about == stated["about"]
    assert entry.sentence.startswith("This run is off by about ")


def test_companion_follows_the_same_gaussians(run):
    simulation, clip = run
    indices = companion._sample(simulation.setup)
    again = companion._prepare(simulation.setup, SCENE)
    assert companion._distances(again, clip, indices).max() < 1e-5


def test_companion_reuses_the_placed_object_and_binds_no_frame(run, monkeypatch):
    simulation, clip = run

    def refuse(*_, **__):
        raise AssertionError

    for name in ("bodies.clean", "bodies.find_interior", "run.Deformer"):
        monkeypatch.setattr(f"phy124.simulation.{name}", refuse)
    setup = companion._prepare(simulation.setup, SCENE)
    assert setup.interiors[0][0] is simulation.setup.interiors[0][0]
    indices = companion._sample(simulation.setup)
    assert len(companion._distances(setup, clip, indices)) == SCENE.time.frames


def test_companion_uses_only_threads_that_pay(run, monkeypatch):
    setup = replace(run[0].setup, threads=4)
    assert companion._prepare(setup, coarsen(SCENE)).threads == 1
    for particles, threads in ((300, 1), (40, 2), (1, 4)):
        monkeypatch.setattr(companion, "MIN_PARTICLES", particles)
        monkeypatch.setattr(companion, "count_particles", lambda setup: 90)
        assert companion.count_threads(setup) == threads


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"omit": "not wanted"}, "not wanted"),
        ({"affordable": 1e-9}, "of the simulation time"),
        ({"fail": True}, "companion run on D/8 failed"),
    ],
)
def test_missing_own_error_has_a_reason(run, monkeypatch, change, why):
    simulation, clip = run
    monkeypatch.setattr(companion, "AFFORDABLE", change.get("affordable", 1e3))
    if "fail" in change:

        def stop(*_):
            raise MemoryError

        monkeypatch.setattr(companion, "_distances", stop)
    report = with_own_error(simulation, clip, omit=change.get("omit", "")).report
    assert report["error"]["about"] is None and why in report["error"]["why_not"]
    assert report["effects"]["left_out"][-1]["why"] == report["error"]["why_not"]
    assert report["notes"] == clip.report["notes"], "the promise has the reason"
    assert not promise(SCENE, Proportions(0.5, 0.3), report).of_scene


def test_torn_run_has_no_own_error(run, monkeypatch):
    simulation, clip = run
    monkeypatch.setattr(companion, "AFFORDABLE", 1e3)
    monkeypatch.setattr(companion, "_compare", None)  # nor does its companion run
    balance = {**clip.report["balance"], "tearing": {"likely": True}}
    torn = with_own_error(simulation, clip.with_report({**clip.report, "balance": balance}))
    stated = torn.report["error"]
    assert stated["about"] is None and stated["at_most"] is None and "torn" in stated["why_not"]


def test_coarse_positions_have_no_own_error(tmp_path):
    result = simulate(ball(300), SCENE, tmp_path, about={"capture": {"coarse": True}}, films=False)
    assert "too little precision" in result.report["error"]["why_not"]
    assert promise(SCENE, None, result.report).error is None


@pytest.mark.slow
def test_forecast_of_the_companion_depends_on_the_solver(run):
    scene = SCENE.replaced({"accuracy": {"cells": 8, "solver": "lattice"}})
    lattice, (mpm, _) = Simulation(prepare(ball(100), scene)), run
    longer = [forecast(each, 1, 10**4) / forecast(each, 1, 0) for each in (lattice, mpm)]
    assert longer[0] > 2 > longer[1], "each point of a lattice takes time to prepare"


def test_own_error_of_a_goal_is_that_of_its_grids(run):
    goal = {"unit": "pixels", "fraction": 0.01, "cells": 16, "levels": [12, 16], "why_not": ""}
    report = with_own_error(*run, goal=goal).report
    assert (report["error"]["about"], report["error"]["cells"]) == (0.01, None)
    assert "--max-error" in report["effects"]["ran"][-1]
    said = promise(SCENE, None, {**report, "goal": goal})
    assert said.error == report["error"]["at_most"] and said.why == "Measured on D/12 and D/16."
    torn = with_own_error(*run, goal={**goal, "fraction": None, "why_not": "torn"}).report
    assert torn["error"]["about"] is None and torn["error"]["why_not"] == "torn"


@pytest.mark.parametrize("cost", [0.2001, 0.203, 0.31])
def test_sentence_distinguishes_cost_from_its_limit(run, monkeypatch, cost):
    monkeypatch.setattr(companion, "forecast", lambda *_: cost)
    why = with_own_error(*run).report["error"]["why_not"]
    took, limit = re.findall(r"[\d.]+ %", why)
    assert took != limit and float(limit.split()[0]) == 20


def test_companion_on_a_lattice_may_take_a_larger_part(run):
    simulation, _ = run
    lattice = SimpleNamespace(scene=SCENE.replaced({"accuracy": {"cells": 8, "solver": "lattice"}}))
    assert companion.affordable(lattice) == 1.5 * companion.affordable(simulation)


def test_small_runs_have_no_companion(run):
    simulation, _ = run
    assert forecast(simulation, 100) > companion.affordable(simulation)


def test_no_error_is_reported_as_left_out(tmp_path):
    result = simulate(ball(300), SCENE, tmp_path, error=False, films=False)
    assert {"effect": "own error", "why": "--no-error turns the estimate off"} in result.report[
        "effects"
    ]["left_out"]
    assert "companion" not in [stage["name"] for stage in result.report["stages"]]
