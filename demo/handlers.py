"""Between Gradio and the jobs: the event handlers of the page.

Handlers know the session and Gradio's types; everything they do is in demo.jobs.
"""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any

import gradio as gr
from gradio import FileData

from phy124.accuracy.forecast import GUESS
from phy124.accuracy.load import spoken
from phy124.camera import VIEWS
from phy124.errors import InputError
from phy124.imaging.heic import is_heic
from phy124.io.clip import Clip
from phy124.scene import Scene

from .catalogue import scene_of
from .exports import EXPORTS, export
from .forecast import promise_of, stops_table
from .identity import visitor_of
from .jobs import Cutout, Studio, read_report, read_study, sentence
from .line import Job
from .progress import Progress
from .report import as_html
from .strokes import strokes_of
from .studies import Measurement
from .visitors import Visitor, key
from .work import Done, Measured

Handler = Callable[..., Any]
NOT_SHOWN = [gr.skip()] * 5
"""For the panels that `results` fills."""
REPORT = 2
"""Place of the report among them."""
EXAMPLES = Path(__file__).parent / "examples"
FILES = {
    "clip.safetensors": ("Moving Gaussians", "The clip itself, for phy124"),
    "gaussians.ply": ("Gaussians at rest", "3DGS PLY"),
    "orbit.webp": ("Orbit, animated WebP", "For a message"),
    "scene.toml": ("Scene", "Every setting, to run again"),
    "report.json": ("Report", "Times, effects, stability"),
}


def chooser(studio: Studio) -> Handler:
    """A picture that was sent -> it is being cut out; what was chosen before is forgotten."""

    def choose(event: gr.EventData, request: gr.Request) -> tuple[Any, Any]:
        path, example = _data(event).get("upload"), _data(event).get("example")
        if path is None and example is None:
            return {}, None
        try:
            if example is not None:
                path = _sent_example(studio, visitor_of(request), example)
            job = studio.cut(visitor_of(request), path)
        except InputError as error:
            return _not_cut(error), None
        return {"job": job.name, "picture": _picture(job)}, None

    return choose


def corrector(studio: Studio) -> Handler:
    """Brush strokes -> the cut-out is being corrected."""

    def correct(shown: Any, cutout: Any, event: gr.EventData, request: gr.Request) -> Any:
        picture = _path((shown or {}).get("picture")) if cutout is None else cutout.picture
        try:
            strokes = strokes_of(_data(event).get("strokes"))
            job = studio.cut(visitor_of(request), picture, strokes)
        except InputError as error:
            return {**(shown or {}), **_not_cut(error)}
        return {**(shown or {}), "job": job.name}

    return correct


def cut_shower(studio: Studio) -> Handler:
    """A finished cut-out -> its preview; one that failed leaves nothing to generate from."""

    def show(shown: Any, cutout: Any, event: gr.EventData, request: gr.Request) -> tuple[Any, Any]:
        job = _job(studio, request, event)
        if job is None or not job.over:
            return gr.skip(), gr.skip()
        made = job.progress.result
        if made is None:
            failed = {"job": None, "message": job.progress.message, "picture": _picture(job)}
            return {**(shown or {}), **failed}, cutout
        doubts = [*made.doubts, "If it is wrong, correct it with the brush."] if made.doubts else []
        return {**_cut_out(made), "doubts": " ".join(doubts)}, made

    return show


def _cut_out(made: Cutout) -> dict[str, Any]:
    return {"picture": _file(Path(made.picture)), "cutout": _file(Path(made.path))}


def _picture(job: Job) -> dict[str, Any] | None:
    """The picture that is cut out, once there is one that browsers can show."""
    path = Path(job.subject)
    return _file(path) if path.exists() and not is_heic(path) else None


def _not_cut(error: InputError) -> dict[str, Any]:
    return {"job": None, "message": sentence(error), "again": error.field == "queue"}


