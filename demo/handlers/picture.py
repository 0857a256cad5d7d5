"""Events of the picture: it is chosen, corrected by a click or the brush, and shown cut out.

A file of Gaussians may take its place: it is chosen, and shown all ways up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gradio as gr

from phy124.errors import InputError
from phy124.rendering.orienting import candidates

from ..identity import address_of, visitor_of
from ..jobs import Studio
from ..known import AXES
from ..line import Job
from ..pictures import is_shown
from ..sentences import sentence
from ..source import Cutout, GaussianFile, Source
from ..strokes import place_of, strokes_of
from .event import Handler, data_of, file_of, job_of, path_of, table_of

IF_WRONG = "If it is wrong, click the object in your picture, or correct it with the brush."
FORGOTTEN = "The server no longer has your picture. Choose it once more."
EXAMPLES = Path(__file__).parents[1] / "examples"


def chooser(studio: Studio) -> Handler:
    """Handler: a picture or a file was sent; starts to cut it out or to read it, and forgets all
    about the one before.
    """

    def choose(event: gr.EventData, request: gr.Request) -> tuple[Any, Any, Any]:
        path, example = data_of(event).get("upload"), data_of(event).get("example")
        if path is None and example is None:
            return {}, None, {}
        try:
            studio.visitors.get(visitor_of(request), address_of(request))
            if example is not None:
                path = _sent_example(studio, visitor_of(request), example)
            job = studio.take(visitor_of(request), path)
        except InputError as error:
            return _not_cut(error), None, {}
        return {**_cutting(studio, job), "picture": _picture(job)}, None, {}

    return choose


def corrector(studio: Studio) -> Handler:
    """Handler: brush strokes or a click on another object; starts to correct the cut-out."""

    def correct(shown: Any, source: Any, event: gr.EventData, request: gr.Request) -> Any:
        made = source if isinstance(source, Cutout) else None
        picture = made.picture if made else path_of(table_of(shown).get("picture"))
        try:
            strokes = strokes_of(data_of(event).get("strokes", []))
            pick = place_of(data_of(event).get("pick")) or (made and made.pick)
            job = studio.cut(visitor_of(request), picture, strokes, pick)
        except InputError as error:
            return {**table_of(shown), **_not_cut(error)}
        return {**table_of(shown), **_cutting(studio, job)}

    return correct


def cut_shower(studio: Studio) -> Handler:
    """Handler: a cut-out has ended; shows it, or clears it if it failed."""

    def show(shown: Any, source: Any, event: gr.EventData, request: gr.Request) -> tuple[Any, ...]:
        job = job_of(studio, request, event)
        if job is None or not job.over:
            # Not skipped: the panel asks no other question until this one is answered.
            return {**table_of(shown), "job": None, "message": FORGOTTEN}, source, gr.skip()
        made = job.progress.result
        if made is None:
            failed = {"job": None, "message": job.progress.message, "picture": _picture(job)}
            return {**table_of(shown), **failed}, source, gr.skip()
        if isinstance(made, GaussianFile):
            return shown_source(made), made, ways(made)
        doubts = [*made.doubts, IF_WRONG] if made.doubts else []
        return {**shown_source(made), "doubts": " ".join(doubts)}, made, gr.skip()

    return show


def shown_source(made: Source) -> dict[str, Any]:
    """What the object is made of, as the panel of the picture takes it."""
    picture = file_of(Path(made.picture))
    if isinstance(made, Cutout):
        return {"picture": picture, "cutout": file_of(Path(made.path)), "by": made.by}
    said = f"{made.format[0].upper()}{made.format[1:]}, {made.count:,} Gaussians."
    return {"picture": picture, "file": " ".join([said, *made.notes])}


def ways(made: GaussianFile) -> dict[str, Any]:
    """A file's orientations, as the panel of what is known takes them."""
    pictures = {path.stem: file_of(path) for path in sorted(made.pictures.glob("*.webp"))}
    ups = [reading.model_dump(include=set(AXES)) for reading in candidates(None)]
    return {"ways": {**made.axes._asdict(), "ups": ups, "pictures": pictures}}


def _cutting(studio: Studio, job: Job) -> dict[str, Any]:
    """That a picture is being cut out or a file read, and about how many seconds a search takes."""
    if job.kind == "read":
        return {"job": job.name, "reads": True}
    seconds = studio.search_seconds
    return {"job": job.name, "seconds": seconds and max(1, round(seconds))}


def _picture(job: Job) -> dict[str, Any] | None:
    """The picture being cut out, as soon as there is one that browsers can show."""
    path = Path(job.subject)
    shows = job.kind == "cut" and path.is_file() and is_shown(path)
    return file_of(path) if shows else None


def _not_cut(error: InputError) -> dict[str, Any]:
    return {"job": None, "message": sentence(error), "again": error.field == "queue"}


def _sent_example(studio: Studio, visitor: str, name: Any) -> str:
    """An example picture, as if the visitor had sent it."""
    path = EXAMPLES / f"{name}.png"
    if path not in EXAMPLES.glob("*.png"):
        raise InputError("image", "none", "There is no such example.", "Choose another one.")
    return str(studio.visitors.store(visitor, path.read_bytes(), ".png"))
