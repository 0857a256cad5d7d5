"""Handles the picture panel: choosing a picture, and showing and correcting the cut-out.

Instead of a picture, a visitor may send a file of Gaussians. The page then shows the object in all
possible orientations.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gradio as gr

from phy124.errors import InputError
from phy124.rendering.orienting import candidates

from ..extras import AXES
from ..guard import address_of, visitor_of
from ..jobs import Studio
from ..line import Job, user_message
from ..pictures import MISSING, is_shown, read_place, read_strokes
from ..source import Cutout, GaussianFile, Source
from .event import Handler, data_of, file_of, job_of, path_of, table_of

CORRECT = " Click the object, or correct the cut-out."
FORGOTTEN = "The server no longer has this picture. Choose it again."
EXAMPLES = Path(__file__).parents[1] / "examples"


def on_choose(studio: Studio) -> Handler:
    """Handle the event "choose" of the picture panel: start to cut out a picture or read a file.

    The work on the earlier picture is cancelled.
    """

    def choose(event: gr.EventData, request: gr.Request) -> tuple[Any, Any, Any]:
        earlier = job_of(studio, request, event)
        if earlier is not None and earlier.kind in ("cut", "read"):
            earlier.cancel()
        path, example = data_of(event).get("upload"), data_of(event).get("example")
        if path is None and example is None:
            return {}, None, {}
        try:
            name = _admit(studio, request)
            if example is not None:
                path = _sent_example(studio, name, example)
            job = studio.take(name, path)
        except InputError as error:
            return _not_cut(error), None, {}
        return {**_cutting(studio, job), "picture": _picture(job)}, None, {}

    return choose


def on_correct(studio: Studio) -> Handler:
    """Handle the event "correct" of the picture panel: start to correct the cut-out."""

    def correct(shown: Any, source: Any, event: gr.EventData, request: gr.Request) -> Any:
        made = source if isinstance(source, Cutout) else None
        picture = made.picture if made else path_of(table_of(shown).get("picture"))
        try:
            strokes = read_strokes(data_of(event).get("strokes", []))
            pick = read_place(data_of(event).get("pick")) or (made and made.pick)
            job = studio.cut_out(_admit(studio, request), picture, strokes, pick)
        except InputError as error:
            return {**table_of(shown), **_not_cut(error)}
        return {**table_of(shown), **_cutting(studio, job)}

    return correct


def on_cut_end(studio: Studio) -> Handler:
    """Handle the event "cut" of the picture panel: show the cut-out, or why there is none."""

    def show(shown: Any, source: Any, event: gr.EventData, request: gr.Request) -> tuple[Any, ...]:
        job = job_of(studio, request, event)
        if job is None or not job.over:
            # An answer is always necessary, because the panel waits for it before it sends other
            # events.
            return {**table_of(shown), "job": None, "message": FORGOTTEN}, source, gr.skip()
        made = job.progress.result
        if made is None:
            failed = {"job": None, "message": job.progress.message, "picture": _picture(job)}
            return {**table_of(shown), **failed}, source, gr.skip()
        if isinstance(made, GaussianFile):
            return show_source(made), made, ways(made)
        doubts = _doubts(made)
        if made.doubts[:1] == (MISSING,):
            doubts["warning"] += CORRECT
        return {**show_source(made), **doubts}, made, gr.skip()

    return show


def show_source(made: Source) -> dict[str, Any]:
    """Return the value of the picture panel for the object's source."""
    picture = file_of(Path(made.picture))
    if isinstance(made, Cutout):
        return {"picture": picture, "cutout": file_of(Path(made.path))}
    text = f"{made.format[0].upper()}{made.format[1:]}, {made.count:,} Gaussians."
    return {"picture": picture, "file": " ".join([text, *made.notes])}


def _doubts(made: Cutout) -> dict[str, str]:
    return {"warning": "".join(made.doubts[:1]), "doubts": " ".join(made.doubts[1:])}


def ways(made: GaussianFile) -> dict[str, Any]:
    """Return the value of the extras panel: the possible orientations of a file of Gaussians."""
    pictures = {path.stem: file_of(path) for path in sorted(made.pictures.glob("*.webp"))}
    ups = [reading.model_dump(include=set(AXES)) for reading in candidates(None)]
    return {"ways": {**made.axes._asdict(), "ups": ups, "pictures": pictures}}


def _cutting(studio: Studio, job: Job) -> dict[str, Any]:
    """Return the panel's value while a job runs, with the usual duration of a cut-out [s]."""
    if job.kind == "read":
        return {"job": job.name, "reads": True}
    seconds = studio.search_seconds
    return {"job": job.name, "seconds": seconds and max(1, round(seconds))}


def _picture(job: Job) -> dict[str, Any] | None:
    """Return the picture of a job; None if browsers cannot show its format."""
    path = Path(job.subject)
    shows = job.kind == "cut" and path.is_file() and is_shown(path)
    return file_of(path) if shows else None


def _not_cut(error: InputError) -> dict[str, Any]:
    return {"job": None, "message": user_message(error), "again": error.field == "queue"}


def _admit(studio: Studio, request: gr.Request) -> str:
    """Return the name of a request's visitor; create the visitor if the address may have more."""
    name = visitor_of(request)
    studio.visitors.get(name, address_of(request))
    return name


def _sent_example(studio: Studio, visitor: str, name: Any) -> str:
    path = EXAMPLES / f"{name}.png"
    if path not in EXAMPLES.glob("*.png"):
        raise InputError("image", "none", "This example does not exist.", "Choose another one.")
    return str(studio.visitors.store(visitor, path.read_bytes(), ".png"))


def on_choose_view(studio: Studio) -> Handler:
    """Handle the event "choose" of the extras panel: cut out a view, or check a depth map."""

    def choose(event: gr.EventData, request: gr.Request) -> dict[str, Any]:
        option, path = str(data_of(event).get("option")), data_of(event).get("upload")
        try:
            name = _admit(studio, request)
            inputs = studio.check_extras(name, {option: path})
            if inputs.depth.path is not None:
                return _answer(event, picture=file_of(inputs.depth.path))
            job = studio.cut_out(name, path, kind="view")
        except InputError as error:
            return _answer(event, message=user_message(error))
        return _answer(event, job=job.name)

    return choose


def on_choose_object(studio: Studio) -> Handler:
    """Handle the event "choose" of the objects panel: start to cut out a further object."""

    def choose(event: gr.EventData, request: gr.Request) -> dict[str, Any]:
        path = data_of(event).get("upload")
        try:
            job = studio.cut_out(_admit(studio, request), path, kind="view")
        except InputError as error:
            return _answer(event, message=user_message(error))
        return _answer(event, job=job.name)

    return choose


def on_view_cut(studio: Studio) -> Handler:
    """Handle the event "view" of two panels: show a cut-out or an error message."""

    def show(event: gr.EventData, request: gr.Request) -> Any:
        job = job_of(studio, request, event)
        if job is None or not job.over:
            return _answer(event, message=FORGOTTEN)
        made = job.progress.result
        if made is None:
            return _answer(event, message=job.progress.message)
        return _answer(event, **show_source(made), **_doubts(made))

    return show


def _answer(event: gr.EventData, **values: Any) -> dict[str, Any]:
    """Return an answer with the event's number, so that the panel can ignore outdated answers."""
    asked = {name: value for name, value in data_of(event).items() if name in ("option", "ask")}
    return {"answer": {**asked, **values}}
