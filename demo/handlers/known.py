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


def view_chooser(studio: Studio) -> Handler:
    """Handler: a picture was sent for an option; starts to cut it out, a depth map is checked."""

    def choose(event: gr.EventData, request: gr.Request) -> dict[str, Any]:
        option, path = str(data_of(event).get("option")), data_of(event).get("upload")
        try:
            known = studio.known(visitor_of(request), {option: path})
            if known.depth.depth is not None:
                return _answer(option, picture=file_of(known.depth.depth))
            job = studio.cut(visitor_of(request), path, kind="view")
        except InputError as error:
            return _answer(option, message=sentence(error))
        return _answer(option, job=job.name)

    return choose


def object_chooser(studio: Studio) -> Handler:
    """Handler: a picture of a further object was sent; starts to cut it out."""

    def choose(event: gr.EventData, request: gr.Request) -> dict[str, Any]:
        option, path = str(data_of(event).get("option")), data_of(event).get("upload")
        try:
            job = studio.cut(visitor_of(request), path, kind="view")
        except InputError as error:
            return _answer(option, message=sentence(error))
        return _answer(option, job=job.name)

    return choose


def view_shower(studio: Studio) -> Handler:
    """Handler: what such a picture shows has been cut out; shows it, or says why it failed."""

    def show(event: gr.EventData, request: gr.Request) -> Any:
        job = job_of(studio, request, event)
        if job is None or not job.over:
            return gr.skip()
        option, made = str(data_of(event).get("option")), job.progress.result
        if made is None:
            return _answer(option, message=job.progress.message)
        return _answer(option, **shown_source(made), doubts=" ".join(made.doubts))

    return show


def _answer(option: str, **told: Any) -> dict[str, Any]:
    """What the panel then adds to what it shows of the option."""
    return {"answer": {"option": option, **told}}
