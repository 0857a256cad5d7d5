"""A visitor's video goes back to the softness of a result: limits, whose it is, and its end."""

import json
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from demo.exports import export
from demo.fits import newest
from demo.fits.jobs import Fits
from demo.fits.search import PLAN, in_words, outlook, progress
from demo.fits.video import Seen, read_video
from demo.forecast import Estimator
from demo.jobs import Studio
from demo.settings import Settings
from demo.visitors import Room, Visitors
from demo.work import Done
from phy124.accuracy.load import Load, format_span
from phy124.budget.cost import Rates
from phy124.errors import Cancelled, InputError
from phy124.io.video import write_mp4
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene
from phy124.studies.fit import Fit
from phy124.studies.fit.interval import Undecided
from support.clips import FIT, falling
from support.processes import until

SIDE = 32
LONG = Deadline(60)


def filmed(path: Path, count: int = 12, fps: float = 24) -> Path:
    """A video of a dark square that rises before a light ground."""
    pictures = np.full((count, SIDE, SIDE, 3), 230, np.uint8)
    for number, picture in enumerate(pictures):
        picture[16 - number : 28 - number, 10:22] = 40
    write_mp4(path, list(pictures), fps=fps)
    return path


def result_of(visitor, **changes) -> Done:
    """A finished run: a cube that falls, said to be of the scene `press`, in another view."""
    clip, _ = falling()
    done = Done(visitor.folder / "clips" / "a", visitor.folder / "films" / "b", Path("none"))
    for folder in (done.clip, done.films):
        folder.mkdir()
        (folder / "report.json").write_text("{}")
    scene = Scene.named("press").replaced({"time.frames": 5, **changes})
    clip.scene.update(scene.data())
    clip.save(done.clip / "clip.safetensors")
    seen = scene.replaced({"view.elevation": 40.0, "view.picture": "beach.jpg"})
    (done.films / "scene.toml").write_text(seen.to_toml(), "utf-8")
    return done


class Search:
    """Stands in for the search, which takes a minute: writes what one writes, and may hang."""

    def __init__(self, report: dict | InputError | None = None) -> None:
        self.report, self.asked, self.begun = report, [], threading.Event()
        self.stopped = threading.Event()

    def __call__(self, wanted: Fit, out: Path, deadline: Deadline) -> dict:
        self.asked.append(wanted)
        (out / "runs").mkdir(parents=True, exist_ok=True)
        (out / "runs" / f"{len(self.asked)}.npy").touch()
        (out / PLAN).write_text(json.dumps({"runs": [8, 2], "seconds": 20.0}))
        deadline.beat()
        self.begun.set()
        if isinstance(self.report, InputError):
            raise self.report
        while self.report is None:
            try:
                deadline.beat()
            except Cancelled:
                self.stopped.set()
                raise
            self.stopped.wait(0.01)
        (out / "fit.json").write_text(json.dumps(self.report))
        (out / "comparison.mp4").write_bytes(b"film")
        (out / "fitted.toml").write_text(Scene.named("press").to_toml())
        return self.report


@pytest.fixture
def studio(tmp_path, monkeypatch) -> Studio:
    """A studio in which videos are not decoded."""
    monkeypatch.setattr(
        "demo.fits.jobs.read_video", lambda path, out, *_: Seen(out, fps=24.0, count=5, whole=9)
    )
    limits = Settings(max_video_mb=0.1, max_fit_seconds=300)
    # The load of this machine is not measured.
    return Studio(limits, Visitors(tmp_path), forecaster=Estimator(lambda: True))


def prepared(studio: Studio, search: Search, name: str = "a") -> tuple[Done, str]:
    """A visitor's result, and a video that was sent; searches are stood in for."""
    studio.fits = Fits(studio.visitors, studio.settings, studio.forecaster, studio._submit, search)
    return result_of(studio.visitors.get(name)), sent(studio, name)


def sent(studio: Studio, name: str, data: bytes = b"\0\0\0\x20ftypisom", ending=".mp4") -> str:
    studio.visitors.get(name)
    return str(studio.visitors.store(name, data, ending))


