"""Panels that ask one question at a time: the server answers each, whatever has become of it."""

import json
from dataclasses import replace
from pathlib import Path
from threading import Lock
from types import SimpleNamespace
from typing import Any

import pytest
from PIL import Image

from demo.jobs import Studio
from demo.line import Job
from demo.settings import Settings
from demo.source import Choice, Cutout
from demo.visitors import UNUSED, Visitors
from demo.work import Done, gaussians_of, made_gaussians
from demo.work.order import folders
from phy124.errors import InputError
from phy124.imaging.painted import WHOLE, crop_of
from phy124.scene import Scene

pytestmark = pytest.mark.usefixtures("coarse_solids")

GONE = "The server no longer has"
TEDDY, DUCK = (Path(__file__).parents[1] / f"demo/examples/{n}.png" for n in ("teddy", "duck"))


@pytest.fixture
def studio(tmp_path, monkeypatch) -> Studio:
    # A run of another test may still hold the device.
    monkeypatch.setattr("demo.jobs.DEVICE", Lock())
    return Studio(Settings(gaussians=1000), Visitors(tmp_path))


@pytest.fixture
def handlers(monkeypatch, gradio):
    """The page's handlers, for visitor a."""
    from demo import handlers

    for module in (handlers.event, handlers.picture, handlers.results):
        monkeypatch.setattr(module, "visitor_of", lambda _: "a")
    return handlers


@pytest.fixture
def sources(studio) -> list[Cutout]:
    """Two objects of visitor a."""
    studio.visitors.get("a")
    sent = [studio.visitors.store("a", path.read_bytes(), ".png") for path in (TEDDY, DUCK)]
    jobs = [studio.cut_out("a", str(path)) for path in sent]
    assert all(job.wait(60) for job in jobs)
    return [job.progress.result for job in jobs]


def _event(**data: Any) -> Any:
    import gradio

    return gradio.EventData(None, data)


def test_a_forgotten_job_is_answered(studio, handlers):
    """The state after a restart between the end of a job and the request for its result."""
    lost = _event(job="forgotten", option="side", ask=3)
    shown, source, _ = handlers.on_cut_end(studio)({"job": "forgotten"}, None, lost, None)
    assert GONE in shown["message"] and shown["job"] is None and source is None
    answer = handlers.on_view_cut(studio)(lost, None)["answer"]
    assert GONE in answer["message"] and (answer["option"], answer["ask"]) == ("side", 3)
    history = handlers.on_job_end(studio)(None, None, None, None, None, lost, None)[-1]
    assert history == {"runs": []}


def test_a_result_outlives_runs_that_are_cancelled(studio, handlers, monkeypatch):
    """Else who reloads the page after ten cancelled runs finds it empty."""
    visitor = studio.visitors.get("a")
    done = Done(*(visitor.folder / name / "x" for name in ("clips", "films", "studies")))
    monkeypatch.setattr(handlers.results, "_is_there", lambda result: result == done)
    monkeypatch.setattr(handlers.results, "results", lambda *_: ["shown"])
    for kind, result, state in (
        ("run", done, "done"),
        *10 * [("run", None, "stopped")],
        *10 * [("cut", None, "done")],
    ):
        job = Job(kind, visitor.new_stop_file())
        job.end(state, result=result)
        visitor.remember(job)
    assert len(visitor.jobs) == 16
    answer = handlers.on_load(studio)(None)
    assert answer[-1] == "shown" and done in answer


def test_a_result_without_its_clip_is_not_listed(studio, handlers, gradio):
    """More films than clips are kept."""
    visitor = studio.visitors.get("a")
    clip, films, study = (visitor.folder / name / "x" for name in ("clips", "films", "studies"))
    films.mkdir()
    (films / "report.json").write_text("{}")
    old, new = (Job("run", visitor.new_stop_file()) for _ in range(2))
    old.end("done", result=Done(clip, films, study))
    visitor.remember(old)
    assert handlers.on_load(studio)(None)[-1] == gradio.skip()
    visitor.remember(new)
    answer = handlers.on_job_end(studio)(None, None, None, None, None, _event(job=new.name), None)
    assert answer[-1] == {"runs": []}


