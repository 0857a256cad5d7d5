"""Between Gradio and the jobs: the event handlers of the page.

Handlers know the session and Gradio's types; everything they do is in demo.jobs.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gradio as gr
from gradio import FileData

from demo.catalogue import scene_of
from demo.exports import EXPORTS, export
from demo.forecast import stops_table
from demo.jobs import Progress, Studio, read_report, sentence
from demo.pictures import dimmed
from demo.report import as_html
from demo.visitors import key
from demo.work import Done
from phy124.camera import VIEWS
from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.scene import Scene

Handler = Callable[..., Any]
EXAMPLES = Path(__file__).parent / "examples"
FILES = {
    "clip.safetensors": ("Moving Gaussians", "The clip itself, for phy124"),
    "gaussians.ply": ("Gaussians at rest", "3DGS PLY"),
    "orbit.webp": ("Orbit, animated WebP", "For a message"),
    "scene.toml": ("Scene", "Every setting, to run again"),
    "report.json": ("Report", "Times, effects, stability"),
}


def cutter(studio: Studio) -> Handler:
    """Picture -> cut-out, its preview, and the picture under the brush."""

    def cut(picture: str | None, request: gr.Request) -> tuple[Any, ...]:
        if picture is None:
            return None, gr.update(value=None, visible=False), None
        try:
            made = studio.cut(session_of(request), picture)
        except InputError as error:
            raise gr.Error(sentence(error), title="This picture cannot be used") from None
        except Cancelled:
            return None, gr.update(value=None, visible=False), None
        if made.doubts:
            remedy = "If it is wrong, correct it with the brush."
            gr.Warning(" ".join([*made.doubts, remedy]), title="Is this the object?")
        canvas = {"background": dimmed(picture, made.path), "layers": [], "composite": None}
        return made, gr.update(value=made.path, visible=True), canvas

    return cut


def corrector(studio: Studio) -> Handler:
    """Brush strokes -> corrected cut-out and its preview."""

    def correct(cutout: Any, canvas: Any, request: gr.Request) -> tuple[Any, ...]:
        layers = (canvas or {}).get("layers") or []
        if cutout is None or not layers:
            raise gr.Error("Choose a picture and paint on it first.", title="Nothing to correct")
        try:
            made = studio.cut(session_of(request), cutout.picture, layers[0])
        except InputError as error:
            raise gr.Error(sentence(error), title="This cannot be used") from None
        except Cancelled:
            return gr.skip(), gr.skip()
        return made, gr.update(value=made.path, visible=True)

    return correct


def forecaster(studio: Studio) -> Handler:
    """Scene -> what it will take."""

    def forecast(cutout: Any, scene: Any, request: gr.Request) -> str:
        path, session = cutout.path if cutout else None, session_of(request)
        if not scene:
            return ""
        return with_stops(studio, session, scene, studio.forecast(session, path, scene))

    return forecast


def with_stops(studio: Studio, session: str, data: Any, text: str) -> str:
    """A forecast, and under it what each stop of the accuracy slider would be."""
    try:
        scene = scene_of(data, studio.settings)
        known = studio.visitors.get(session).forecasts.get(key(scene.data()))
    except InputError:
        return text
    count = studio.settings.gaussians
    return text + stops_table(studio.forecaster.stops(scene, gaussians=count, seconds=known))


def refiner(studio: Studio) -> Handler:
    """The same, measured on the visitor's own object where that is quick."""

    def refine(cutout: Any, scene: Any, request: gr.Request) -> Any:
        session = session_of(request)
        text = studio.refine(session, cutout.path, scene) if cutout and scene else None
        return gr.skip() if text is None else with_stops(studio, session, scene, text)

    return refine


def runner(studio: Studio) -> Handler:
    """Cut-out and scene -> progress, then everything there is to see."""

    def run(
        cutout: Any, scene: Any, ticket: str | None, request: gr.Request
    ) -> Iterator[tuple[Any, ...]]:
        kept = [gr.skip()] * 4
        path = cutout.path if cutout else None
        going = (gr.skip(), gr.skip())
        # Gradio empties the outputs of a generator that ends without a word.
        yield (gr.skip(), gr.skip(), *going, *kept)
        for progress in studio.run(session_of(request), path, scene, ticket):
            if progress.state == "running":
                yield (progress.data(), gr.skip(), *going, *kept)
            else:
                shown = kept if progress.done is None else results(progress.done, progress, studio)
                kept_done = gr.skip() if progress.done is None else progress.done
                yield (progress.data(), kept_done, *rested(), *shown)

    return run


def beginner(studio: Studio) -> Handler:
    """At the click itself, before the queue: a ticket, and the page says that it waits."""

    def begin(request: gr.Request) -> tuple[Any, ...]:
        waiting = Progress(state="waiting").data()
        ticket = studio.announce(session_of(request))
        return ticket, waiting, gr.update(interactive=False), gr.update(visible=True)

    return begin


def refuser(studio: Studio) -> Handler:
    """The queue would not take the click; Gradio has said why."""

    def refused(request: gr.Request) -> tuple[Any, ...]:
        studio.visitors.stop(session_of(request))
        message = "Too many visitors are waiting. Try again soon."
        return Progress(state="refused", message=message).data(), *rested()

    return refused


def rested() -> tuple[Any, Any]:
    """The buttons when nothing runs: Generate can be pressed, Cancel is gone."""
    return gr.update(interactive=True), gr.update(visible=False)


def pick(event: gr.EventData) -> str | None:
    """An example picture by its name."""
    path = EXAMPLES / f"{(event._data or {}).get('name')}.png"
    return str(path) if path in EXAMPLES.glob("*.png") else None


def stopper(studio: Studio) -> Handler:
    """Stop this visitor's work.

    A run that has started says itself that it has stopped: were it said here as well, the run's
    last word on its progress could come after it and stay. Cancelling it in Gradio, too, would
    close the run's stream before that word.
    """

    def stop(request: gr.Request) -> tuple[Any, ...]:
        if studio.visitors.stop(session_of(request)):
            return gr.skip(), gr.skip(), gr.skip()
        progress = Progress(state="stopped", message="Stopped. Nothing was changed.")
        return progress.data(), *rested()

    return stop


def leaver(studio: Studio) -> Handler:
    """The visitor has closed the page."""

    def leave(request: gr.Request) -> None:
        studio.visitors.leave(session_of(request))

    return leave


def results(done: Done, progress: Progress, studio: Studio) -> list[Any]:
    """Values of the viewer, the videos, the report and the take-away panel."""
    report = read_report(done)
    scene = Clip.load(done.clip / "clip.safetensors").scene
    stops = studio.forecaster.stops(Scene.from_data(scene), gaussians=report["gaussians"])
    return [
        {"pack": _file(done.films / "clip.pack")},
        {"films": [{"name": path.stem, "file": _file(path)} for path in _films(done)]},
        as_html(report, scene, progress.expected, stops),
        _takeaway(done),
    ]


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


def session_of(request: gr.Request) -> str:
    """Whose request it is; one without a session belongs to nobody else."""
    return str(request.session_hash or secrets.token_hex(16))
