"""Events of a live run: it is asked for, and what was done in it becomes a clip."""

from __future__ import annotations

from typing import Any

import gradio as gr

from phy124.errors import InputError

from ..identity import visitor_of
from ..jobs import Studio
from ..progress import Progress
from ..sentences import sentence
from ..touch import limits_of
from .event import Handler
from .run import rested, shown_job, working

FORGOTTEN = "There is no live run any more. Start another one."


def toucher(studio: Studio) -> Handler:
    """Handler: Touch was pressed; tells the panel where its live run is, or why there is none."""

    def touch(source: Any, scene: Any, told: Any, request: gr.Request) -> dict[str, Any]:
        name = visitor_of(request)
        try:
            asked = studio.asked(name, source, scene)
            order = studio.order(asked, studio.known(name, told))
            ticket = studio.touches.give(name, order)
        except InputError as error:
            return {"message": sentence(error)}
        return {"ticket": ticket.name}

    return touch


def saver(studio: Studio) -> Handler:
    """Handler: a live run was saved; starts the run of its session as any other scene."""

    def save(source: Any, told: Any, request: gr.Request) -> tuple[Any, ...]:
        name = visitor_of(request)
        ticket = studio.touches.own(name)
        if ticket is None or ticket.session is None:
            return Progress(state="refused", message=FORGOTTEN).data(), *rested()
        objects = 1 + len(ticket.session.get("objects", []))
        limits = limits_of(studio.settings, objects * studio.count(source))
        try:
            job = studio.run(name, source, ticket.session, told, limits)
        except InputError as error:
            return Progress(state="refused", message=sentence(error)).data(), *rested()
        studio.touches.leave(name)
        return shown_job(job), *working()

    return save
