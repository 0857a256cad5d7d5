"""Events of a fit to a video: what it would take, its start, its stop and its end."""

from __future__ import annotations

from typing import Any

import gradio as gr

from phy124.errors import InputError
from phy124.studies.fit.page import figure

from ..fits import Asked, Found, newest
from ..fits.search import NAME
from ..identity import visitor_of
from ..jobs import Studio
from ..line import Job
from ..sentences import sentence
from ..visitors import Visitor
from ..work import Done
from .event import Handler, data_of, file_of, job_of, table_of
from .results import takeaway_of

DIGITS = 3
"""Significant digits of a softness that is shown."""


def fit_offerer(studio: Studio) -> Handler:
    """Handler: another result is shown; tells what a fit of it takes, or what one has found."""

    def offer(done: Done | None, request: gr.Request) -> dict[str, Any]:
        return _panel(studio, done, studio.visitors.known(visitor_of(request)))

    return offer


def fit_starter(studio: Studio) -> Handler:
    """Handler: a video was sent to be fitted; starts the fit that the panel follows, or refuses."""

    def start(
        done: Done | None, shown: Any, event: gr.EventData, request: gr.Request
    ) -> dict[str, Any]:
        told = data_of(event)
        try:
            job = studio.fits.begin(visitor_of(request), done, told.get("upload"), told)
        except InputError as error:
            return {**table_of(shown), "job": None, "message": sentence(error)}
        return {**table_of(shown), "job": job.name, "message": "", "found": None}

    return start


def fit_stopper(studio: Studio) -> Handler:
    """Handler: Cancel was pressed; stops this visitor's fit and nothing else."""

    def stop(request: gr.Request) -> None:
        visitor = studio.visitors.known(visitor_of(request))
        job = visitor and visitor.latest("fit")
        if job:
            job.cancel()

    return stop


def fit_shower(studio: Studio) -> Handler:
    """Handler: a fit has ended; shows what it found or why it did not, and offers its files."""

    def show(done: Done | None, event: gr.EventData, request: gr.Request) -> tuple[Any, Any]:
        visitor, job = studio.visitors.known(visitor_of(request)), job_of(studio, request, event)
        if job is None or not job.over or done is None:
            return gr.skip(), gr.skip()
        panel = _panel(studio, done, visitor)
        if job.progress.result is None:
            return {**panel, "message": job.progress.message}, gr.skip()
        return panel, {**takeaway_of(done), "asked": "fit"}

    return show


def _panel(studio: Studio, done: Done | None, visitor: Visitor | None) -> dict[str, Any]:
    """Everything that the panel shows of a result."""
    try:
        offer = studio.fits.offer(done)
    except InputError as error:
        return {"refusal": sentence(error)}
    assert done is not None
    found, job = newest(done), visitor.latest("fit") if visitor else None
    return {
        "offer": offer,
        "fields": Asked.model_json_schema()["properties"],
        "largest": studio.settings.max_video_mb,
        "job": job.name if job and _is_of(job, done) else None,
        "found": found and _shown(found),
    }


def _is_of(job: Job, done: Done) -> bool:
    """Whether a fit is going on, and is of this result."""
    return not job.over and job.subject == str(done.clip)


def _shown(found: Found) -> dict[str, Any]:
    """A finished fit: its sentences, its figure, and the material that the next run may have."""
    report = found.report
    return {
        "sentences": said(report),
        "figure": figure(report, ""),
        "film": file_of(found.folder / "comparison.mp4"),
        "material": found.material,
    }


def said(report: dict[str, Any]) -> list[str]:
    """What was found, in sentences."""
    value, shown = report["found"][NAME], report["pictures"]
    low, high = (_spoken(end) for end in value["interval"])
    was = _spoken(float(shown["was"][NAME]))
    lines = [f"Softness: {_spoken(value['value'])} Pa ({low} to {high} Pa, 95 %); it was {was} Pa."]
    least, most = (_spoken(end) for end in value["limit"]["interval"])
    lines.append(
        f"That is for the accuracy of this result. The material itself, without the error of the "
        f"grid: {_spoken(value['limit']['value'])} Pa ({least} to {most} Pa)."
    )
    if shown["before"] and shown["fitted"]:
        before, after = (_mean(shown[name]) for name in ("before", "fitted"))
        lines.append(f"The outlines differ by {after:.2%} of a pixel; before by {before:.2%}.")
    laid = shown["laid"]
    if laid:
        lines.append(
            f"The video's first picture was laid on the object, {laid['scale']:.2f} times as "
            f"large; {laid['shared']:.0%} of both outlines are the same."
        )
    lines += [f"{sum(report['runs'])} runs in {report['seconds']:.0f} s.", *report["notes"]]
    return lines


def _mean(values: list[float]) -> float:
    return (sum(value**2 for value in values) / len(values)) ** 0.5


def _spoken(value: float) -> str:
    return f"{float(f'{value:.{DIGITS}g}'):,.0f}"