def _sent_example(studio: Studio, visitor: str, name: Any) -> str:
    """An example picture, as if the visitor had sent it."""
    path = EXAMPLES / f"{name}.png"
    if path not in EXAMPLES.glob("*.png"):
        raise InputError("image", "none", "There is no such example.", "Choose another one.")
    studio.visitors.get(visitor)
    return str(studio.visitors.store(visitor, path.read_bytes(), ".png"))


def _data(event: gr.EventData) -> dict[str, Any]:
    return event._data if isinstance(event._data, dict) else {}


def _job(studio: Studio, request: gr.Request, event: gr.EventData) -> Job | None:
    """The visitor's own piece of work that an event names."""
    visitor = studio.visitors.known(visitor_of(request))
    return visitor.jobs.get(str(_data(event).get("job"))) if visitor else None


def _path(file: Any) -> Any:
    return file.get("path") if isinstance(file, dict) else None


def forecaster(studio: Studio) -> Handler:
    """Scene -> what it will take."""

    def forecast(cutout: Any, scene: Any, request: gr.Request) -> str:
        if not scene:
            return ""
        name, path = visitor_of(request), cutout.path if cutout else None
        return with_stops(studio, name, path, scene, studio.forecast(name, path, scene))

    return forecast


def with_stops(
    studio: Studio, name: str, cutout: str | None, data: Any, text: str, *, opened: bool = False
) -> str:
    """A forecast in one line that opens: what each stop of the accuracy slider would be.

    Below it stands what was measured on this very scene, or that it can be measured.
    """
    visitor = studio.visitors.known(name)
    try:
        scene = scene_of(data, studio.settings, visitor and visitor.folder / "uploads")
    except InputError:
        return f"<p>{escape(text)}</p>"
    known = visitor.forecasts.get(key(scene.data())) if visitor else None
    count = studio.settings.gaussians
    study = studio.study(name, cutout, scene)
    stops = studio.forecaster.stops(scene, gaussians=count, seconds=known, study=study)
    table = stops_table(stops, scene.accuracy)
    if study is not None:
        table += f"<p>What accuracy cost here, without pictures:</p>{study.table()}"
    brief, _, rest = text.partition(": ")
    if not rest:
        return f"<p>{escape(text)}</p>{table}"
    return (
        f"<details{' open' if opened else ''}><summary>{escape(brief)}</summary>"
        f"<p>{escape(rest)}</p>{table}</details>{_error_line(studio, name, cutout, scene, study)}"
    )


def _error_line(
    studio: Studio, name: str, cutout: str | None, scene: Scene, study: Measurement | None
) -> str:
    """What was measured on this very scene, or a button that measures it."""
    said = promise_of(scene, study)
    if study is not None:
        about = "no error can be promised" if said.error is None else f"about {said.error:.1%} off"
        return f'<p class="measured">Measured: {about}.</p>'
    if not said.unmeasured:
        return ""
    seconds = studio.study_seconds(name, cutout, scene)
    span = spoken(studio.forecaster.load().span(seconds, unsure=GUESS))
    button = '<button type="button" class="quiet" data-measure>Measure</button>'
    return f"<p>Error not measured; {button} takes {span}.</p>"


def refiner(studio: Studio) -> Handler:
    """The same, measured on the visitor's own object where that is quick."""

    def refine(cutout: Any, scene: Any, request: gr.Request) -> Any:
        name = visitor_of(request)
        text = studio.refine(name, cutout.path, scene) if cutout and scene else None
        return gr.skip() if text is None else with_stops(studio, name, cutout.path, scene, text)

    return refine


def starter(studio: Studio) -> Handler:
    """Cut-out and scene -> a piece of work that the progress panel follows, or what is wrong."""

    def start(cutout: Any, scene: Any, request: gr.Request) -> tuple[Any, ...]:
        try:
            job = studio.run(visitor_of(request), cutout.path if cutout else None, scene)
        except InputError as error:
            state = "full" if error.field == "queue" else "refused"
            return Progress(state=state, message=sentence(error)).data(), *rested()
        return _shown(job), *working()

    return start