def _chosen(studio: Studio, handlers, path: Path) -> dict[str, Any]:
    """Return the panel's value for a picture after its cut-out has ended or failed."""
    studio.visitors.get("a")
    sent = str(studio.visitors.store("a", path.read_bytes(), ".png"))
    request = SimpleNamespace(client=None, headers={})
    shown = handlers.on_choose(studio)(_event(upload=sent), request)[0]
    assert studio.visitors.get("a").jobs[shown["job"]].wait(60)
    return handlers.on_cut_end(studio)(shown, None, _event(job=shown["job"]), None)[0]


@pytest.mark.parametrize("name", ["on_choose", "on_correct", "on_choose_view", "on_choose_object"])
def test_each_panel_counts_newcomers_of_an_address(studio, gradio, name):
    """Requests of programs need not begin with the choice of a picture."""
    from demo import handlers

    answer, panels = getattr(handlers, name)(studio), ({}, None) if name == "on_correct" else ()
    client = SimpleNamespace(host="10.0.0.1")
    for number in range(UNUSED + 4):
        request = SimpleNamespace(client=client, session_hash=f"new {number}")
        answer(*panels, _event(option="side", upload="/gone"), request)
    assert len(studio.visitors) == UNUSED


@pytest.mark.parametrize("kind", ["cut", "read", "run"])
def test_another_picture_ends_the_work_on_the_earlier_one(studio, handlers, kind):
    """Else who tries some files quickly is told to wait, and can cancel nothing."""
    visitor = studio.visitors.get("a")
    earlier = Job(kind, visitor.new_stop_file())
    visitor.remember(earlier)
    handlers.on_choose(studio)(_event(job=earlier.name), None)
    assert earlier.stop.exists() == (kind != "run")


def test_a_broken_picture_is_not_shown(studio, handlers, tmp_path):
    (tmp_path / "half.png").write_bytes(TEDDY.read_bytes()[:9000])
    shown = _chosen(studio, handlers, tmp_path / "half.png")
    assert "cut short" in shown["message"] and shown["picture"] is None


def test_a_picture_without_an_object_stays(studio, handlers, tmp_path):
    """The object can be marked by the brush."""
    Image.new("RGB", (64, 64), "grey").save(tmp_path / "grey.png")
    shown = _chosen(studio, handlers, tmp_path / "grey.png")
    assert "No object" in shown["message"] and shown["picture"]["orig_name"]


def test_a_probe_that_is_not_made_gives_the_forecast(studio, handlers, monkeypatch):
    """Else the answer to an older scene would stay."""
    monkeypatch.setattr(handlers.run, "visitor_of", lambda _: "a")
    asked = (Cutout("/gone", "/gone"), Scene.named("drop").data(), None, 7, None)
    answer = handlers.on_scene_changed(studio)(*asked)
    assert handlers.on_refine(studio)(*asked) == answer
    assert answer["html"] and answer["change"] == 7
    for handler in (handlers.on_refine, handlers.on_scene_changed):
        assert handler(studio)(None, *asked[1:]) == {"change": 7, "html": None}


def test_a_run_beyond_the_time_limit_gets_no_trial(studio, sources):
    studio.settings = Settings(max_seconds=2)
    long = Scene.named("press").replaced({"time.frames": 72, "material.E": 1e9})
    for predict in (studio.forecast, studio.refine):
        with pytest.raises(InputError, match="the limit of this page is 2 s"):
            predict(Choice("a", sources[0], long.data()))


