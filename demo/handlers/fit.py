"""Handles the events of the fit panel: offering, starting, stopping and ending a fit to a video."""

from __future__ import annotations

from typing import Any

import gradio as gr

from phy124.errors import InputError
from phy124.studies.fit.page import figure

from ..fits import FitOptions, FitResult, newest
from ..fits.search import NAME
from ..guard import visitor_of
from ..jobs import Studio
from ..line import Job, user_message
from ..visitors import Visitor
from ..work import Done
from .event import Handler, data_of, file_of, job_of, table_of
from .results import takeaway_of

DIGITS = 3
"""Number of significant digits with which a stiffness is shown."""


def on_result_shown(studio: Studio) -> Handler:
    """Show the latest fit of a new result on the page, or offer a fit."""

    def offer(done: Done | None, request: gr.Request) -> dict[str, Any]:
        return _panel(studio, done, studio.visitors.find(visitor_of(request)))

    return offer


def on_fit_begin(studio: Studio) -> Handler:
    """Handle the event "begin" of the fit panel: start a fit to an uploaded video."""

    def start(
        done: Done | None, shown: Any, event: gr.EventData, request: gr.Request
    ) -> dict[str, Any]:
        data = data_of(event)
        try:
            job = studio.fits.begin(visitor_of(request), done, data.get("upload"), data)
        except InputError as error:
            return {**table_of(shown), "job": None, "message": user_message(error)}
        return {**table_of(shown), "job": job.name, "message": "", "found": None}

    return start


def on_fit_stop(studio: Studio) -> Handler:
    """Handle the event "stop" of the fit panel: cancel the fit, but no other job."""

    def stop(request: gr.Request) -> None:
        visitor = studio.visitors.find(visitor_of(request))
        job = visitor and visitor.latest("fit")
        if job:
            job.cancel()

    return stop


def on_fit_end(studio: Studio) -> Handler:
    """Handle the event "ended" of the fit panel: show the fit, or the reason why it failed."""

    def show(done: Done | None, event: gr.EventData, request: gr.Request) -> tuple[Any, Any]:
        visitor, job = studio.visitors.find(visitor_of(request)), job_of(studio, request, event)
        if job is None or not job.over or done is None:
            return gr.skip(), gr.skip()
        panel = _panel(studio, done, visitor)
        if job.progress.result is None:
            return {**panel, "message": job.progress.message}, gr.skip()
        return panel, {**takeaway_of(done), "asked": "fit"}

    return show


def _panel(studio: Studio, done: Done | None, visitor: Visitor | None) -> dict[str, Any]:
    try:
        offer = studio.fits.offer(done)
    except InputError as error:
        return {"refusal": user_message(error)}
    assert done is not None
    result, job = newest(done), visitor.latest("fit") if visitor else None
    return {
        "offer": offer,
        "fields": FitOptions.model_json_schema()["properties"],
        "largest": studio.settings.max_video_mb,
        "job": job.name if job and _is_of(job, done) else None,
        "found": result and _show_result(result),
    }


def _is_of(job: Job, done: Done) -> bool:
    return not job.over and job.subject == str(done.clip)


def _show_result(result: FitResult) -> dict[str, Any]:
    report = result.report
    return {
        "sentences": summarise(report),
        "figure": figure(report, ""),
        "film": file_of(result.folder / "comparison.mp4"),
        "material": result.material,
    }


def summarise(report: dict[str, Any]) -> list[str]:
    """Summarise the report of a fit in sentences."""
    value, shown = report["found"][NAME], report["pictures"]
    low, high = (_format(end) for end in value["interval"])
    was = _format(float(shown["was"][NAME]))
    interval = f"95 % interval {low} to {high} Pa"
    lines = [f"Softness: {_format(value['value'])} Pa ({interval}); before the fit {was} Pa."]
    least, most = (_format(end) for end in value["limit"]["interval"])
    if len(report["grids"]) > 1:
        lines.append(
            f"This value is for the accuracy of this result. After correction of the grid error, "
            f"the stiffness is {_format(value['limit']['value'])} Pa ({least} to {most} Pa)."
        )
    if shown["before"] and shown["fitted"]:
        before, after = (_rms(shown[name]) for name in ("before", "fitted"))
        lines.append(
            f"The outlines now differ by {after:.2%} of a pixel; before the fit, by {before:.2%}."
        )
    if laid := shown["laid"]:
        lines.append(
            f"The video's first picture was scaled by {laid['scale']:.2f} and moved to match the "
            f"object; the outlines share {laid['shared']:.0%} of their area."
        )
    lines += [f"{sum(report['runs'])} runs in {report['seconds']:.0f} s.", *report["notes"]]
    return lines


def _rms(values: list[float]) -> float:
    return (sum(value**2 for value in values) / len(values)) ** 0.5


def _format(value: float) -> str:
    return f"{float(f'{value:.{DIGITS}g}'):,.0f}"