def measurer(studio: Studio) -> Handler:
    """Cut-out and scene -> its error is being measured, or what is wrong."""

    def start_study(cutout: Any, scene: Any, request: gr.Request) -> tuple[Any, ...]:
        try:
            job = studio.measure(visitor_of(request), cutout.path if cutout else None, scene)
        except InputError as error:
            return Progress(state="refused", message=sentence(error)).data(), *rested()
        return _shown(job), *working()

    return start_study


def _shown(job: Job) -> dict[str, Any]:
    """A piece of work for the progress panel, which follows it."""
    return {**job.progress.data(), "job": job.name, "kind": job.kind}


def rested() -> tuple[Any, Any]:
    """The buttons when nothing runs: Generate can be pressed, Cancel is gone."""
    return gr.update(interactive=True), gr.update(visible=False)


def working() -> tuple[Any, Any]:
    """The buttons while something runs."""
    return gr.update(interactive=False), gr.update(visible=True)


def stopper(studio: Studio) -> Handler:
    """Stop this visitor's work; the progress panel, which follows it, hears of it there."""

    def stop(request: gr.Request) -> None:
        visitor = studio.visitors.known(visitor_of(request))
        if visitor is not None:
            visitor.stop()

    return stop


def finisher(studio: Studio) -> Handler:
    """A run that has come to an end -> everything there is to see; a study -> the forecast."""

    def finish(
        cutout: Any, scene: Any, shown: Any, event: gr.EventData, request: gr.Request
    ) -> tuple[Any, ...]:
        name, job = visitor_of(request), _job(studio, request, event)
        if job is not None and isinstance(job.progress.result, Measured) and cutout and scene:
            text = studio.forecast(name, cutout.path, scene)
            told = with_stops(studio, name, cutout.path, scene, text, opened=True)
            return told, gr.skip(), *rested(), *_with_report(studio, name, shown)
        if job is None or not job.over or not _is_there(job.progress.result):
            return gr.skip(), gr.skip(), *rested(), *NOT_SHOWN
        return gr.skip(), job.progress.result, *rested(), *results(studio, name, job)

    return finish


def _with_report(studio: Studio, name: str, shown: Any) -> list[Any]:
    """The result panels, of which only the report is new: that of the run which is shown."""
    panels: list[Any] = list(NOT_SHOWN)
    visitor = studio.visitors.known(name)
    if visitor is not None and _is_there(shown):
        jobs = [job for job in visitor.jobs.values() if job.progress.result == shown]
        panels[REPORT] = report_of(studio, jobs[-1]) if jobs else gr.skip()
    return panels


def _is_there(done: Any) -> bool:
    return isinstance(done, Done) and (done.films / "report.json").exists()


def greeter(studio: Studio) -> Handler:
    """The page was opened, or opened again: whatever this visitor had is shown."""

    def greet(request: gr.Request) -> tuple[Any, ...]:
        visitor = studio.visitors.known(visitor_of(request))
        if visitor is None:
            return gr.skip(), None, gr.skip(), None, *rested(), *NOT_SHOWN
        cut, run = visitor.latest("cut"), visitor.latest("run")
        study = visitor.latest("measure")
        if study is not None and not study.over and (run is None or run.over):
            run = study
        return *_found_picture(visitor, cut), *_found_run(studio, visitor_of(request), run)

    return greet


def _found_picture(visitor: Visitor, cut: Job | None) -> tuple[Any, Any]:
    """The picture panel and the cut-out of a visitor who has come back."""
    if cut is not None and not cut.over:
        return {"job": cut.name}, None
    made = next((j.progress.result for j in reversed(list(visitor.jobs.values()))
                 if j.kind == "cut" and j.progress.result), None)  # fmt: skip
    if made is None or not Path(made.path).exists() or not Path(made.picture).exists():
        return gr.skip(), None
    return _cut_out(made), made


def _found_run(studio: Studio, name: str, run: Job | None) -> tuple[Any, ...]:
    """Progress, result, buttons and result panels of a visitor who has come back."""
    if run is None:
        return gr.skip(), None, *rested(), *NOT_SHOWN
    if not run.over:
        return _shown(run), None, *working(), *NOT_SHOWN
    done = run.progress.result
    if not _is_there(done):
        return gr.skip(), None, *rested(), *NOT_SHOWN
    return gr.skip(), done, *rested(), *results(studio, name, run)


