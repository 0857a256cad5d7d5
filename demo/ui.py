"""The page's layout: picture, scene and Generate on the left, what came of it on the right."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gradio as gr
from gradio import themes

from demo import handlers, panels
from demo.endpoints import endpoints
from demo.jobs import Studio
from demo.photo import photo
from demo.settings import Settings
from demo.visitors import Visitors
from demo.work import steps

FOLDER = Path(__file__).parent
STYLE = '<link rel="stylesheet" href="phy124/static/page.css">'
KEEP, REMOVE = "#22c55e", "#ef4444"
MASTHEAD = """<div id="masthead"><svg width="42" height="42" viewBox="0 0 42 42" aria-hidden="true">
<g fill="none" stroke="#0f766e" stroke-width="2.4"><ellipse cx="15" cy="27" rx="11" ry="9"/>
<ellipse cx="22" cy="20" rx="12" ry="7.5" transform="rotate(-32 22 20)" opacity=".6"/>
<ellipse cx="29" cy="12" rx="9" ry="5" transform="rotate(-48 29 12)" opacity=".3"/></g></svg>
<div><h1>phy124</h1><p>One photograph in, a moving and physically right 3D object out.</p>
</div></div>"""


def open_studio(settings: Settings, root: Path) -> Studio:
    """What all visitors share; on ZeroGPU the work is wrapped so that it gets a GPU."""
    work = steps
    if find_spec("spaces") is not None:
        import spaces  # pyright: ignore[reportMissingImports]

        work = spaces.GPU(duration=int(settings.max_seconds))(steps)
    return Studio(settings, Visitors(root / "visitors"), work=work)


def build(studio: Studio) -> gr.Blocks:
    """The whole page."""
    age = int(studio.settings.keep_hours * 3600)
    with gr.Blocks(
        title="phy124", fill_width=True, analytics_enabled=False,
        delete_cache=(3600, age),
    ) as page:  # fmt: skip
        gr.HTML(MASTHEAD, apply_default_css=False)
        cutout, done = gr.State(None), gr.State(None)
        with gr.Row(elem_id="columns"):
            with gr.Column(elem_id="left"):
                picture, preview, editor, apply = _picture(studio)
                scene = _scene()
                forecast, go, cancel = _go()
            with gr.Column(elem_id="right"):
                progress = panels.progress()
                viewer = panels.viewer()
                videos, report, takeaway = _results()
        results = [viewer, videos, report, takeaway]
        _wire_picture(studio, picture, cutout, preview, editor, apply)
        _wire_run(studio, cutout, done, scene, forecast, go, cancel, progress, results)
        takeaway.prepare(
            handlers.prepare, [done, takeaway], takeaway, show_progress="hidden",
            api_visibility="private", concurrency_id="export", concurrency_limit=2,
            trigger_mode="multiple",
        )  # fmt: skip
        page.unload(handlers.leaver(studio))
        endpoints(studio)
    return page


def theme() -> themes.Base:
    """Only fonts that are there already: nothing is fetched."""
    return themes.Base(
        primary_hue="teal",
        neutral_hue="slate",
        radius_size="lg",
        font=[themes.LocalFont("IBM Plex Sans", weights=(400, 700)), "system-ui", "sans-serif"],
        font_mono=["ui-monospace", "monospace"],
    )


def _heading(number: int, title: str) -> gr.HTML:
    return gr.HTML(f"<h2><b>{number}</b>{title}</h2>", apply_default_css=False)


def _picture(studio: Studio) -> tuple[gr.Image, gr.Image, gr.ImageEditor, gr.Button]:
    with gr.Column(elem_id="picture-panel"):
        _heading(1, "Picture")
        with gr.Row(elem_id="pictures"):
            picture = photo(
                studio.settings.max_bytes,
                label="Picture", sources=["upload", "clipboard", "webcam"],
                elem_id="photo", height=190, show_label=False, buttons=[],
            )  # fmt: skip
            preview = gr.Image(
                label="Cut-out", interactive=False, elem_id="cutout", height=190, buttons=[],
                visible=False, show_label=False, image_mode="RGBA", format="png",
            )  # fmt: skip
        examples = panels.examples()
        examples.pick(
            handlers.pick,
            None,
            picture,
            queue=False,
            show_progress="hidden",
            api_visibility="private",
        )
        with gr.Accordion("Correct the cut-out", open=False):
            editor = gr.ImageEditor(
                label="Green keeps, red removes", type="pil",
                layers=False, sources=[], transforms=[], elem_id="brush", height=360,
                brush=gr.Brush(default_size=18, colors=[KEEP, REMOVE], color_mode="fixed"),
            )  # fmt: skip
            apply = gr.Button("Apply the strokes", size="sm")
    return picture, preview, editor, apply


def _scene() -> gr.HTML:
    with gr.Column(elem_id="scene-panel"):
        _heading(2, "What happens")
        return panels.scene()


def _go() -> tuple[gr.HTML, gr.Button, gr.Button]:
    with gr.Column(elem_id="go-panel"):
        forecast = gr.HTML("", elem_id="forecast", apply_default_css=False)
        with gr.Row(elem_id="go-row"):
            go = gr.Button("Generate", variant="primary", elem_id="go", scale=3)
            cancel = gr.Button("Cancel", elem_id="cancel", visible=False, scale=1, min_width=96)
    return forecast, go, cancel


def _results() -> tuple[gr.HTML, gr.HTML, gr.HTML]:
    with gr.Tabs(elem_id="results"):
        with gr.Tab("Videos"):
            videos = panels.videos()
        with gr.Tab("Report"):
            empty = '<p class="empty">Where the time went, and how stable it was.</p>'
            report = gr.HTML(empty, apply_default_css=False, elem_id="report")
        with gr.Tab("Take away"):
            takeaway = panels.takeaway()
    return videos, report, takeaway


def _wire_picture(studio: Studio, picture: Any, cutout: Any, *shown: Any) -> None:
    preview, editor, apply = shown
    quiet = {"show_progress_on": preview, "api_visibility": "private", "concurrency_limit": 2}
    picture.change(handlers.cutter(studio), picture, [cutout, preview, editor], **quiet)
    apply.click(handlers.corrector(studio), [cutout, editor], [cutout, preview], **quiet)


def _wire_run(
    studio: Studio, cutout: Any, done: Any, scene: Any, forecast: Any, go: Any, cancel: Any,
    progress: Any, results: list[Any],
) -> None:  # fmt: skip
    told = gr.on(
        [scene.change, cutout.change], handlers.forecaster(studio), [cutout, scene], forecast,
        queue=False, show_progress="hidden", api_visibility="private", trigger_mode="always_last",
    )  # fmt: skip
    told.then(
        handlers.refiner(studio), [cutout, scene], forecast, queue=False,
        show_progress="hidden", api_visibility="private",
    )  # fmt: skip
    ticket = gr.State(None)
    queued = go.click(
        handlers.beginner(studio), None, [ticket, progress, go, cancel], queue=False,
        show_progress="hidden", api_visibility="private",
    )  # fmt: skip
    # "multiple": a run called off in the queue must not keep the next one from being sent.
    run = queued.then(
        handlers.runner(studio), [cutout, scene, ticket], [progress, done, go, cancel, *results],
        concurrency_id="device", concurrency_limit=1, show_progress="minimal",
        show_progress_on=progress, api_visibility="private", trigger_mode="multiple",
    )  # fmt: skip
    run.failure(
        handlers.refuser(studio), None, [progress, go, cancel], queue=False,
        show_progress="hidden", api_visibility="private",
    )  # fmt: skip
    cancel.click(
        handlers.stopper(studio), None, [progress, go, cancel], queue=False,
        show_progress="hidden", api_visibility="private",
    )  # fmt: skip