def test_video_is_decoded_up_to_the_length_of_the_scene(tmp_path):
    seen = read_video(filmed(tmp_path / "a.mp4"), tmp_path / "out", 0.3, 0.5, LONG)
    # At half speed it shows 48 pictures per second of what was filmed.
    assert seen == Seen(tmp_path / "out", fps=48.0, count=12, whole=12)
    assert len(list(seen.folder.glob("*.png"))) == 12


@pytest.mark.parametrize(
    ("seconds", "speed", "count"), [(0.3, 1.0, 8), (0.3, 0.5, 12), (1 / 24, 1.0, 2)]
)
def test_frames_after_the_scene_are_left_out(tmp_path, monkeypatch, seconds, speed, count):
    monkeypatch.setattr("demo.fits.video.resource.setrlimit", lambda *_: None)
    monkeypatch.setattr("demo.fits.video.isolated.run", lambda work, *options, **_: work(*options))
    path = filmed(tmp_path / "a.mp4")
    assert read_video(path, tmp_path / "out", seconds, speed, LONG).count == count
    with pytest.raises(InputError, match="the video has only 1 picture in this time"):
        read_video(path, tmp_path / "out", 0.01, speed, LONG)
    path.write_bytes(b"\0\0\0\x20ftypisom" + bytes(99))
    with pytest.raises(InputError, match="not a readable video"):
        read_video(path, tmp_path / "out", seconds, speed, LONG)


def test_impossible_fits_are_refused_in_a_sentence(studio):
    done, video = prepared(studio, Search())
    for result, path, answer, sentence in (
        (None, video, {}, "no result yet"),
        (done, None, {}, "no video yet"),
        (done, "/etc/passwd", {}, "does not have this video"),
        (done, sent(studio, "b"), {}, "does not have this video"),
        (done, sent(studio, "a", b"#EXTM3U\nfile:///etc/passwd"), {}, "not an MP4"),
        (done, sent(studio, "a", b"\0\0\0\x20ftyp" + bytes(10**5)), {}, "larger than 0.1 MB"),
        (done, video, {"side": "above"}, "front"),
        (done, video, {"speed": 0}, "speed"),
        (done, video, {"seconds": 1e4}, "300 s"),
        (done, video, {"seconds": 1e9}, "A fit may take at most 300 s"),
        (done, video, {"seconds": True}, "number"),
    ):
        with pytest.raises(InputError, match=sentence):
            studio.fits.begin("a", result, path, answer)
    with pytest.raises(InputError, match="no result yet"):
        studio.fits.begin("b", done, sent(studio, "b"), {})
    water = result_of(
        studio.visitors.get("c"), **{"material": Scene.named("water").data()["material"]}
    )
    with pytest.raises(InputError, match="has no softness"):
        studio.fits.offer(water)
    mask = {"mask": "hat.png", "material": {"law": "neo_hookean", "E": 2e5}}
    with pytest.raises(InputError, match=r"has a picture \(parts\.0\.mask\)"):
        studio.fits.offer(result_of(studio.visitors.get("d"), parts=[mask]))
    assert not studio.visitors.get("a").busy


def test_forecast_of_a_fit_stays_below_its_time_limit(studio, monkeypatch):
    done, _ = prepared(studio, Search({}))
    monkeypatch.setattr(Load, "span", lambda *_, **__: (10.0, 9000.0))
    offer = studio.fits.offer(done)
    span = format_span((10.0, offer["budget"]["value"]))
    assert offer["sentence"] == f"A fit takes {span}."


def test_a_fit_is_forecast_and_asked_for_as_declared(studio):
    done, video = prepared(studio, Search({}))
    offer = studio.fits.offer(done)
    least, value, most = (offer["budget"][name] for name in ("least", "value", "most"))
    assert 0 < least < value < most == 300 and "A fit takes" in offer["sentence"]
    options = {"seconds": value, "side": "right", "speed": 0.5, "other": 1}
    assert studio.fits.begin("a", done, video, options).wait(60)
    (wanted,) = studio.fits.search.asked
    assert (wanted.side, wanted.fps, wanted.seconds, wanted.align) == ("right", 24, value, True)
    view = Scene().replaced(wanted.set).view
    assert view.only("right").sides == ("right",) and view.elevation == 40.0 and not view.picture
    assert wanted.find["material.E"].log_uniform == (4e3, 4e5)
    few, many = (outlook(Scene().replaced({"time.frames": n}), Rates()).wall(9) for n in (5, 50))
    assert few < many


