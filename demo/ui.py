"""Lay out the page: picture, scene and buttons on one side, viewer and results on the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gradio as gr
from gradio import themes

from . import handlers
from .endpoints import endpoints
from .handlers.results import REPORT
from .jobs import Studio
from .panels import make_panel, mark_answers
from .photo import count_values, fetch_nothing
from .settings import Settings
from .visitors import Visitors
from .zerogpu import work_on_gpu

STYLE = '<link rel="stylesheet" href="phy124/static/page.css">'
QUIET: dict[str, Any] = {
    "queue": False,
    "show_progress": "hidden",
    "api_visibility": "private",
}
"""Options of events that are answered immediately.

Gradio ignores further events until the first is answered, so a button that is pressed twice acts
once.
"""
EACH: dict[str, Any] = {**QUIET, "trigger_mode": "multiple"}
"""Options of events that Gradio must handle one by one, because each event has different data."""
LAST: dict[str, Any] = {**QUIET, "trigger_mode": "always_last"}
"""Options of events without data; if several events wait, Gradio handles only the last of them."""
CHANGE = "(globalThis.Phy124 ??= {}).change"
"""JavaScript expression for the number of changes that the visitor has made to the scene.

The number is undefined before the first change. Events that update the forecast send this number.
The answers repeat the number, so that old answers can be ignored.
"""
CHANGED = f"(...values) => [...values.slice(0, -1), {CHANGE} = ({CHANGE} ?? 0) + 1]"
UNCHANGED = f"(...values) => [...values.slice(0, -1), {CHANGE} ?? 0]"
MASTHEAD = """<div id="masthead"><p id="mark"><svg viewBox="0 0 42 42" aria-hidden="true">
<g fill="none" stroke="currentColor" stroke-width="2.6"><ellipse cx="15" cy="27" rx="11" ry="9"/>
<ellipse cx="22" cy="20" rx="12" ry="7.5" transform="rotate(-32 22 20)" opacity=".6"/>
<ellipse cx="29" cy="12" rx="9" ry="5" transform="rotate(-48 29 12)" opacity=".3"/></g></svg>
phy124</p><h1>One picture in,<br>a moving 3D object out.</h1></div>"""


def open_studio(settings: Settings, root: Path) -> Studio:
    """Create the state shared by all visitors; on ZeroGPU, wrap jobs so that they get a GPU."""
    visitors = Visitors(root / "visitors", settings.room)
    return Studio(settings, visitors, work=work_on_gpu(settings.max_seconds))


def build(studio: Studio) -> gr.Blocks:
    """Build the page."""
    with gr.Blocks(title="phy124", fill_width=True, analytics_enabled=False) as page:
        source, done = gr.State(None), gr.State(None)
        with gr.Row(elem_id="page"):
            with gr.Column(elem_id="scroll"):
                with gr.Column(elem_id="side"):
                    gr.HTML(MASTHEAD, apply_default_css=False)
                    picture, extras = make_panel("picture"), make_panel("known")
                    others = make_panel("others")
                    scene = make_panel("scene")
                with gr.Column(elem_id="under"):
                    report, takeaway = make_panel("report"), make_panel("takeaway")
                    history, fit = make_panel("history"), make_panel("fit")
            with gr.Column(elem_id="bar"):
                progress, forecast, go, cancel, grab = _bar()
            with gr.Column(elem_id="stage"):
                viewer, touch = make_panel("viewer"), make_panel("touch")
        results = [viewer, report, takeaway, history]
        asked = [source, scene, extras]
        cut = _wire_picture(studio, picture, source, others, extras)
        _wire_forecast(studio, asked, cut, forecast)
        for again in (grab.click, touch.begin):
            again(handlers.on_touch(studio), asked, touch, **QUIET)
        saved = [progress, go, cancel, touch]
        touch.save(handlers.on_save(studio), [source, extras], saved, **QUIET)
        shows = _wire_run(studio, asked, done, go, cancel, progress, forecast, results)
        queued = {"concurrency_id": "export", "concurrency_limit": 2, "trigger_mode": "multiple"}
        takeaway.prepare(
            handlers.on_prepare(studio),
            [done, takeaway],
            takeaway,
            show_progress="hidden",
            api_visibility="private",
            **queued,
        )
        shown = [picture, source, extras, progress, done, go, cancel, *results]
        shows.append(page.load(handlers.on_load(studio), None, shown, **QUIET))
        _wire_fit(studio, done, fit, takeaway, shows)
        endpoints(studio)
    fetch_nothing(page)
    count_values(page)
    mark_answers(page)
    return page


def theme() -> themes.Base:
    """Return a theme that uses system fonts only, so that nothing is downloaded."""
    return themes.Base(
        primary_hue="teal",
        neutral_hue="slate",
        radius_size="lg",
        font=[themes.LocalFont("IBM Plex Sans", weights=(400, 700)), "system-ui", "sans-serif"],
        font_mono=["ui-monospace", "monospace"],
    )


def _bar() -> tuple[gr.HTML, gr.HTML, gr.Button, gr.Button, gr.Button]:
    progress, forecast = make_panel("progress"), make_panel("forecast")
    go = gr.Button("Generate", variant="primary", elem_id="go", min_width=0)
    grab = gr.Button("Touch", elem_id="begin-touch", min_width=0)
    cancel = gr.Button("Cancel", elem_id="cancel", visible=False, min_width=0)
    return progress, forecast, go, cancel, grab


def _wire_picture(studio: Studio, picture: Any, source: Any, others: Any, extras: Any) -> Any:
    picture.choose(handlers.on_choose(studio), None, [picture, source, extras], **EACH)
    picture.correct(handlers.on_correct(studio), [picture, source], picture, **EACH)
    shown = [picture, source]
    cut = picture.cut(handlers.on_cut_end(studio), shown, [*shown, extras], **EACH)
    extras.choose(handlers.on_choose_view(studio), None, extras, **EACH)
    others.choose(handlers.on_choose_object(studio), None, others, **EACH)
    for panel in (others, extras):
        panel.view(handlers.on_view_cut(studio), None, panel, **EACH)
    return cut


def _wire_forecast(studio: Studio, asked: list[Any], cut: Any, forecast: Any) -> None:
    # The event of the cut-out is used, because Gradio reports no change of a state after an event
    # that bypasses its queue.
    changes = [*(component.change for component in asked), cut.then]
    sent = [*asked, forecast]
    for change in changes:
        changed = change(handlers.on_scene_changed(studio), sent, forecast, js=CHANGED, **LAST)
        changed.then(handlers.on_refine(studio), sent, forecast, js=UNCHANGED, **LAST)


def _wire_run(
    studio: Studio,
    asked: list[Any],
    done: Any,
    go: Any,
    cancel: Any,
    progress: Any,
    forecast: Any,
    results: list[Any],
) -> list[Any]:
    start, started = handlers.on_generate(studio), [progress, go, cancel]
    for again in (go.click, progress.again):
        again(start, asked, started, **QUIET)
    forecast.measure(handlers.on_measure(studio), asked, started, **QUIET)
    results[REPORT].finer(handlers.on_finer(studio), done, started, **QUIET)
    cancel.click(handlers.on_cancel(studio), None, None, **EACH)
    finish, shown = handlers.on_job_end(studio), [forecast, done, go, cancel, *results]
    shows, sent = (progress.finished, results[-1].show), [*asked, done, forecast]
    return [show(finish, sent, shown, js=UNCHANGED, **EACH) for show in shows]


def _wire_fit(studio: Studio, done: Any, fit: Any, takeaway: Any, shows: list[Any]) -> None:
    # Not done.change: Gradio reports no change of a state after an event that bypasses its queue.
    for shown in shows:
        shown.then(handlers.on_result_shown(studio), done, fit, **LAST)
    fit.begin(handlers.on_fit_begin(studio), [done, fit], fit, **EACH)
    fit.stop(handlers.on_fit_stop(studio), None, None, **EACH)
    fit.ended(handlers.on_fit_end(studio), done, [fit, takeaway], **EACH)
