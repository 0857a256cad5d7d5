"""Panels of the page: gr.HTML components with scripts in static/ and phy124/io/viewer/."""

from __future__ import annotations

import secrets
from functools import wraps
from typing import Any

import gradio as gr

from .handlers import Handler

MARK = "mark"
"""Key of an entry that makes every value of a panel different (see `mark_answers`)."""


def _load(*files: str) -> str:
    return "".join(
        f'<link rel="stylesheet" href="phy124/{file}">'
        if file.endswith(".css")
        else f'<script src="phy124/{file}"></script>'
        for file in files
    )


HEAD = _load("static/server.js", "static/page.js")
KNOWN = HEAD + _load("static/ways.js", "static/known.js")
PANELS = {
    # The scene editor; its value is a scene as plain data, and "change" sends a new scene.
    "scene": (HEAD + _load("static/links.js", "static/form.js", "static/scene.js"), "change"),
    # The picture, its cut-out, the brush, and examples. "choose" names an uploaded file or an
    # example, "correct" carries brush strokes, "cut" reports the end of a cut-out.
    "picture": (HEAD + _load("static/brush.js", "static/picture.js"), "choose correct cut"),
    # Optional inputs; the value contains them by option name. "choose" names a picture uploaded for
    # an option, "view" reports the end of its cut-out, and "change" reports a new value. Handlers
    # set the value to an answer, or to the orientations of a file of Gaussians; the panel then
    # replaces this value.
    "known": (KNOWN, "choose view change"),
    # Pictures of further objects; empty if no object needs a picture. "choose" names a picture
    # uploaded for an object, "view" reports the end of its cut-out. Handlers set the value to an
    # answer; the pictures are stored in the scene.
    "others": (KNOWN + _load("static/others.js"), "choose view"),
    # The progress; "finished" and "again" report the end of a job.
    "progress": (HEAD, "finished again"),
    # The viewer, which shows example results, the cut-out, the clip and the player.
    "viewer": (
        HEAD
        + _load("viewer/vendor/playcanvas.min.js", "viewer/pack.js", "viewer/stage.js")
        + _load("viewer/shine.js", "viewer/player.js", "viewer/player.css"),
        "",
    ),
    # The live run; the value is the ID of a live run, an error message, or the reason why no clip
    # is made of the live run. "begin" requests a live run, and "save" requests a clip.
    "touch": (
        HEAD + _load("static/lattice.js", "static/glass.js", "static/splats.js", "static/touch.js"),
        "begin save",
    ),
    # The forecast as HTML, and the number of the scene change that it belongs to. "measure"
    # requests a measurement of the scene's error.
    "forecast": (HEAD, "measure"),
    # Earlier results; "show" selects a result.
    "history": (HEAD, "show"),
    # The report; "finer" requests the same motion at a finer accuracy.
    "report": (HEAD, "finer"),
    # Files to download; "prepare" requests a file that is created on request.
    "takeaway": (HEAD + _load("static/takeaway.js"), "prepare"),
    # Fits to a video; the value is the offer of a fit or the finished fit. "begin" starts a fit to
    # an uploaded video, "stop" cancels the fit, and "ended" reports its end.
    "fit": (
        HEAD + _load("viewer/compare.js", "static/fit.js", "viewer/compare.css"),
        "begin stop ended",
    ),
}
"""Scripts and events of each panel."""


def make_panel(name: str) -> gr.HTML:
    """Create the panel `name` of the page. In the browser, the function `Phy124.name` draws the
    panel.
    """
    head, events = PANELS[name]
    # Gradio searches the text of the script for event names.
    names = " ".join(f"'{event}'" for event in events.split())
    value: Any = None
    return gr.HTML(
        value,
        html_template="",
        js_on_load=f"Phy124.{name}(element, props, watch, trigger); // {names}",
        head=head,
        apply_default_css=False,
        elem_id=name,
    )


def mark_answers(page: Any) -> None:
    """Wrap the handlers of a `gr.Blocks`, so that no two answers to the same panel are equal.

    Gradio does not send a value to a panel if the value equals the previous value. A panel would
    therefore wait forever after two equal refusals. Each answer therefore contains a different
    number, which handlers do not receive.
    """
    for event in page.fns.values():
        panels = [isinstance(block, gr.HTML) for block in event.outputs]
        if event.fn is not None and any(panels):
            event.fn = _marking(event.fn, panels)


def _marking(handle: Handler, panels: list[bool]) -> Handler:
    # The handlers are wrapped instead of the components, because Gradio creates new components for
    # each session.
    @wraps(handle)
    def marking(*arguments: Any) -> Any:
        answer = handle(*map(_unmark, arguments))
        if len(panels) == 1:
            return _mark(answer)
        return [
            _mark(value) if is_panel else value
            for value, is_panel in zip(answer, panels, strict=True)
        ]

    return marking


def _mark(value: Any) -> Any:
    if not isinstance(value, dict) or value == gr.skip():
        return value
    return {**value, MARK: secrets.token_hex(4)}


def _unmark(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: part for key, part in value.items() if key != MARK}