def results(studio: Studio, name: str, job: Job) -> list[Any]:
    """Values of the viewer, the videos, the report, the take-away panel and the history."""
    done: Done = job.progress.result
    clip = Clip.load(done.clip / "clip.safetensors")
    films = [{"name": path.stem, "file": _file(path)} for path in _films(done)]
    length = float(clip.times[-1] - clip.times[0])
    return [
        {"pack": _file(done.films / "clip.pack")},
        {"films": films, "length": length},
        report_of(studio, job),
        _takeaway(done),
        {"runs": _earlier(studio, name, job)},
    ]


def report_of(studio: Studio, job: Job) -> str:
    """The report of a finished run, with what was measured on its scene before or after it."""
    done: Done = job.progress.result
    report, study = read_report(done), read_study(done.study)
    data = Clip.load(done.clip / "clip.safetensors").scene
    scene, count = Scene.from_data(data), report["gaussians"]
    stops = studio.forecaster.stops(scene, gaussians=count, study=study)
    return as_html(report, data, job.progress.expected, stops, study)


def _earlier(studio: Studio, name: str, shown: Job) -> list[dict[str, Any]]:
    """What a visitor has made so far, the newest first, each result once."""
    visitor, seen, found = studio.visitors.known(name), set(), []
    for job in reversed(list(visitor.jobs.values()) if visitor else []):
        done = job.progress.result
        if job.kind != "run" or not _is_there(done) or done.films in seen:
            continue
        seen.add(done.films)
        scene = Clip.load(done.clip / "clip.safetensors").scene
        found.append({
            "job": job.name, "title": str(scene["material"]["law"]).replace("_", " ").capitalize(),
            "detail": f"{scene['time']['frames']} frames, {scene['accuracy']}"
            if isinstance(scene["accuracy"], str) else f"{scene['time']['frames']} frames",
            "picture": _file(done.films / "orbit.webp"), "pack": _file(done.films / "clip.pack"),
            "current": done == shown.progress.result,
        })  # fmt: skip
    return found


def _films(done: Done) -> list[Path]:
    """The videos, the views of the paper first."""
    order = [*VIEWS, "orbit"]
    place = {name: number for number, name in enumerate(order)}
    films = sorted(done.films.glob("*.mp4"))
    return sorted(films, key=lambda path: place.get(path.stem, len(order)))


def prepare(done: Done | None, shown: Any, event: gr.EventData) -> Any:
    """Make a file on demand; the panel then offers it."""
    kind = str(event._data.get("kind")) if event._data else ""
    if done is None or not done.films.exists():
        return {**(shown or {}), "message": "The result is no longer here. Generate it again."}
    try:
        path = export(kind, done)
    except InputError as error:
        return {**_takeaway(done), "message": sentence(error)}
    return {**_takeaway(done), "made": kind, "file": path.name}


def _takeaway(done: Done) -> dict[str, Any]:
    files, offers = [], []
    for path in _films(done):
        files.append(_link(path, f"Video, {path.stem}", "MP4"))
    for name, (label, hint) in FILES.items():
        for folder in (done.films, done.clip):
            if (folder / name).exists():
                files.append(_link(folder / name, label, hint))
                break
    for kind, offer in EXPORTS.items():
        if (done.films / offer.file).exists():
            files.append(_link(done.films / offer.file, offer.label, offer.hint))
        elif offer.available():
            offers.append({"kind": kind, "label": offer.label, "hint": offer.hint})
    return {"files": files, "offers": offers}


def _link(path: Path, label: str, hint: str) -> dict[str, Any]:
    return {"label": label, "hint": hint, "file": _file(path)}


def _file(path: Path) -> dict[str, Any]:
    """A file for the page; its folder's name cannot be guessed."""
    return FileData(path=str(path), orig_name=path.name, size=path.stat().st_size).model_dump()
