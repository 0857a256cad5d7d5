"""The error of a visitor's own scene: measured as a job like a run, kept, and told."""

from dataclasses import replace
from pathlib import Path

import pytest

from demo.extras import NO_EXTRAS
from demo.forecast import promise_of
from demo.jobs import Studio
from demo.line import Job
from demo.progress import Measured, Reused, Step
from demo.settings import Settings
from demo.source import Choice
from demo.studies import GRIDS, Level, Measurement, grids, on_grid, read_study
from demo.visitors import Visitors
from demo.work import DEVICE, made_gaussians, steps, study_file
from demo.work.limits import Limits
from phy124.errors import Cancelled, InputError
from phy124.monitor.tearing import Tearing
from phy124.particles.thickness import Proportions
from phy124.scene import Scene
from support.orders import small_order
from support.processes import until

pytestmark = pytest.mark.usefixtures("coarse_solids")

DUCK = Path(__file__).parents[1] / "demo/examples/duck.png"
QUICK = {"time.frames": 3, "binding": "lattice", "accuracy": {"cells": 32}}


def measurement(*errors: float | None, torn: int = 0, rate: float | None = 1.0) -> Measurement:
    levels = tuple(
        Level(cells=cells, seconds=cells / 10, error=error, torn=cells == torn)
        for cells, error in zip(GRIDS, errors, strict=True)
    )
    why = "" if any(errors) else "no convergence: results on finer grids are no closer together"
    return Measurement(levels=levels, order=rate, why_not=why, skipped=())


def test_error_is_shown_for_the_chosen_grid():
    result = measurement(0.08, 0.06, 0.04)
    for cells, error, why in (
        (16, 0.06, "Measured on D/12, D/16 and D/24."),
        (20, 0.06, "Measured on D/16."),
        (48, 0.02, "Extrapolated to D/48 from D/12, D/16 and D/24."),
    ):
        said = result.promise(cells)
        assert said.about == pytest.approx(error) and said.why == why
    assert result.promise(16).sentence.startswith("This run is off by about 6.0 % of the object")
    assert "no grid this coarse was measured" in result.promise(8).sentence


def test_torn_or_diverging_grids_promise_nothing():
    torn = measurement(0.08, 0.06, None, torn=24)
    assert all(torn.promise(cells).error is None for cells in (12, 16, 24, 32))
    assert "on D/24 the grid may tear the material" in torn.promise(16).sentence
    assert "may be torn" in torn.table()
    lost = measurement(None, None, None, rate=None)
    assert "there is no bound: no convergence" in lost.promise(24).sentence


def test_a_scene_on_a_coarse_grid_is_measured_there_too():
    press = Scene.named("press")
    assert grids(press) == GRIDS
    assert grids(press.replaced({"accuracy": {"cells": 20}})) == (12, 16, 20, 24)


@pytest.fixture
def study(tmp_path):
    order = small_order(tmp_path)
    scene = order.scene.replaced(QUICK)
    # However busy the machine is, all grids are run.
    return replace(order, scene=scene, levels=(8, 10, 12), seconds=1e4)


@pytest.mark.slow
def test_grids_are_run_once_and_serve_every_accuracy_and_view(study):
    events = [event for event in steps(study) if event is not None]
    assert {e.stage for e in events if isinstance(e, Step)} == {"generate", "measure"}
    assert events[-1] == Measured(study_file(study))
    result = read_study(study_file(study))
    assert [level.cells for level in result.levels] == [8, 10, 12]
    assert all(level.seconds > 0 for level in result.levels)
    finer = study.scene.replaced({"accuracy": "fine", "view.elevation": 40.0})
    again = [event for event in steps(replace(study, scene=finer)) if event is not None]
    assert again == [Reused("generate"), Reused("measure"), events[-1]]
    other = study.scene.replaced({"material.E": 1e4})
    assert study_file(replace(study, scene=other)) != study_file(study)


def test_a_study_is_stopped_in_the_middle_of_a_grid(study):
    many = replace(study, scene=study.scene.replaced({"time.frames": 500}))
    events = steps(many)
    next(event for event in events if isinstance(event, Step) and event.stage == "measure")
    many.stop.touch()
    with pytest.raises(Cancelled):
        list(events)
    until(lambda: not DEVICE.locked())
    assert not study_file(many).exists()


def test_a_study_whose_time_is_up_says_so_and_keeps_nothing(study, monkeypatch):
    monkeypatch.setattr(Limits, "spent", property(lambda limits: 0.9))
    with pytest.raises(InputError, match="before all grids were run"):
        list(steps(study))
    assert not study_file(study).exists()


def test_a_study_uses_the_threads_of_the_page(study, monkeypatch):
    used = []

    def measure(gaussians, scene, context, *_, **__):
        used.append(context.threads)
        raise Cancelled

    monkeypatch.setattr("demo.work.study.Study", measure)
    with pytest.raises(Cancelled):
        list(steps(replace(study, threads=3)))
    assert used == [3]


def test_a_study_keeps_the_solver_of_its_scene(study):
    double = study.scene.replaced({"accuracy.precision": "float64"})
    assert on_grid(study.scene, 12).on_lattice and not on_grid(double, 12).on_lattice
    assert study_file(study) != study_file(replace(study, scene=double))


def test_torn_grids_are_kept_as_such(study, monkeypatch):
    monkeypatch.setattr(Tearing, "likely", property(lambda self: True))
    study = replace(study, scene=study.scene.replaced({"accuracy.solver": "mpm"}))
    list(steps(study))
    result = read_study(study_file(study))
    assert all(level.torn and level.error is None for level in result.levels)
    assert promise_of(study.scene, 0.5, result).error is None


