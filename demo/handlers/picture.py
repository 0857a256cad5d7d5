"""Events of the picture: it is chosen, corrected by a click or the brush, and shown cut out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gradio as gr

from phy124.errors import InputError
from phy124.imaging.heic import is_heic

from ..identity import visitor_of
from ..jobs import Cutout, Studio, sentence
from ..line import Job
from ..strokes import place_of, strokes_of
from .event import Handler, data_of, file_of, job_of, path_of

IF_WRONG = "If it is wrong, click the object in your picture, or correct it with the brush."
EXAMPLES = Path(__file__).parents[1] / "examples"


def chooser(studio: Studio) -> Handler:
    """Handler: a picture was sent; starts to cut it out and forgets all about the one before."""

    def choose(event: gr.EventData, request: gr.Request) -> tuple[Any, Any, Any]:
        path, example = data_of(event).get("upload"), data_of(event).get("example")
        if path is None and example is None:
            return {}, None, {}
        try:
            if example is not None:
                path = _sent_example(studio, visitor_of(request), example)
            job = studio.cut(visitor_of(request), path)
        except InputError as error:
            return _not_cut(error), None, {}
        return {**_cutting(studio, job), "picture": _picture(job)}, None, {}

    return choose


def corrector(studio: Studio) -> Handler:
    """Handler: brush strokes or a click on another object; starts to correct the cut-out."""

    def correct(shown: Any, cutout: Any, event: gr.EventData, request: gr.Request) -> Any:
        picture = path_of((shown or {}).get("picture")) if cutout is None else cutout.picture
        try:
            strokes = strokes_of(data_of(event).get("strokes", []))
            pick = place_of(data_of(event).get("pick")) or (cutout and cutout.pick)
            job = studio.cut(visitor_of(request), picture, strokes, pick)
        except InputError as error:
            return {**(shown or {}), **_not_cut(error)}
        return {**(shown or {}), **_cutting(studio, job)}

    return correct


def cut_shower(studio: Studio) -> Handler:
    """Handler: a cut-out has ended; shows it, or clears it if it failed."""

    def show(shown: Any, cutout: Any, event: gr.EventData, request: gr.Request) -> tuple[Any, Any]:
        job = job_of(studio, request, event)
        if job is None or not job.over:
            return gr.skip(), gr.skip()
        made = job.progress.result
        if made is None:
            failed = {"job": None, "message": job.progress.message, "picture": _picture(job)}
            return {**(shown or {}), **failed}, cutout
        doubts = [*made.doubts, IF_WRONG] if made.doubts else []
        return {**shown_cutout(made), "doubts": " ".join(doubts)}, made

    return show


def shown_cutout(made: Cutout) -> dict[str, Any]:
    """A picture and its cut-out, as the panel of the picture takes them."""
    files = {"picture": file_of(Path(made.picture)), "cutout": file_of(Path(made.path))}
    return {**files, "by": made.by}


def _cutting(studio: Studio, job: Job) -> dict[str, Any]:
    """That a picture is being cut out, and about how many seconds a search takes."""
    seconds = studio.search_seconds
    return {"job": job.name, "seconds": seconds and max(1, round(seconds))}


def _picture(job: Job) -> dict[str, Any] | None:
    """The picture being cut out, as soon as there is one that browsers can show."""
    path = Path(job.subject)
    return file_of(path) if path.exists() and not is_heic(path) else None


def _not_cut(error: InputError) -> dict[str, Any]:
    return {"job": None, "message": sentence(error), "again": error.field == "queue"}


def _sent_example(studio: Studio, visitor: str, name: Any) -> str:
    """An example picture, as if the visitor had sent it."""
    path = EXAMPLES / f"{name}.png"
    if path not in EXAMPLES.glob("*.png"):
        raise InputError("image", "none", "There is no such example.", "Choose another one.")
    studio.visitors.get(visitor)
    return str(studio.visitors.store(visitor, path.read_bytes(), ".png"))
