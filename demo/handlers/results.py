"""Handle the events after a run: show its results, restore earlier results, create files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gradio as gr

from phy124.camera import VIEWS
from phy124.errors import InputError
from phy124.io.clip import read_scene, read_shape
from phy124.io.formats import FORMATS
from phy124.particles.thickness import Proportions

from ..exports import EXPORTS, export, notes_on
from ..fits import newest
from ..forecast import promise_of
from ..guard import visitor_of
from ..jobs import Studio
from ..line import Job, user_message
from ..progress import Measured
from ..report import as_html, describe_finer, summarise
from ..source import Choice, GaussianFile, is_there
from ..studies import read_study
from ..visitors import Visitor
from ..work import Done
from .event import Handler, data_of, file_of, job_of
from .picture import show_source, ways
from .run import (
    GONE,
    answer_change,
    busy_buttons,
    follow_job,
    forecast_of,
    idle_buttons,
    next_accuracy,
)

NOT_SHOWN = [gr.skip()] * 4
"""Values that leave the result panels unchanged."""
SHARE = "share"
"""Value of the field `kind` in an event that asks for a link instead of a file format."""
REPORT, TAKEAWAY = 1, 2
"""Indices of the report panel and of the download panel in the list of result panels."""
FORGOTTEN = {"message": GONE}, {"runs": []}
"""Values of the download panel and of the history after a visitor's files were removed."""
FILES = {
    "clip.safetensors": ("Moving Gaussians", "The clip itself, for phy124", "experts", "clip"),
    "gaussians.ply": ("PLY, at rest", f"Opens in {FORMATS['ply'].opens_in}", "programs", "PLY"),
    "orbit.webp": ("Animated picture", "WebP, for a message", "show", "animated picture"),
    "scene.toml": ("Scene", "Every setting, to run it again", "experts", "scene"),
    "report.json": ("Report", "Times, effects, stability", "experts", "report"),
}
"""For each file of a result: name, hint, group in the download panel, and short name."""

FITTED = {
    "comparison.mp4": ("Fit: video and simulation", "Side by side, MP4"),
    "comparison.html": ("Fit: frame by frame", "Opens in any browser, offline"),
    "comparison.png": ("Fit: eight instants", "PNG"),
    "fitted.toml": ("Fit: scene", "With the fitted softness"),
    "fit.json": ("Fit: report", "Softness, interval, all runs"),
}


def on_job_end(studio: Studio) -> Handler:
    """Handle the end of a job: show the results of a run, or the forecast after a study."""

    def finish(
        source: Any,
        scene: Any,
        extras: Any,
        shown: Any,
        change: Any,
        event: gr.EventData,
        request: gr.Request,
    ) -> tuple[Any, ...]:
        name, job = visitor_of(request), job_of(studio, request, event)
        visitor = studio.visitors.find(name)
        if visitor and shown is None and job is not None and job.over and not job.progress.result:
            # The page was loaded during this run, which has no result; show the one before it.
            job = _run_to_show(visitor) or job
        # An earlier result must not change the buttons of a run in progress.
        earlier = data_of(event).get("earlier")
        buttons = (gr.skip(), gr.skip()) if earlier else idle_buttons()
        line, measured = gr.skip(), job is not None and isinstance(job.progress.result, Measured)
        if source and scene and not earlier:
            # The object's proportions, or the measured error, are now known.
            html = forecast_of(studio, Choice(name, source, scene, extras), opened=measured)
            line = answer_change(change, html)
        if measured:
            return line, gr.skip(), *buttons, *_with_report(studio, name, shown)
        if job is None and not _is_there(shown):
            return gr.skip(), None, *buttons, *NOT_SHOWN[:TAKEAWAY], *FORGOTTEN
        if job is None or not job.over or not _is_there(job.progress.result):
            # An answer is always necessary, because the history waits for it before it sends other
            # events.
            runs = {"runs": _earlier(studio, name, shown)}
            return gr.skip(), gr.skip(), *buttons, *NOT_SHOWN[:-1], runs
        return line, job.progress.result, *buttons, *results(studio, name, job)

    return finish