@pytest.fixture
def handlers(gradio):
    """The page's handlers."""
    from demo import handlers

    return handlers


@pytest.fixture
def visit(tmp_path):
    """A studio, a visitor's cut-out, and a scene of which nothing was measured."""
    studio = Studio(Settings(gaussians=1000, device="cpu"), Visitors(tmp_path))
    studio.visitors.get("a")
    cut = studio.cut_out("a", str(studio.visitors.store("a", DUCK.read_bytes(), ".png")))
    assert cut.wait(60)
    scene = Scene.named("drop").replaced({"material.law": "hencky", "time.frames": 2})
    return studio, cut.progress.result, scene.data()


def test_study_is_offered_where_nothing_was_measured(visit, handlers):
    studio, cutout, data = visit
    # The set-up of a lattice takes a second on each grid.
    data = Scene.from_data(data).replaced({"accuracy.solver": "mpm"}).data()

    def shown(data):
        return handlers.run.show_estimate(studio.forecast(Choice("a", cutout, data)))

    drop = Scene.named("drop")
    first = shown(drop.replaced({"time.frames": 14}).data())
    assert "Its error is known after the first run." in first and "not measured" not in first
    order = studio.order(studio.resolve(Choice("a", cutout, data)), NO_EXTRAS)
    studio.visitors.get("a").proportions[str(made_gaussians(order))] = Proportions(0.3, 0.3)
    assert "data-measure" not in shown(drop.replaced({"time.frames": 14}).data())
    assert "data-measure" in shown(drop.data())
    before = shown(data)
    assert "data-measure>Measure</button> <span>about " in before
    assert "phy124 accuracy" not in before, "a visitor has no command line"
    jobs = [studio.measure(Choice("a", cutout, data)) for _ in range(2)]
    for job in jobs:
        assert job.wait(300) and job.progress.state == "done", job.progress.message
        assert [row["name"] for row in job.progress.data()["stages"]] == ["Picture to 3D", "Grids"]
    assert "measure" in jobs[1].progress.reused, "a second click measures nothing again"
    after = shown(data)
    assert "data-measure" not in after and 'class="measured">Off by about' in after
    assert all(f"<td>D/{cells}</td>" in after for cells in GRIDS)
    assert "error not measured" not in after


def test_a_study_that_would_be_refused_is_not_offered(visit):
    studio, cutout, data = visit
    choice = Choice("a", cutout, {**data, "accuracy": {"cells": 8}})
    assert studio.forecast(choice).study_seconds is not None
    few = Studio(Settings(max_cells=16), studio.visitors)
    assert few.forecast(choice).study_seconds is None
    with pytest.raises(InputError, match="at most 16 cells"):
        few.measure(choice)


@pytest.mark.slow
def test_report_includes_a_later_study(visit, handlers, monkeypatch, gradio):
    for module in (handlers.results, handlers.event):
        monkeypatch.setattr(module, "visitor_of", lambda _: "a")
    studio, cutout, data = visit
    data = {**data, "accuracy": "draft", "view": {**data["view"], "size": [32, 32]}}
    run = studio.run(Choice("a", cutout, data))
    assert run.wait(300) and run.progress.state == "done", run.progress.message
    shown = run.progress.result
    report = handlers.results.report_of(studio, run)
    assert report["sentences"][1]["text"] == "Its error has not been measured."
    assert "not measured for" in report["tables"]
    study = Job("measure", studio.visitors.get("a").new_stop_file())
    studio.visitors.get("a").remember(study)
    shown.study.write_text(measurement(0.08, 0.06, 0.04).model_dump_json(), "utf-8")
    study.end("done", result=Measured(shown.study))
    event = gradio.EventData(None, {"job": study.name})
    finished = handlers.on_job_end(studio)(cutout, data, None, shown, 1, event, None)
    assert finished[1] == gradio.skip(), "the same run is shown"
    assert "about 6.0 %" in finished[handlers.results.REPORT - 4]["tables"]
    again = studio.run(Choice("a", cutout, {**data, "view": {**data["view"], "elevation": 40.0}}))
    assert again.wait(300) and again.progress.result.films != shown.films
    report = handlers.results.report_of(studio, again)
    assert "about 6.0 %" in report["tables"]
    assert report["sentences"][1]["text"].startswith("It is off by about 6.0 % of its size")


def test_missing_kernels_are_forecast_and_not_probed(visit, monkeypatch):
    studio, cutout, data = visit
    data = {**data, "accuracy": {"cells": 8}, "view": {**data["view"], "size": [32, 32]}}
    job = studio.run(Choice("a", cutout, data))
    assert job.wait(300) and job.progress.state == "done", job.progress.message
    other = {**data, "time": {**data["time"], "frames": 3}}
    assert "compiles" not in studio.forecast(Choice("a", cutout, other)).sentence
    assert studio.refine(Choice("a", cutout, other))
    monkeypatch.setattr("demo.jobs.seconds_to_compile", lambda *_: 5.0)
    cold = studio.forecast(Choice("a", cutout, other)).sentence
    assert "The first run of this kind compiles for about" in cold
    assert studio.refine(Choice("a", cutout, other)) is None


def test_unmeasurable_scenes_are_refused(visit):
    studio, cutout, data = visit
    with pytest.raises(InputError, match="no picture yet"):
        studio.measure(Choice("a", None, data))
    stiff = {**data, "material": {**data["material"], "E": 1e12}}
    with pytest.raises(InputError, match="would take about"):
        studio.measure(Choice("a", cutout, stiff))
    few = Studio(Settings(max_particles=1000), studio.visitors)
    with pytest.raises(InputError, match="at most 1,000"):
        few.measure(Choice("a", cutout, data))
