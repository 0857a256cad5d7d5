"""Panels of the page: gr.HTML components with scripts in static/ and phy124/io/viewer/."""

from __future__ import annotations

import secrets
from functools import wraps
from typing import Any

import gradio as gr

from .handlers import Handler

HEAD = '<script src="phy124/static/server.js"></script>'
MARK = "mark"
"""Key of an entry in a panel's value that is different in every answer (see `mark_answers`)."""


HEAD += '<script src="phy124/static/page.js"></script>'
PICTURE = HEAD + '<script src="phy124/static/brush.js"></script>'
PICTURE += '<script src="phy124/static/picture.js"></script>'
KNOWN = HEAD + '<script src="phy124/static/ways.js"></script>'
KNOWN += '<script src="phy124/static/known.js"></script>'
OTHERS = KNOWN + '<script src="phy124/static/others.js"></script>'
EDITOR = HEAD + '<script src="phy124/static/links.js"></script>'
EDITOR += '<script src="phy124/static/form.js"></script>'
EDITOR += '<script src="phy124/static/scene.js"></script>'
TOUCH = (
    HEAD
    + '<script src="phy124/static/lattice.js"></script>'
    + '<script src="phy124/static/glass.js"></script>'
    + '<script src="phy124/static/splats.js"></script>'
    + '<script src="phy124/static/touch.js"></script>'
)
FIT = (
    HEAD
    + '<script src="phy124/viewer/compare.js"></script>'
    + '<script src="phy124/static/fit.js"></script>'
    + '<link rel="stylesheet" href="phy124/viewer/compare.css">'
)
PLAYER = (
    HEAD
    + '<script src="phy124/viewer/vendor/playcanvas.min.js"></script>'
    + '<script src="phy124/viewer/pack.js"></script>'
    + '<script src="phy124/viewer/stage.js"></script>'
    + '<script src="phy124/viewer/shine.js"></script>'
    + '<script src="phy124/viewer/player.js"></script>'
    + '<link rel="stylesheet" href="phy124/viewer/player.css">'
)


def scene() -> gr.HTML:
    """Create the scene editor, whose value is a scene as plain data.

    The event "change" sends a new scene.
    """
    return _panel("scene", EDITOR, events="'change'")


def picture() -> gr.HTML:
    """Create the panel of the picture, its cut-out, the brush, and examples.

    Events: "choose" names an uploaded file or an example, "correct" carries brush strokes, "cut"
    reports the end of a cut-out.
    """
    return _panel("picture", PICTURE, events="'choose' 'correct' 'cut'")


def extras() -> gr.HTML:
    """Create the panel of optional inputs; its value contains the inputs by option name.

    Events: "choose" names a picture uploaded for an option, "view" reports the end of its cut-out,
    "change" a new value. Handlers set the value to an answer, or to the orientations of a file of
    Gaussians; the panel then replaces this value.
    """
    return _panel("known", KNOWN, events="'choose' 'view' 'change'")


def others() -> gr.HTML:
    """Create the panel for pictures of further objects; it is empty if no object needs a picture.

    Events: "choose" names a picture uploaded for an object, "view" reports the end of its cut-out.
    Handlers set the value to an answer; the pictures are stored in the scene.
    """
    return _panel("others", OTHERS, events="'choose' 'view'")


def progress() -> gr.HTML:
    """Create the progress panel; its events "finished" and "again" report the end of a job."""
    return _panel("progress", HEAD, events="'finished' 'again'")


def viewer() -> gr.HTML:
    """Create the viewer, which shows example results, the cut-out, the clip and the player."""
    return _panel("viewer", PLAYER)


def touch() -> gr.HTML:
    """Create the panel of the live run; its value is the ID of a live run or an error message.

    The event "begin" requests a live run. The event "save" requests a clip of the live run.
    """
    return _panel("touch", TOUCH, events="'begin' 'save'")


def forecast() -> gr.HTML:
    """Create the forecast panel; the event "measure" requests a measurement of the scene's error.

    The value contains the forecast as HTML, and the number of the scene change that the forecast
    belongs to.
    """
    return _panel("forecast", HEAD, events="'measure'")


def history() -> gr.HTML:
    """Create the list of earlier results; its event "show" selects a result."""
    return _panel("history", HEAD, events="'show'")


def report() -> gr.HTML:
    """Create the report panel; its event "finer" requests the same motion at a finer accuracy."""
    return _panel("report", HEAD, events="'finer'")


def takeaway() -> gr.HTML:
    """Create the download panel; its event "prepare" requests a file that is created on request."""
    return _panel("takeaway", HEAD, events="'prepare'")


def fit() -> gr.HTML:
    """Create the panel of fits to a video; its value is the offer of a fit or the finished fit.

    The event "begin" starts a fit to an uploaded video, "stop" cancels the fit, and "ended" reports
    its end.
    """
    return _panel("fit", FIT, events="'begin' 'stop' 'ended'")


def _panel(name: str, head: str, events: str = "") -> gr.HTML:
    """Create a panel; the function `name` of the script object `Phy124` draws it."""
    call = f"Phy124.{name}(element, props, watch, trigger);"
    value: Any = None
    # Gradio searches the text of the script for event names.
    return gr.HTML(
        value,
        html_template="",
        js_on_load=f"{call} // {events}",
        head=head,
        apply_default_css=False,
        elem_id=name,
    )


def mark_answers(page: Any) -> None:
    """Wrap the handlers of a `gr.Blocks`, so that no two answers to the same panel are equal.

    Gradio does not send a panel a value that equals the previous value. If a request were refused
    twice with the same message, the panel would wait forever. Each answer therefore contains a
    different number. Handlers receive values without the number.
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