def test_visitor_has_one_fit_and_may_cancel_it(studio):
    search = Search()
    done, video = prepared(studio, search)
    job = studio.fits.begin("a", done, video, {})
    assert search.begun.wait(60) and studio.busy
    with pytest.raises(InputError, match="Your previous fit is still running"):
        studio.fits.begin("a", done, video, {})
    other, theirs = prepared_other(studio)
    waiting = studio.fits.begin("b", other, theirs, {})
    time.sleep(0.1)
    assert (waiting.place, len(search.asked)) == (1, 1), "one fit at a time on this server"
    rows = job.progress.data()["stages"]
    assert [row["name"] for row in rows] == ["Video", "Search"]
    assert rows[0]["note"] == "5 pictures, 4 come later" and rows[1]["total"] == 10
    assert job.progress.expected > 20
    job.cancel()
    assert search.stopped.wait(60) and job.wait(60) and job.progress.state == "stopped"
    assert newest(done) is None
    studio.visitors.remove("b")
    assert waiting.wait(60)
    until(lambda: not studio.busy)


def prepared_other(studio: Studio) -> tuple[Done, str]:
    return result_of(studio.visitors.get("b")), sent(studio, "b")


def test_stopped_fit_resumes_and_leaves_with_its_visitor(studio):
    search = Search()
    done, video = prepared(studio, search)
    first = studio.fits.begin("a", done, video, {"seconds": 30})
    assert search.begun.wait(60)
    first.cancel()
    assert first.wait(60)
    search.report, search.begun = {}, threading.Event()
    again = studio.fits.begin("a", done, video, {"seconds": 60})
    assert again.wait(60) and again.progress.state == "done", again.progress.message
    folder = again.progress.result.folder
    assert len(list((folder / "runs").iterdir())) == 2
    assert progress(folder) == (2, 10, 20.0)
    assert newest(done) == again.progress.result
    for number in range(4):
        (folder.parents[1] / f"old-{number}").mkdir()
    studio.visitors.get("a").trim(Room(clips=1))
    assert len(list(folder.parents[1].iterdir())) == 3
    visitor = studio.visitors.get("a").folder
    studio.visitors.remove("a")
    until(lambda: not visitor.exists())


@pytest.fixture
def handlers(monkeypatch, gradio):
    """The page's handlers, for visitor a."""
    from demo import handlers

    monkeypatch.setattr(handlers.fit, "visitor_of", lambda _: "a")
    monkeypatch.setattr(handlers.event, "visitor_of", lambda _: "a")
    return handlers


def test_the_panel_shows_film_and_fit_picture_by_picture(studio, handlers):
    import gradio as gr

    laid = {"scale": 1.25, "shift": [0, 0], "shared": 0.97}
    shown = {**FIT["pictures"], "laid": laid}
    report = {**FIT, "pictures": shown, "runs": [90, 9], "seconds": 61.0}
    done, video = prepared(studio, Search(report))
    panel = handlers.on_result_shown(studio)(done, None)
    assert panel["offer"]["budget"] and panel["fields"]["side"]["enum"] and not panel["found"]
    event = gr.EventData(None, {"upload": video, "side": "front", "speed": 1, "seconds": 60})
    panel = handlers.on_fit_begin(studio)(done, panel, event, None)
    job = studio.visitors.get("a").jobs[panel["job"]]
    assert job.wait(60) and job.progress.state == "done", job.progress.message
    ended = gr.EventData(None, {"job": job.name})
    panel, files = handlers.on_fit_end(studio)(done, ended, None)
    said = " ".join(panel["found"]["sentences"])
    assert "50,000 Pa (95 % interval 40,000 to 60,000 Pa); before the fit 40,000 Pa" in said
    assert (
        "scaled by 1.25 and" in said and "outlines share 97%" in said and "99 runs in 61 s" in said
    )
    assert panel["found"]["material"]["E"] == Scene.named("press").data()["material"]["E"]
    assert "<polyline" in panel["found"]["figure"] and panel["found"]["film"]["size"] == 4
    assert [item["label"] for item in files["files"] if "Fit" in item["label"]] == [
        "Fit: video and simulation",
        "Fit: report",
        "Fit: scene",
    ]
    assert handlers.on_result_shown(studio)(done, None)["found"] == panel["found"], "after a reload"


