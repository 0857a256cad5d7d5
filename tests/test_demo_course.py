"""A run that the page's time limit will end says so before it starts and while it runs."""

from dataclasses import replace
from pathlib import Path

import pytest

from demo.course import SIMULATING, Course, easier
from demo.jobs import Studio
from demo.line import Job
from demo.progress import Progress, Step
from demo.settings import Settings
from demo.source import Choice, Cutout
from demo.visitors import Visitors
from phy124.accuracy.load import QUIET
from phy124.budget.cost import Rates
from phy124.scene import Scene

LONG = Course(motion=252.0, after=20.0, frames=72, limit=180.0, remedy="Choose draft accuracy.")


def test_the_frames_within_the_limit_are_counted():
    assert LONG.ended and LONG.kept == 36
    assert LONG.seconds == pytest.approx(SIMULATING * 180 + 10)
    assert LONG.warning == (
        "The limit of 180 s will end this run after about 36 of its 72 frames. "
        "Choose draft accuracy."
    )


def test_a_run_within_the_limit_has_no_warning():
    short = Course.of(Scene.named("press"), 140.0, 20.0, 180.0)
    assert (short.ended, short.kept, short.seconds, short.warning) == (False, short.frames, 140, "")


def test_the_frames_of_a_run_correct_its_forecast():
    """A run that was forecast to be short is slow, and the other way round."""
    short = Course(10.0, 2.0, 72, 180.0, "Choose fewer frames.")
    assert short.observe(3, 70.0, 60.0) is short  # compiling took long, and it is too early to say
    assert short.observe(6, 90.0, 60.0).motion == pytest.approx(90 + 66 * 6)
    assert short.observe(6, 90.0, 60.0).warning.startswith("The limit of 180 s will end this run")
    assert LONG.observe(36, 40.0, 5.0).warning == ""
    assert LONG.observe(1, 40.0, 5.0) is LONG and LONG.observe(72, 40.0, 5.0) is LONG


def test_the_progress_of_a_run_ends_at_the_limit(monkeypatch):
    progress = Progress(expected=272.0, course=LONG)
    data = progress.data()
    assert data["expected"] == pytest.approx(136) and data["warning"] == LONG.warning
    assert progress.duration([]) == pytest.approx(136)
    for done, seconds in ((1, 5), (36, 40)):
        monkeypatch.setattr(
            "demo.progress.time.monotonic", lambda seconds=seconds: progress.start + seconds
        )
        progress.take(Step("simulate", done, 72))
    assert progress.data()["warning"] == "" and progress.data()["expected"] == pytest.approx(96)
    assert Progress(expected=3.0).data()["warning"] == ""


def test_a_shortened_run_does_not_correct_the_waiting_times():
    job = Job("run", Path("/nowhere/stop"), expected=272.0)
    job.progress.course = LONG
    job.end("done")
    assert not job.progress.whole
    job.progress.course = None
    assert job.progress.whole


def test_the_forecast_warns_of_the_limit(tmp_path, monkeypatch):
    """Other programs make a run too long that an idle machine would finish."""
    from demo.handlers.run import show_estimate

    changes = {"accuracy": {"cells": 16}, "time.frames": 72, "material.E": 1e6}
    scene = Scene.named("press").replaced(changes)
    studio = Studio(Settings(), Visitors(tmp_path))
    least, rates = studio.forecaster.minimum(scene), Rates()
    studio.settings = Settings(max_seconds=1.1 * least)
    slow = replace(rates, particle=8 * rates.particle, substep=8 * rates.substep)
    monkeypatch.setattr(studio.forecaster.learned, "now", slow)
    monkeypatch.setattr(studio.forecaster, "load", lambda: QUIET)
    estimate = studio.forecast(Choice("a", Cutout("/gone", "/gone"), scene.data()))
    assert estimate.course is not None and estimate.course.ended
    html = show_estimate(estimate)
    assert html.startswith('<p class="ends">The limit of ') and easier(scene) in html
    assert estimate.course.seconds < estimate.seconds
