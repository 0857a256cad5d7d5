"""Events of pictures beside the first: of its other sides, or of further objects."""

from __future__ import annotations

from typing import Any

import gradio as gr

from phy124.errors import InputError

from ..identity import visitor_of
from ..jobs import Studio
from ..sentences import sentence
from .event import Handler, data_of, file_of, job_of
from .picture import shown_source

FORGOTTEN = "The server no longer has this picture. Choose it once more."


def view_chooser(studio: Studio) -> Handler:
    """Handler: a picture was sent for an option; starts to cut it out, a depth map is checked."""

    def choose(event: gr.EventData, request: gr.Request) -> dict[str, Any]:
        option, path = str(data_of(event).get("option")), data_of(event).get("upload")
        try:
            known = studio.known(visitor_of(request), {option: path})
            if known.depth.depth is not None:
                return _answer(event, picture=file_of(known.depth.depth))
            job = studio.cut(visitor_of(request), path, kind="view")
        except InputError as error:
            return _answer(event, message=sentence(error))
        return _answer(event, job=job.name)

    return choose


def object_chooser(studio: Studio) -> Handler:
    """Handler: a picture of a further object was sent; starts to cut it out."""

    def choose(event: gr.EventData, request: gr.Request) -> dict[str, Any]:
        path = data_of(event).get("upload")
        try:
            job = studio.cut(visitor_of(request), path, kind="view")
        except InputError as error:
            return _answer(event, message=sentence(error))
        return _answer(event, job=job.name)

    return choose


def view_shower(studio: Studio) -> Handler:
    """Handler: what such a picture shows has been cut out; shows it, or says why it failed."""

    def show(event: gr.EventData, request: gr.Request) -> Any:
        job = job_of(studio, request, event)
        if job is None or not job.over:
            return _answer(event, message=FORGOTTEN)
        made = job.progress.result
        if made is None:
            return _answer(event, message=job.progress.message)
        return _answer(event, **shown_source(made), doubts=" ".join(made.doubts))

    return show


def _answer(event: gr.EventData, **told: Any) -> dict[str, Any]:
    """What the panel then adds to what it shows of the option, unless it has asked again since."""
    asked = {name: value for name, value in data_of(event).items() if name in ("option", "ask")}
    return {"answer": {**asked, **told}}