def _with_report(studio: Studio, name: str, shown: Any) -> list[Any]:
    panels: list[Any] = list(NOT_SHOWN)
    visitor = studio.visitors.find(name)
    if visitor is not None and _is_there(shown):
        jobs = [job for job in visitor.jobs.values() if job.progress.result == shown]
        panels[REPORT] = report_of(studio, jobs[-1]) if jobs else gr.skip()
    return panels


def _is_there(done: Any) -> bool:
    return isinstance(done, Done) and done.is_stored


def on_load(studio: Studio) -> Handler:
    """Handle the opening of the page: restore the visitor's picture, jobs and results."""

    def greet(request: gr.Request) -> tuple[Any, ...]:
        visitor = studio.visitors.find(visitor_of(request))
        if visitor is None:
            return gr.skip(), None, gr.skip(), gr.skip(), None, *idle_buttons(), *NOT_SHOWN
        taken, run = visitor.latest("cut", "read"), _run_to_show(visitor)
        study = visitor.latest("measure")
        if study is not None and not study.over and (run is None or run.over):
            run = study
        return *_restore_source(visitor, taken), *_restore_run(studio, visitor_of(request), run)

    return greet


def _run_to_show(visitor: Visitor) -> Job | None:
    runs = [job for job in reversed(list(visitor.jobs.values())) if job.kind == "run"]
    if runs and not runs[0].over:
        return runs[0]
    return next((run for run in runs if _is_there(run.progress.result)), None)


def _restore_source(visitor: Visitor, taken: Job | None) -> tuple[Any, Any, Any]:
    if taken is not None and not taken.over:
        return {"job": taken.name, "reads": taken.kind == "read"}, None, gr.skip()
    jobs = (job for job in reversed(list(visitor.jobs.values())) if job.kind in ("cut", "read"))
    made = next((job.progress.result for job in jobs if job.progress.result), None)
    if made is None or not is_there(made) or not Path(made.picture).exists():
        return gr.skip(), None, gr.skip()
    return show_source(made), made, ways(made) if isinstance(made, GaussianFile) else gr.skip()


def _restore_run(studio: Studio, name: str, run: Job | None) -> tuple[Any, ...]:
    if run is None:
        return gr.skip(), None, *idle_buttons(), *NOT_SHOWN
    if not run.over:
        return follow_job(run), None, *busy_buttons(), *NOT_SHOWN
    done = run.progress.result
    return gr.skip(), done, *idle_buttons(), *results(studio, name, run)


def results(studio: Studio, name: str, job: Job) -> list[Any]:
    """Return the values of the viewer, the report panel, the download panel and the history."""
    done: Done = job.progress.result
    extras = (job.choice and job.choice.extras) or {}
    invented = done.report.get("generator") == "relief" and not extras.get("back")
    return [
        {"pack": file_of(done.films / "clip.pack"), "invented": invented},
        report_of(studio, job),
        takeaway_of(done),
        {"runs": _earlier(studio, name, done)},
    ]


def report_of(studio: Studio, job: Job) -> dict[str, Any]:
    """Return the report panel's value for a finished run, with the measured errors of its scene."""
    done: Done = job.progress.result
    report, study = done.report, read_study(done.study)
    scene, count = done.scene, report["gaussians"]
    proportions = Proportions.of_report(report)
    stops = studio.forecaster.stops(scene, gaussians=count, proportions=proportions, study=study)
    promise = promise_of(scene, proportions, study, report)
    finer = next_accuracy(job.choice.data) if job.choice else None
    stop = next((each for each in stops if each.name == finer), None)
    return {
        "sentences": summarise(report, promise),
        "finer": describe_finer(stop, promise) if stop else "",
        "tables": as_html(report, scene.data(), job.progress.expected, stops, study),
    }


