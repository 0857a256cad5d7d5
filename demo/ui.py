"""The page's layout: picture, scene and Generate on the left, the results on the right."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gradio as gr
from gradio import themes

from . import handlers, panels
from .endpoints import endpoints
from .jobs import Studio
from .marks import mark_answers
from .photo import fetch_nothing
from .settings import Settings
from .visitors import Visitors
from .work import steps

FOLDER = Path(__file__).parent
STYLE = '<link rel="stylesheet" href="phy124/static/page.css">'
QUIET: dict[str, Any] = {
    "queue": False, "show_progress": "hidden", "api_visibility": "private",
}  # fmt: skip
"""Options of events that answer at once. Gradio drops an event while the last is unanswered, which
is right for a button that is pressed twice."""
EACH: dict[str, Any] = {**QUIET, "trigger_mode": "multiple"}
"""The same for events of which none may be dropped, as each carries something else."""
LAST: dict[str, Any] = {**QUIET, "trigger_mode": "always_last"}
"""The same for events that carry nothing: after an answer comes that to the latest state."""
MASTHEAD = """<div id="masthead"><svg width="42" height="42" viewBox="0 0 42 42" aria-hidden="true">
<g fill="none" stroke="#0f766e" stroke-width="2.4"><ellipse cx="15" cy="27" rx="11" ry="9"/>
<ellipse cx="22" cy="20" rx="12" ry="7.5" transform="rotate(-32 22 20)" opacity=".6"/>
<ellipse cx="29" cy="12" rx="9" ry="5" transform="rotate(-48 29 12)" opacity=".3"/></g></svg>
<div><h1>phy124</h1><p>One photograph in, a moving and physically right 3D object out.</p>
</div></div>"""


def open_studio(settings: Settings, root: Path) -> Studio:
    """What all visitors share; on ZeroGPU jobs are wrapped so that they get a GPU."""
    work = steps
    if find_spec("spaces") is not None:
        import spaces  # pyright: ignore[reportMissingImports]

        work = spaces.GPU(duration=int(settings.max_seconds))(steps)
    return Studio(settings, Visitors(root / "visitors", settings.room), work=work)


def build(studio: Studio) -> gr.Blocks:
    """The whole page."""
    with gr.Blocks(title="phy124", fill_width=True, analytics_enabled=False) as page:
        gr.HTML(MASTHEAD, apply_default_css=False)
        source, done = gr.State(None), gr.State(None)
        with gr.Row(elem_id="columns"):
            with gr.Column(elem_id="left"):
                picture, others, known = _picture()
                scene = _scene()
                forecast, go, cancel, grab = _go()
            with gr.Column(elem_id="right"):
                progress = panels.progress()
                touch = panels.touch()
                viewer = panels.viewer()
                history = panels.history()
                videos, report, takeaway, fit = _results()
        results = [viewer, videos, report, takeaway, history]
        _wire_picture(studio, picture, source, others, known)
        asked = [source, scene, known]
        _wire_forecast(studio, asked, forecast)
        for again in (grab.click, touch.begin):
            again(handlers.toucher(studio), asked, touch, **QUIET)
        touch.save(handlers.saver(studio), [source, known], [progress, go, cancel], **QUIET)
        shows = _wire_run(studio, asked, done, go, cancel, progress, forecast, results)
        takeaway.prepare(
            handlers.preparer(studio), [done, takeaway], takeaway, concurrency_id="export",
            concurrency_limit=2, trigger_mode="multiple", show_progress="hidden",
            api_visibility="private",
        )  # fmt: skip
        shows.append(page.load(
            handlers.greeter(studio), None,
            [picture, source, known, progress, done, go, cancel, *results], **QUIET,
        ))  # fmt: skip
        _wire_fit(studio, done, fit, takeaway, shows)
        endpoints(studio)
    fetch_nothing(page)
    mark_answers(page)
    return page


def theme() -> themes.Base:
    """A theme with fonts of the system only, so that nothing is downloaded."""
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
        return panels.picture(), panels.others(), panels.known()


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


def _wire_picture(studio: Studio, picture: Any, source: Any, others: Any, known: Any) -> None:
    picture.choose(handlers.chooser(studio), None, [picture, source, known], **EACH)
    picture.correct(handlers.corrector(studio), [picture, source], picture, **EACH)
    shown = [picture, source]
    picture.cut(handlers.cut_shower(studio), shown, [*shown, known], **EACH)
    known.choose(handlers.view_chooser(studio), None, known, **EACH)
    others.choose(handlers.object_chooser(studio), None, others, **EACH)
    for panel in (others, known):
        panel.view(handlers.view_shower(studio), None, panel, **EACH)


def _wire_forecast(studio: Studio, asked: list[Any], forecast: Any) -> None:
    told = gr.on(
        [component.change for component in asked], handlers.forecaster(studio), asked, forecast,
        **LAST,
    )  # fmt: skip
    told.then(handlers.refiner(studio), asked, forecast, **LAST)


def _wire_run(
    studio: Studio, asked: list[Any], done: Any, go: Any, cancel: Any, progress: Any,
    forecast: Any, results: list[Any],
) -> list[Any]:  # fmt: skip
    """Returns the events after which another result may be shown."""
    start, started = handlers.starter(studio), [progress, go, cancel]
    for again in (go.click, progress.again):
        again(start, asked, started, **QUIET)
    forecast.measure(handlers.measurer(studio), asked, started, **QUIET)
    cancel.click(handlers.stopper(studio), None, None, **EACH)
    finish, shown = handlers.finisher(studio), [forecast, done, go, cancel, *results]
    shows = (progress.finished, results[-1].show)
    return [show(finish, [*asked, done], shown, **EACH) for show in shows]


def _wire_fit(studio: Studio, done: Any, fit: Any, takeaway: Any, shows: list[Any]) -> None:
    # Not done.change: Gradio tells no change of a state after an event without its queue.
    for shown in shows:
        shown.then(handlers.fit_offerer(studio), done, fit, **LAST)
    fit.begin(handlers.fit_starter(studio), [done, fit], fit, **EACH)
    fit.stop(handlers.fit_stopper(studio), None, None, **EACH)
    fit.ended(handlers.fit_shower(studio), done, [fit, takeaway], **EACH)
