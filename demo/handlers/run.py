"""Events of a run: what it would take, its start, its study and its stop."""

from __future__ import annotations

from html import escape
from typing import Any

import gradio as gr

from phy124.accuracy.forecast import GUESS
from phy124.accuracy.load import format_span
from phy124.errors import InputError
from phy124.scene import Scene

from ..catalogue import scene_of
from ..forecast import promise_of, stops_table
from ..identity import visitor_of
from ..jobs import Studio
from ..line import Job
from ..progress import Progress
from ..sentences import complaint, sentence
from ..source import Source
from ..studies import Measurement
from ..visitors import key
from .event import Handler


def forecaster(studio: Studio) -> Handler:
    """Handler: the scene changed; returns its forecast."""

    def forecast(source: Source | None, scene: Any, told: Any, request: gr.Request) -> str:
        if not scene:
            return ""
        return forecast_of(studio, visitor_of(request), source, scene, told)

    return forecast


def forecast_of(
    studio: Studio, name: str, source: Source | None, data: Any, told: Any, *, opened: bool = False
) -> str:
    """The forecast of a run as HTML, or why it is refused.

    Args:
        studio: What all visitors share.
        name: The visitor's name.
        source: What the object is made of, if it is there.
        data: The scene as plain data.
        told: What else is known of the object.
        opened: Whether the table of all stops is shown.
    """
    try:
        text = studio.forecast(name, source, data, told)
        return with_stops(studio, name, source, data, told, text, opened=opened)
    except InputError as error:
        return refused(error)


def refused(error: InputError) -> str:
    """A refusal in the place of a forecast: all of it is seen, and nothing of it is folded."""
    return f'<p class="refused">{escape(complaint(error))}</p>'


def with_stops(
    studio: Studio, name: str, source: Source | None, data: Any, told: Any, text: str, *,
    opened: bool = False,
) -> str:  # fmt: skip
    """A forecast as one line of HTML that opens to a table of all stops of the accuracy slider.

    Below it stands the error measured on this scene, or a button that measures it.

    Args:
        studio: What all visitors share.
        name: The visitor's name.
        source: What the object is made of, if it is there.
        data: The scene as plain data.
        told: What else is known of the object.
        text: The forecast.
        opened: Whether the line is open.

    Raises:
        InputError: Something in the request cannot be used.
    """
    visitor = studio.visitors.known(name)
    scene = scene_of(data, studio.settings, visitor and visitor.folder / "uploads")
    study = studio.study(name, source, scene, told)
    error = _error_line(studio, name, source, scene, told, study)
    known = visitor.forecasts.get(key(scene.data())) if visitor else None
    stops = studio.forecaster.stops(
        scene, gaussians=studio.count(source), seconds=known, study=study,
        thickness=studio.thickness(name, source, scene, told),
    )  # fmt: skip
    table = stops_table(stops, scene.accuracy)
    if study is not None:
        table += f"<p>Measured on this scene, without drawing:</p>{study.table()}"
    brief, _, rest = text.partition(": ")
    return (
        f"<details{' open' if opened else ''}><summary>{escape(brief)}</summary>"
        f"<p>{escape(rest)}</p>{table}</details>{error}"
    )


def _error_line(
    studio: Studio, name: str, source: Source | None, scene: Scene, told: Any,
    study: Measurement | None,
) -> str:  # fmt: skip
    """The error measured on this scene, or a button that measures it."""
    said = promise_of(scene, studio.thickness(name, source, scene, told), study)
    if study is not None:
        return f'<p class="measured">{said.measured}</p>'
    if not said.missing:
        return ""
    seconds = studio.study_seconds(name, source, scene, told)
    span = format_span(studio.forecaster.load().span(seconds, unsure=GUESS))
    button = '<button type="button" class="quiet" data-measure>Measure</button>'
    return f"<p>{said.missing.capitalize()}; {button} takes {span}.</p>"


def refiner(studio: Studio) -> Handler:
    """Handler: the scene changed; returns a forecast by a probe of the object if that is quick."""

    def refine(source: Source | None, scene: Any, told: Any, request: gr.Request) -> str:
        if not scene:
            return ""
        name = visitor_of(request)
        try:
            text = studio.refine(name, source, scene, told)
            # Not skipped: the last probe, of an older scene, may have been shown meanwhile.
            text = text or studio.forecast(name, source, scene, told)
            return with_stops(studio, name, source, scene, told, text)
        except InputError as error:
            return refused(error)

    return refine


def starter(studio: Studio) -> Handler:
    """Handler: Generate was pressed; starts a run that the progress panel follows, or refuses."""

    def start(source: Source | None, scene: Any, told: Any, request: gr.Request) -> tuple[Any, ...]:
        try:
            job = studio.run(visitor_of(request), source, scene, told)
        except InputError as error:
            state = "full" if error.field == "queue" else "refused"
            return Progress(state=state, message=sentence(error)).data(), *rested()
        return shown_job(job), *working()

    return start


def measurer(studio: Studio) -> Handler:
    """Handler: Measure was pressed; starts to measure the scene's error, or refuses."""

    def start_study(
        source: Source | None, scene: Any, told: Any, request: gr.Request
    ) -> tuple[Any, ...]:
        try:
            job = studio.measure(visitor_of(request), source, scene, told)
        except InputError as error:
            return Progress(state="refused", message=sentence(error)).data(), *rested()
        return shown_job(job), *working()

    return start_study


def shown_job(job: Job) -> dict[str, Any]:
    """A job for the progress panel, which follows it."""
    return {**job.progress.data(), "job": job.name, "kind": job.kind}


def rested() -> tuple[Any, Any]:
    """The buttons while nothing runs: Generate can be pressed, Cancel is hidden."""
    return gr.update(interactive=True), gr.update(visible=False)


def working() -> tuple[Any, Any]:
    """The buttons while something runs."""
    return gr.update(interactive=False), gr.update(visible=True)


def stopper(studio: Studio) -> Handler:
    """Handler: Cancel was pressed; stops this visitor's job, which the progress panel follows."""

    def stop(request: gr.Request) -> None:
        visitor = studio.visitors.known(visitor_of(request))
        if visitor is not None:
            visitor.stop()

    return stop