def _earlier(studio: Studio, name: str, shown: Done | None) -> list[dict[str, Any]]:
    visitor, seen, runs = studio.visitors.find(name), set(), []
    for job in reversed(list(visitor.jobs.values()) if visitor else []):
        done = job.progress.result
        if job.kind != "run" or not _is_there(done) or done.films in seen:
            continue
        seen.add(done.films)
        scene = read_scene(done.clip / "clip.safetensors")
        accuracy = f", {scene['accuracy']}" if isinstance(scene["accuracy"], str) else ""
        seconds = scene["time"]["frames"] / scene["time"]["fps"]
        runs.append(
            {
                "job": job.name,
                "title": str(scene["material"]["law"]).replace("_", " ").capitalize(),
                "detail": f"{seconds:.2g} s{accuracy}",
                "picture": file_of(done.films / "orbit.webp"),
                "pack": file_of(done.films / "clip.pack"),
                "current": done == shown,
            }
        )
    return runs


def _films(done: Done) -> list[Path]:
    order = [*VIEWS, "orbit"]
    place = {name: number for number, name in enumerate(order)}
    films = sorted(done.films.glob("*.mp4"))
    return sorted(films, key=lambda path: place.get(path.stem, len(order)))


def on_prepare(studio: Studio) -> Handler:
    """Handle the event "prepare" of the download panel: create a file or a link."""

    def prepare(
        done: Done | None, shown: Any, event: gr.EventData, request: gr.Request
    ) -> dict[str, Any]:
        kind = str(data_of(event).get("kind"))
        visitor = studio.visitors.find(visitor_of(request))
        if done is None or visitor is None or not _is_there(done):
            return FORGOTTEN[0]
        try:
            kinds = ["html" if kind == SHARE else kind]
            (path,) = export(kinds, done, visitor, studio.visitors)
        except InputError as error:
            return {**takeaway_of(done), "asked": kind, "message": user_message(error)}
        offered = {**takeaway_of(done), "asked": kind}
        if kind == SHARE:
            minutes = studio.settings.room.grace / 60
            lasts = (
                f"The link works while this page is open, and for {minutes:g} minutes after that."
            )
            link = f"phy124/shared/{visitor.share(path)}"
            return {**offered, "share": {"link": link, "lasts": lasts}}
        return {**offered, "file": path.name}

    return prepare


def takeaway_of(done: Done) -> dict[str, Any]:
    """Return the download panel's value: files of a result, and formats created on request.

    Handlers add the requested format under the key "asked".
    """
    files, offers = [], []
    frames, gaussians = read_shape(done.clip / "clip.safetensors")
    for path in _films(done):
        files.append(_link(path, f"Video, {path.stem}", "MP4", "videos"))
    for name, about in FILES.items():
        for folder in (done.films, done.clip):
            if (folder / name).exists():
                files.append(_link(folder / name, *about))
                break
    fitted = newest(done)
    for path in fitted.files if fitted else ():
        if path.name in FITTED:
            files.append(_link(path, *FITTED[path.name], "experts"))
    for kind, offer in EXPORTS.items():
        group = {"html": "show", "mcap": "experts"}.get(kind, "programs")
        if (done.exports / offer.file).exists():
            path = done.exports / offer.file
            link = _link(path, offer.label, offer.hint, group)
            files.append({**link, "notes": notes_on(path)})
        elif offer.available():
            about = offer.about(frames, gaussians)
            each = {"kind": kind, "label": offer.label, "hint": offer.hint, "about": about}
            offers.append({**each, "group": group})
    hint = "Plays in any browser as long as your files are stored here"
    offers.append({"kind": SHARE, "label": "Link", "hint": hint, "group": "show"})
    clip = read_scene(done.clip / "clip.safetensors")
    length = frames / clip["time"]["fps"] if "time" in clip else 1.0
    return {"result": done.films.name, "files": files, "offers": offers, "length": length}


def _link(path: Path, label: str, hint: str, group: str, brief: str = "") -> dict[str, Any]:
    return {
        "label": label,
        "hint": hint,
        "group": group,
        "brief": brief,
        "file": file_of(path),
    }
