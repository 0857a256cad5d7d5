"""Handle the events of runs, studies and live runs: forecast, start, cancel, save."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from typing import Any

import gradio as gr

from phy124.errors import InputError
from phy124.scene import PRESETS, Scene

from ..forecast import Estimate, describe_error, format_seconds, stops_table
from ..guard import visitor_of
from ..jobs import Studio
from ..line import Job, api_message, user_message
from ..progress import Done, Progress
from ..source import Choice, Source
from ..touch import limits_of
from .event import Handler

GONE = "The server no longer has this result. Generate it again."
FORGOTTEN = "The live run has ended. Start another one."
INFO = """<svg viewBox="0 0 20 20" role="img" aria-label="More about the time and the error">
<circle cx="10" cy="10" r="7.6"/><path d="M10 9.2v4.4M10 6.4v.1"/></svg>"""


def on_scene_changed(studio: Studio) -> Handler:
    """Handle a change of the scene: return the predicted time of its run."""

    def forecast(
        source: Source | None, scene: Any, extras: Any, change: Any, request: gr.Request
    ) -> dict[str, Any]:
        if not scene or source is None:
            return answer_change(change, None)
        choice = Choice(visitor_of(request), source, scene, extras)
        return answer_change(change, forecast_of(studio, choice))

    return forecast


def answer_change(change: Any, html: str | None) -> dict[str, Any]:
    """Return the value of the forecast panel; the panel ignores answers to earlier changes.

    `change` is the serial number of the change; `html` is None if there is no picture.
    """
    return {"change": change, "html": html}


def forecast_of(studio: Studio, choice: Choice, *, opened: bool = False) -> str:
    """Return the forecast of a run as HTML, or the reason why the run is refused.

    If `opened` is true, the panel with the table of accuracies is open.
    """
    try:
        return show_estimate(studio.forecast(choice), opened=opened)
    except InputError as error:
        return show_refusal(error)


def show_refusal(error: InputError) -> str:
    """Format the reason why a run is refused; the page shows the reason instead of a forecast."""
    return f'<p class="refused">{escape(api_message(error))}</p>'


def show_estimate(estimate: Estimate, *, opened: bool = False) -> str:
    """Format a forecast as HTML: the time, and a pop-up panel with the error and the accuracies.

    The panel is open at first if `opened` is true. If the time limit will end the run, a warning
    comes first.
    """
    table = stops_table(estimate.stops, estimate.accuracy)
    if estimate.study is not None:
        table += f"<p>Measured on this scene, without drawing:</p>{estimate.study.table()}"
    _, _, rest = estimate.sentence.partition(": ")
    course = estimate.course
    seconds = course.seconds if course else estimate.seconds
    ends = course.warning if course else ""
    warning = f'<p class="ends">{escape(ends)}</p>' if ends else ""
    return (
        f'{warning}<details class="pop about"{" open" if opened else ""}><summary>about '
        f'{format_seconds(seconds)} {INFO}</summary><div class="panel">'
        f"{_error_line(estimate)}{table}<small>{escape(rest)}</small></div></details>"
    )


def _error_line(estimate: Estimate) -> str:
    kind = ' class="measured"' if estimate.promise.of_scene else ""
    line = f"<p{kind}>{describe_error(estimate.promise, 'Off')}</p>"
    if estimate.study_seconds is None:
        return line
    return (
        f'{line}<p class="measure"><button type="button" data-measure>Measure</button> '
        f"<span>about {format_seconds(estimate.study_seconds)}</span></p>"
    )


def on_refine(studio: Studio) -> Handler:
    """Handle the end of a series of changes: make a forecast by a short trial run, if possible."""

    def refine(
        source: Source | None, scene: Any, extras: Any, change: Any, request: gr.Request
    ) -> dict[str, Any]:
        if not scene or source is None:
            return answer_change(change, None)
        choice = Choice(visitor_of(request), source, scene, extras)
        try:
            # An answer is always necessary, because the page may show the forecast of an older
            # scene.
            html = show_estimate(studio.refine(choice) or studio.forecast(choice))
        except InputError as error:
            html = show_refusal(error)
        return answer_change(change, html)

    return refine


def on_generate(studio: Studio) -> Handler:
    """Handle the button "Generate": start a run and show its progress, or refuse the run."""

    def start(
        source: Source | None, scene: Any, extras: Any, request: gr.Request
    ) -> tuple[Any, ...]:
        try:
            job = studio.run(Choice(visitor_of(request), source, scene, extras))
        except InputError as error:
            state = "full" if error.field == "queue" else "refused"
            return Progress(state=state, message=user_message(error)).data(), *idle_buttons()
        return follow_job(job), *busy_buttons()

    return start


def on_finer(studio: Studio) -> Handler:
    """Handle the button "finer": run the displayed motion at the next finer accuracy."""

    def start(done: Done | None, request: gr.Request) -> tuple[Any, ...]:
        visitor = studio.visitors.find(visitor_of(request))
        job = visitor and visitor.run_of(done)
        choice = job and job.choice
        if choice is None or (finer := next_accuracy(choice.data)) is None:
            return Progress(state="refused", message=GONE).data(), *idle_buttons()
        try:
            job = studio.run(replace(choice, data={**choice.data, "accuracy": finer}))
        except InputError as error:
            return Progress(state="refused", message=user_message(error)).data(), *idle_buttons()
        return {**follow_job(job), "finer": True}, *busy_buttons()

    return start


def next_accuracy(data: Any) -> str | None:
    """Return the name of the next finer accuracy for a scene; None if there is none."""
    cells = Scene.from_data(data).resolution.cells
    return next((name for name, each in PRESETS.items() if each.cells > cells), None)


def on_measure(studio: Studio) -> Handler:
    """Handle the button "Measure": start to measure the scene's error, or refuse to do so."""

    def start_study(
        source: Source | None, scene: Any, extras: Any, request: gr.Request
    ) -> tuple[Any, ...]:
        try:
            job = studio.measure(Choice(visitor_of(request), source, scene, extras))
        except InputError as error:
            return Progress(state="refused", message=user_message(error)).data(), *idle_buttons()
        return follow_job(job), *busy_buttons()

    return start_study