def test_undetermined_value_is_reported_with_a_remedy(studio, handlers):
    import gradio as gr

    why = "nothing that was measured depends on it."
    done, video = prepared(studio, Search(in_words(Undecided(("material.E",), why))))
    event = gr.EventData(None, {"upload": video})
    job = handlers.on_fit_begin(studio)(done, {}, event, None)["job"]
    assert studio.visitors.get("a").jobs[job].wait(60)
    panel, files = handlers.on_fit_end(studio)(done, gr.EventData(None, {"job": job}), None)
    assert panel["message"] == (
        "The softness cannot be determined from this video, because nothing that was measured "
        "depends on it. This would determine it: let it oscillate "
        "freely after the load, or measure "
        "the force on a wall, or load the object with a known force in newtons."
    )
    assert files == gr.skip() and "--" not in panel["message"]
    refused = handlers.on_fit_begin(studio)(done, {}, gr.EventData(None, {}), None)
    assert refused["message"] == "There is no video yet. Choose one first."
    assert handlers.on_result_shown(studio)(None, None)["refusal"].startswith("There is no result")


def test_no_sentence_of_a_refusal_names_a_command_line_option():
    for field in ("seconds", "find"):
        error = InputError(field, 1, "the least is 9 s.", "Give --seconds 99.")
        assert "--" not in str(in_words(error))


def test_a_fit_on_a_single_grid_claims_no_corrected_error(gradio):
    from demo.handlers.fit import summarise

    shown = {**FIT["pictures"], "was": {"material.E": 4e4}, "laid": None}
    report = {**FIT, "runs": [9], "seconds": 1.0, "pictures": shown}
    assert "After correction of the grid error" in " ".join(summarise(report))
    single = {**report, "grids": report["grids"][:1]}
    assert "grid error" not in " ".join(summarise(single))


@pytest.mark.slow
def test_the_softness_of_a_pressed_duck_is_found(tmp_path):
    """Truth from a finer grid and other particles; the page's own job, decoding and search."""
    from support.ducks import CELLS, pressed

    # However busy the machine is, a fit has the time that it is expected to take.
    studio = Studio(Settings(gaussians=3000, max_fit_seconds=1e5), Visitors(tmp_path / "files"))
    done, film = pressed(studio, tmp_path, truth=6e4, guess=4e4)
    video = sent(studio, "a", film.read_bytes())
    seconds = max(600.0, studio.fits.offer(done)["budget"]["value"])
    job = studio.fits.begin("a", done, video, {"seconds": seconds})
    assert job.wait(2 * seconds) and job.progress.state == "done", job.progress.message
    report = job.progress.result.report
    result = report["found"]["material.E"]
    # The truth is that of a grid of 28 cells, whose own error is not that of a limit; the error
    # shrinks as the spacing does (Richardson).
    part = report["cells"] / CELLS
    ends = zip(result["interval"], result["limit"]["interval"], strict=True)
    low, high = (part * here + (1 - part) * limit for here, limit in ends)
    assert low < 6e4 < high
    assert result["value"] == pytest.approx(6e4, rel=0.15)
    shown = report["pictures"]
    assert max(shown["fitted"]) < 0.6 * max(shown["before"])
    assert str(tmp_path) not in json.dumps(report)
    names = {path.name for path in job.progress.result.files}
    assert names == {
        "comparison.html",
        "comparison.mp4",
        "comparison.png",
        "fit.json",
        "fitted.toml",
    }
    (path,) = export(["ply"], done, studio.visitors.get("a"), studio.visitors)
    assert path.exists()