def test_the_time_of_a_trial_run_is_that_of_its_object(studio, sources, monkeypatch):
    trial = replace(studio.forecaster(Scene.named("drop")), seconds=1234.0)
    monkeypatch.setattr("demo.jobs.seconds_to_compile", lambda *_: 0.0)
    monkeypatch.setattr("demo.jobs.probe_estimate", lambda *_: trial)
    asked = [Choice("a", source, Scene.named("drop").data()) for source in sources]
    order = studio._order(asked[0], Scene.named("drop"))
    gaussians_of(order, made_gaussians(order))
    assert studio.refine(asked[0]).seconds == 1234.0
    studio.work = lambda _: iter(())
    composed = replace(asked[0], extras={"compose": True})
    first, second, third = (studio.run(each) for each in (*asked, composed))
    assert first.progress.expected == 1234.0
    assert second.progress.expected < 1234.0 > third.progress.expected
    assert all(job.wait(60) for job in (first, second, third))
    clip, _ = folders(order)
    clip.mkdir()
    (clip / "report.json").write_text("{}")
    assert studio.run(asked[0]).progress.expected < 1234.0, "only the videos are made"


def test_cancelling_a_run_leaves_the_fit(studio, handlers, monkeypatch):
    monkeypatch.setattr(handlers.run, "visitor_of", lambda _: "a")
    visitor = studio.visitors.get("a")
    jobs = {kind: Job(kind, visitor.new_stop_file()) for kind in ("fit", "run", "measure")}
    for job in jobs.values():
        job.progress.begin()
        visitor.remember(job)
    handlers.on_cancel(studio)(None)
    assert [kind for kind, job in jobs.items() if job.stop.exists()] == ["run", "measure"]


@pytest.mark.slow
def test_a_long_live_run_can_be_made_finer(studio, sources, handlers, monkeypatch):
    monkeypatch.setattr(handlers.run, "visitor_of", lambda _: "a")
    monkeypatch.setattr(studio, "work", lambda order: iter([done]))
    monkeypatch.setattr(studio.forecaster, "learn", lambda *_: None)
    monkeypatch.setattr(Done, "report", {})
    done = Done(Path("clip"), Path("films"), Path("study"))
    long = Scene.named("drop").replaced({"time.frames": 200, "accuracy": {"cells": 8}})
    ticket = studio.touches.give("a", SimpleNamespace())
    ticket.session = long.data()
    handlers.on_save(studio)(sources[0], None, None)
    saved = studio.visitors.get("a").latest("run")
    assert saved.wait(60)
    answer = handlers.on_finer(studio)(done, None)[0]
    assert answer.get("finer"), answer["message"]
    # Otherwise it would do its real work when this test has ended.
    assert studio.visitors.get("a").latest("run").wait(60)


def test_a_trial_run_has_the_threads_and_masks_of_the_run(studio, sources, monkeypatch):
    trials, usual = [], studio.forecaster(Scene.named("drop"))
    monkeypatch.setattr("demo.jobs.seconds_to_compile", lambda *_: 0.0)
    monkeypatch.setattr("demo.jobs.probe_estimate", lambda *sent: trials.append(sent) or usual)
    studio.settings = Settings(gaussians=1000, threads=1)
    choice, scene = Choice("a", sources[0], Scene.named("drop").data()), Scene.named("drop")
    order = studio._order(choice, scene)
    gaussians_of(order, made_gaussians(order))
    studio.refine(choice)
    with Image.open(sources[0].path) as cutout:
        assert trials[0][4] == crop_of(cutout) != WHOLE
    assert trials[0][2].threads == order.threads == 1


def test_each_stage_of_a_run_has_one_time(studio):
    """The clip and its films are made by two stopwatches."""
    visitor = studio.visitors.get("a")
    cut = studio.cut_out("a", str(studio.visitors.store("a", TEDDY.read_bytes(), ".png")))
    assert cut.wait(60)
    few = {"time.frames": 2, "accuracy": {"cells": 8}, "view.size": 32, "view.views": ["front"]}
    run = studio.run(Choice("a", cut.progress.result, Scene.named("press").replaced(few).data()))
    assert run.wait(300) and visitor.has_results, run.progress.message
    report = json.loads((run.progress.result.films / "report.json").read_text("utf-8"))
    names = [stage["name"] for stage in report["stages"]]
    assert len(set(names)) == len(names) and {"save", "pack"} <= set(names)