def follow_job(job: Job) -> dict[str, Any]:
    """Return the value that makes the progress panel show the progress of a job."""
    return {**job.progress.data(), "job": job.name, "kind": job.kind}


def idle_buttons() -> tuple[Any, Any]:
    """Return the buttons while no job runs: Generate is enabled, Cancel is hidden."""
    return gr.update(interactive=True), gr.update(visible=False)


def busy_buttons() -> tuple[Any, Any]:
    """Return the buttons while a job runs: Generate is disabled, Cancel is visible."""
    return gr.update(interactive=False), gr.update(visible=True)


def on_cancel(studio: Studio) -> Handler:
    """Handle the button "Cancel": stop this visitor's runs and studies, but no other job."""

    def stop(request: gr.Request) -> None:
        visitor = studio.visitors.find(visitor_of(request))
        if visitor is not None:
            visitor.stop("run", "measure")

    return stop


def on_touch(studio: Studio) -> Handler:
    """Handle the button "Touch": return the ID of a permitted live run, or an error message."""

    def touch(source: Any, scene: Any, extras: Any, request: gr.Request) -> dict[str, Any]:
        name = visitor_of(request)
        try:
            asked = studio.resolve(Choice(name, source, scene))
            order = studio.order(asked, studio.check_extras(name, extras))
            ticket = studio.touches.give(name, order)
        except InputError as error:
            return {"message": user_message(error)}
        return {"ticket": ticket.name}

    return touch


def on_save(studio: Studio) -> Handler:
    """Handle the button "save" of the touch panel: start a run that repeats the live session.

    The touch panel hides the progress panel, so it shows the reason of a refusal itself.
    """

    def save(source: Any, extras: Any, request: gr.Request) -> tuple[Any, ...]:
        name = visitor_of(request)
        ticket = studio.touches.ticket_of(name)
        if ticket is None or ticket.session is None:
            return gr.skip(), *idle_buttons(), {"refused": FORGOTTEN}
        objects = 1 + len(ticket.session.get("objects", []))
        limits = limits_of(studio.settings, objects * studio.count(source))
        try:
            job = studio.run(Choice(name, source, ticket.session, extras, limits))
        except InputError as error:
            return gr.skip(), *idle_buttons(), {"refused": user_message(error)}
        studio.touches.leave(name)
        return follow_job(job), *busy_buttons(), gr.skip()

    return save
