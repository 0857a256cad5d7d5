"""Costs of stages: measured at the start, and not to be spoilt by any single visitor."""

import pytest

from demo.forecast import Estimator
from demo.rates import SPREAD, Learned
from phy124.budget.cost import GAUSSIANS, Work, count_gaussians, count_particles
from phy124.scene import Scene

FEW = {"view.size": 16, "view.views": ["front"], "time.frames": 2}
TINY = Scene.named("press").replaced({**FEW, "accuracy": "draft"})
USUAL = Scene.named("press").replaced({"accuracy": "draft", "view.views": ["front"]})


def _report(scene: Scene, **spent: float) -> dict:
    work = Work.of(scene)
    stages = [{"name": name, "seconds": seconds} for name, seconds in spent.items()]
    return {
        "stages": stages,
        "substeps": work.substeps,
        "frames": work.frames,
        "particles": count_particles(scene, GAUSSIANS),
        "gaussians": count_gaussians(scene, GAUSSIANS),
    }


@pytest.fixture
def learned() -> Learned:
    made = Learned()
    little = _report(TINY, simulate=1e-4 * Work.of(TINY).substeps, render=0.01, encode=0.2)
    much = _report(USUAL, generate=0.8, simulate=1.0, deform=0.2, render=0.4, encode=0.4)
    made.calibrate((little, TINY), (much, USUAL))
    return made


def test_a_run_measured_at_the_start_is_forecast_as_it_was(learned):
    costs = learned.now.seconds(Work.of(USUAL))
    wanted = {"generate": 0.8, "simulate": 1.0, "deform": 0.2, "film": 0.8}
    assert costs == pytest.approx(wanted)


def test_slow_small_run_leaves_the_usual_rate():
    made = Learned()
    little = _report(TINY, simulate=100.0, render=20.0, encode=20.0)
    much = _report(USUAL, generate=0.8, simulate=1.0, deform=0.2, render=0.4, encode=0.4)
    made.calibrate((little, TINY), (much, USUAL))
    costs = made.now.seconds(Work.of(USUAL))
    assert costs == pytest.approx({"generate": 0.8, "simulate": 1.0, "deform": 0.2, "film": 0.8})
    assert made.now.particle > 0 and made.now.pixel > 0


def test_tiny_runs_leave_the_rates(learned):
    before = learned.now
    for _ in range(10):
        learned.learn(_report(TINY, simulate=0.5, render=0.2, encode=0.5), TINY)
    assert learned.now == before


def test_outliers_move_rates_within_bounds(learned):
    before = learned.now
    slow = _report(USUAL, simulate=1000.0, deform=50.0, render=300.0, encode=1.0)
    learned.learn(slow, USUAL)
    assert learned.now == before
    for _ in range(10):
        learned.learn(slow, USUAL)
    assert learned.now.particle == pytest.approx(SPREAD * before.particle)
    assert learned.now.pixel == pytest.approx(SPREAD * before.pixel)


def test_a_machine_that_became_slower_is_believed(learned):
    twice = _report(USUAL, generate=1.6, simulate=2.0, deform=0.4, render=0.8, encode=0.8)
    for _ in range(4):
        learned.learn(twice, USUAL)
    assert sum(learned.now.seconds(Work.of(USUAL)).values()) == pytest.approx(5.6, rel=0.15)


def test_the_cost_of_highlights_is_known_and_corrected(learned):
    scene = Scene.named("metal").replaced({"accuracy": "draft"})
    plain = scene.replaced({"view.shine": False})
    costs = [learned.now.seconds(Work.of(each))["film"] for each in (scene, plain)]
    views, frames = len(scene.view.sides), scene.time.frames
    drawn = count_gaussians(scene) * frames * (1 + views)
    assert costs[0] - costs[1] == pytest.approx(learned.now.shine * drawn)
    for _ in range(4):
        learned.learn(_report(scene, shine=2 * learned.measured.shine * drawn), scene)
    assert learned.now.shine == pytest.approx(2 * learned.measured.shine)


def test_nothing_is_refused_because_of_what_was_learned(learned):
    forecaster = Estimator()
    forecaster.learned = learned
    before = forecaster.minimum(USUAL)
    for _ in range(10):
        learned.learn(_report(USUAL, simulate=900.0, render=900.0), USUAL)
    assert forecaster(USUAL).seconds > 2 * before
    assert forecaster.minimum(USUAL) == before
