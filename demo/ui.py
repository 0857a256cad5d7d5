"""Layout of the page: picture, scene and Generate on the left, results on the right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gradio as gr
from gradio import themes

from . import handlers, panels
from .endpoints import endpoints
from .jobs import Studio
from .panels import mark_answers
from .photo import fetch_nothing
from .settings import Settings
from .visitors import Visitors
from .zerogpu import work_on_gpu

FOLDER = Path(__file__).parent
STYLE = '<link rel="stylesheet" href="phy124/static/page.css">'
QUIET: dict[str, Any] = {
    "queue": False,
    "show_progress": "hidden",
    "api_visibility": "private",
}
"""Options of events that are answered at once. Gradio drops a further event until the previous one
is answered, as a button that is pressed twice requires."""
EACH: dict[str, Any] = {**QUIET, "trigger_mode": "multiple"}
"""Options of events that must not be dropped, because each has different data."""
LAST: dict[str, Any] = {**QUIET, "trigger_mode": "always_last"}
"""Options of events without data: after the last event the latest state is answered."""
MASTHEAD = """<div id="masthead"><svg width="42" height="42" viewBox="0 0 42 42" aria-hidden="true">
<g fill="none" stroke="#0f766e" stroke-width="2.4"><ellipse cx="15" cy="27" rx="11" ry="9"/>
<ellipse cx="22" cy="20" rx="12" ry="7.5" transform="rotate(-32 22 20)" opacity=".6"/>
<ellipse cx="29" cy="12" rx="9" ry="5" transform="rotate(-48 29 12)" opacity=".3"/></g></svg>
<div><h1>phy124</h1><p>One photograph in, a moving and physically right 3D object out.</p>
</div></div>"""


def open_studio(settings: Settings, root: Path) -> Studio:
    """Create the state shared by all visitors; on ZeroGPU, jobs are wrapped to get a GPU."""
    visitors = Visitors(root / "visitors", settings.room)
    return Studio(settings, visitors, work=work_on_gpu(settings.max_seconds))


def build(studio: Studio) -> gr.Blocks:
    """Build the page."""
    with gr.Blocks(title="phy124", fill_width=True, analytics_enabled=False) as page:
        gr.HTML(MASTHEAD, apply_default_css=False)
        source, done = gr.State(None), gr.State(None)
        with gr.Row(elem_id="columns"):
            with gr.Column(elem_id="left"):
                picture, others, extras = _picture()
                scene = _scene()
                forecast, go, cancel, grab = _go()
            with gr.Column(elem_id="right"):
                progress = panels.progress()
                touch = panels.touch()
                viewer = panels.viewer()
                history = panels.history()
                videos, report, takeaway, fit = _results()
        results = [viewer, videos, report, takeaway, history]
        _wire_picture(studio, picture, source, others, extras)
        asked = [source, scene, extras]
        _wire_forecast(studio, asked, forecast)
        for again in (grab.click, touch.begin):
            again(handlers.on_touch(studio), asked, touch, **QUIET)
        touch.save(handlers.on_save(studio), [source, extras], [progress, go, cancel], **QUIET)
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
    mark_answers(page)
    return page


def theme() -> themes.Base:
    """Return a theme with system fonts only: nothing is downloaded."""
    return themes.Base(
        primary_hue="teal",
        neutral_hue="slate",
        radius_size="lg",
        font=[themes.LocalFont("IBM Plex Sans", weights=(400, 700)), "system-ui", "sans-serif"],
        font_mono=["ui-monospace", "monospace"],
    )


def _heading(number: int, title: str) -> gr.HTML:
    return gr.HTML(f"<h2><b>{number}</b>{title}</h2>", apply_default_css=False)


def _picture() -> tuple[gr.HTML, gr.HTML, gr.HTML]:
    with gr.Column(elem_id="picture-panel"):
        _heading(1, "Picture")
        return panels.picture(), panels.others(), panels.extras()


def _scene() -> gr.HTML:
    with gr.Column(elem_id="scene-panel"):
        _heading(2, "What happens")
        return panels.scene()


def _go() -> tuple[gr.HTML, gr.Button, gr.Button, gr.Button]:
    with gr.Column(elem_id="go-panel"):
        forecast = panels.forecast()
        with gr.Row(elem_id="go-row"):
            go = gr.Button("Generate", variant="primary", elem_id="go", scale=3)
            grab = gr.Button("Touch", elem_id="begin-touch", scale=1, min_width=80)
            cancel = gr.Button("Cancel", elem_id="cancel", visible=False, scale=1, min_width=96)
    return forecast, go, cancel, grab


def _results() -> tuple[gr.HTML, gr.HTML, gr.HTML, gr.HTML]:
    with gr.Tabs(elem_id="results"):
        with gr.Tab("Videos"):
            videos = panels.videos()
        with gr.Tab("Report"):
            empty = '<p class="empty">Where the time went, and how stable it was.</p>'
            report = gr.HTML(empty, apply_default_css=False, elem_id="report")
        with gr.Tab("Take away"):
            takeaway = panels.takeaway()
        with gr.Tab("Fit"):
            fit = panels.fit()
    return videos, report, takeaway, fit


def _wire_picture(studio: Studio, picture: Any, source: Any, others: Any, extras: Any) -> None:
    picture.choose(handlers.on_choose(studio), None, [picture, source, extras], **EACH)
    picture.correct(handlers.on_correct(studio), [picture, source], picture, **EACH)
    shown = [picture, source]
    picture.cut(handlers.on_cut_end(studio), shown, [*shown, extras], **EACH)
    extras.choose(handlers.on_choose_view(studio), None, extras, **EACH)
    others.choose(handlers.on_choose_object(studio), None, others, **EACH)
    for panel in (others, extras):
        panel.view(handlers.on_view_cut(studio), None, panel, **EACH)


def _wire_forecast(studio: Studio, asked: list[Any], forecast: Any) -> None:
    changes = [component.change for component in asked]
    changed = gr.on(changes, handlers.on_scene_changed(studio), asked, forecast, **LAST)
    changed.then(handlers.on_refine(studio), asked, forecast, **LAST)


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
    """Connect the run's events; return the events after which another result may be shown."""
    start, started = handlers.on_generate(studio), [progress, go, cancel]
    for again in (go.click, progress.again):
        again(start, asked, started, **QUIET)
    forecast.measure(handlers.on_measure(studio), asked, started, **QUIET)
    cancel.click(handlers.on_cancel(studio), None, None, **EACH)
    finish, shown = handlers.on_job_end(studio), [forecast, done, go, cancel, *results]
    shows = (progress.finished, results[-1].show)
    return [show(finish, [*asked, done], shown, **EACH) for show in shows]


def _wire_fit(studio: Studio, done: Any, fit: Any, takeaway: Any, shows: list[Any]) -> None:
    # Not done.change: Gradio reports no change of a state after an event without its queue.
    for shown in shows:
        shown.then(handlers.on_result_shown(studio), done, fit, **LAST)
    fit.begin(handlers.on_fit_begin(studio), [done, fit], fit, **EACH)
    fit.stop(handlers.on_fit_stop(studio), None, None, **EACH)
    fit.ended(handlers.on_fit_end(studio), done, [fit, takeaway], **EACH)
